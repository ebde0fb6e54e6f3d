# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node: values, descriptors and callbacks."""

from __future__ import annotations

import array
import math
import re
import threading
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any

from rclpy_standin.exceptions import (
    InvalidParameterException,
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterAlreadyDeclaredException,
    ParameterImmutableException,
    ParameterNotDeclaredException,
)
from rclpy_standin.types import message_class

_MSG = 'rcl_interfaces/msg/'
_VALUE_FIELDS = (
    '', 'bool_value', 'integer_value', 'double_value', 'string_value', 'byte_array_value',
    'bool_array_value', 'integer_array_value', 'double_array_value', 'string_array_value',
)
_RELATIVE_TOLERANCE = 1e-6
"""Tolerance of comparisons with the limits of floating-point ranges."""


def _message(kind: str, /, **fields: Any) -> Any:
    return message_class(_MSG + kind)(**fields)


class Parameter:
    """A parameter: name, type and value."""

    class Type(Enum):
        """Type of a parameter value."""

        NOT_SET = 0
        BOOL = 1
        INTEGER = 2
        DOUBLE = 3
        STRING = 4
        BYTE_ARRAY = 5
        BOOL_ARRAY = 6
        INTEGER_ARRAY = 7
        DOUBLE_ARRAY = 8
        STRING_ARRAY = 9

        @classmethod
        def from_parameter_value(cls, value: Any) -> Parameter.Type:
            """Return the type of a value; raises TypeError if parameters cannot hold it."""
            if value is None:
                return cls.NOT_SET
            for kind in (cls.BOOL, cls.INTEGER, cls.DOUBLE, cls.STRING):
                if kind.check(value):
                    return kind
            if isinstance(value, list | tuple | array.array):
                for kind, base in _ARRAYS.items():
                    if all(isinstance(item, base) for item in value):
                        return kind
            raise TypeError(f'a parameter cannot have the value {value!r}')

        def check(self, value: Any) -> bool:
            """Return whether a value is of this type."""
            if self in _ARRAYS:
                return isinstance(value, list | tuple | array.array) and all(
                    isinstance(item, _ARRAYS[self]) for item in value
                )
            if self == Parameter.Type.INTEGER and isinstance(value, bool):
                return False
            return isinstance(value, _SCALARS[self])

    @classmethod
    def from_parameter_msg(cls, param_msg: Any) -> Parameter:
        """Return the parameter in an rcl_interfaces/Parameter message."""
        kind = cls.Type(param_msg.value.type)
        return cls(param_msg.name, kind, parameter_value_to_python(param_msg.value))

    def __init__(self, name: str, type_: Parameter.Type | None = None, value: Any = None) -> None:
        if type_ is None:
            type_ = Parameter.Type.from_parameter_value(value)
        if not isinstance(type_, Parameter.Type):
            raise TypeError(f'type must be an instance of Parameter.Type, not {type_!r}')
        if not type_.check(value):
            raise ValueError(f"Type '{type_}' and value '{value}' do not agree")
        self.name, self.type_, self.value = name, type_, value

    def __repr__(self) -> str:
        return f'Parameter(name={self.name!r}, type={self.type_}, value={self.value!r})'

    def get_parameter_value(self) -> Any:
        """Return the value as an rcl_interfaces/ParameterValue message."""
        message = _message('ParameterValue', type=self.type_.value)
        if self.type_ != Parameter.Type.NOT_SET:
            setattr(message, _VALUE_FIELDS[self.type_.value], self.value)
        return message

    def to_parameter_msg(self) -> Any:
        """Return the parameter as an rcl_interfaces/Parameter message."""
        return _message('Parameter', name=self.name, value=self.get_parameter_value())


_SCALARS: dict[Parameter.Type, type] = {
    Parameter.Type.NOT_SET: type(None),
    Parameter.Type.BOOL: bool,
    Parameter.Type.INTEGER: int,
    Parameter.Type.DOUBLE: float,
    Parameter.Type.STRING: str,
}
_ARRAYS: dict[Parameter.Type, type] = {
    Parameter.Type.BYTE_ARRAY: bytes,
    Parameter.Type.BOOL_ARRAY: bool,
    Parameter.Type.INTEGER_ARRAY: int,
    Parameter.Type.DOUBLE_ARRAY: float,
    Parameter.Type.STRING_ARRAY: str,
}


def parameter_value_to_python(parameter_value: Any) -> Any:
    """Return the value in an rcl_interfaces/ParameterValue message; None if not set."""
    name = _VALUE_FIELDS[parameter_value.type]
    return getattr(parameter_value, name) if name else None


class _Rejected(Exception):  # noqa: N818
    """Rejection of new parameter values, with the reason."""


class Parameters:
    """The parameters of one node."""

    def __init__(
        self,
        node_name: str,
        overrides: dict[str, Any],
        on_change: Callable[[Any], None],
    ) -> None:
        """Create the parameters of a node, with none declared.

        Args:
            node_name: fully qualified name of the node, for events.
            overrides: initial values by name, which replace the declared defaults.
            on_change: function called with an rcl_interfaces/ParameterEvent after each change.
        """
        self.overrides = {name: Parameter(name, value=value) for name, value in overrides.items()}
        self._node_name = node_name
        self._on_change = on_change
        self._values: dict[str, Parameter] = {}
        self._descriptors: dict[str, Any] = {}
        self._lock = threading.RLock()
        self.callbacks: list[Callable[[list[Parameter]], Any]] = []

    # Declaring

    def declare(
        self, name: str, value: Any, descriptor: Any, ignore_override: bool
    ) -> Parameter:
        """Declare a parameter.

        Args:
            name: its name.
            value: its default, which determines the type.
            descriptor: rcl_interfaces/ParameterDescriptor, or None.
            ignore_override: use the default even if there is an override.

        Raises:
            ParameterAlreadyDeclaredException: the parameter is already declared.
            InvalidParameterException: the name is invalid.
            InvalidParameterTypeException: the override has another type.
            InvalidParameterValueException: the value was rejected.
            NotImplementedError: there is no default.
        """
        if not re.fullmatch(r'[^\s]+', name):
            raise InvalidParameterException(name)
        if name in self._values:
            raise ParameterAlreadyDeclaredException([name])
        if value is None or isinstance(value, Parameter.Type):
            raise NotImplementedError(
                f'{name}: the stand-in for rclpy does not support parameters without a default'
            )
        descriptor = descriptor or _message('ParameterDescriptor')
        descriptor.type = Parameter.Type.from_parameter_value(value).value
        if not ignore_override and name in self.overrides:
            value = self.overrides[name].value
        parameter = Parameter(name, value=value)
        result = self._set([parameter], descriptor)
        if not result.successful:
            if result.reason.startswith('Wrong parameter type'):
                kind = Parameter.Type(descriptor.type).name
                raise InvalidParameterTypeException(parameter, kind)
            raise InvalidParameterValueException(name, value, result.reason)
        return parameter

    def undeclare(self, name: str) -> None:
        """Undeclare a parameter.

        Raises:
            ParameterNotDeclaredException: the parameter is not declared.
            ParameterImmutableException: the parameter is read-only.
        """
        with self._lock:
            if self.describe(name).read_only:
                raise ParameterImmutableException(name)
            del self._values[name], self._descriptors[name]

    # Reading

    def has(self, name: str) -> bool:
        """Return whether a parameter is declared."""
        return name in self._values

    def get(self, name: str) -> Parameter:
        """Return a parameter; raises ParameterNotDeclaredException."""
        self.describe(name)
        return self._values[name]

    def by_prefix(self, prefix: str) -> dict[str, Parameter]:
        """Return the parameters below a prefix, by name relative to it."""
        prefix = f'{prefix}.' if prefix else ''
        return {
            name[len(prefix) :]: parameter
            for name, parameter in self._values.items()
            if name.startswith(prefix)
        }

    def describe(self, name: str) -> Any:
        """Return the descriptor of a parameter; raises ParameterNotDeclaredException."""
        if name not in self._values:
            raise ParameterNotDeclaredException(name)
        return self._descriptors[name]

    def list(self, prefixes: Sequence[str], depth: int) -> Any:
        """Return the names below the prefixes, at most ``depth`` levels deep (0: all)."""
        names, parents = [], set()
        for name in self._values:
            relative_names = [
                name[len(prefix) + 1 :] if prefix != name else ''
                for prefix in prefixes
                if name == prefix or name.startswith(f'{prefix}.')
            ] if prefixes else [name]
            if any(depth == 0 or rest.count('.') < depth for rest in relative_names):
                names.append(name)
                if '.' in name:
                    parents.add(name.rpartition('.')[0])
        return _message('ListParametersResult', names=names, prefixes=sorted(parents))

    # Setting

    def set(self, parameters: Sequence[Parameter]) -> Any:
        """Set all parameters or none; return an rcl_interfaces/SetParametersResult.

        Raises:
            ParameterNotDeclaredException: a parameter is not declared.
        """
        unknown = [parameter.name for parameter in parameters if not self.has(parameter.name)]
        if unknown:
            raise ParameterNotDeclaredException(unknown)
        return self._set(parameters)

    def _set(self, parameters: Sequence[Parameter], new: Any = None) -> Any:
        """Set parameters; ``new`` is the descriptor of one that is being declared."""
        with self._lock:
            try:
                for parameter in parameters:
                    if new is None and self._descriptors[parameter.name].read_only:
                        raise _Rejected(
                            f'Trying to set a read-only parameter: {parameter.name}.'
                        )
                    _check(parameter, new or self._descriptors[parameter.name])
            except _Rejected as rejection:
                return _message('SetParametersResult', reason=str(rejection))
            for callback in list(self.callbacks):
                result = callback(list(parameters))
                if not result.successful:
                    return result
            event = _message('ParameterEvent', node=self._node_name)
            for parameter in parameters:
                if new is not None:
                    self._descriptors[parameter.name] = new
                changes = event.changed_parameters if new is None else event.new_parameters
                changes.append(parameter.to_parameter_msg())
                self._values[parameter.name] = parameter
        self._on_change(event)
        return _message('SetParametersResult', successful=True)


def _check(parameter: Parameter, descriptor: Any) -> None:
    """Raise _Rejected if a descriptor does not allow a value."""
    name, kind, value = parameter.name, parameter.type_, parameter.value
    descriptor.name = name
    if kind.value != descriptor.type:
        # An empty list gets the type BYTE_ARRAY, but is a valid value of any array type.
        expected = Parameter.Type(descriptor.type)
        if kind == Parameter.Type.BYTE_ARRAY and expected in _ARRAYS and not len(value):
            parameter.type_ = expected
            return
        raise _Rejected(f"Wrong parameter type, expected '{expected}' got '{kind}'")
    for limits in (*descriptor.integer_range, *descriptor.floating_point_range):
        low, high = sorted((limits.from_value, limits.to_value))
        is_close = kind == Parameter.Type.DOUBLE and any(
            math.isclose(value, limit, rel_tol=_RELATIVE_TOLERANCE) for limit in (low, high)
        )
        if not (low <= value <= high or is_close):
            raise _Rejected(
                f'Parameter {name} out of range. Min: {low}, Max: {high}, value: {value}'
            )
