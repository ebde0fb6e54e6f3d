# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node: values, descriptors and callbacks."""

from __future__ import annotations

import array
import math
import re
import threading
from collections.abc import Callable, Iterable, Sequence
from enum import Enum
from typing import Any

from rclpy_standin.exceptions import (
    InvalidParameterException,
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterAlreadyDeclaredException,
    ParameterImmutableException,
    ParameterNotDeclaredException,
    ParameterUninitializedException,
)
from rclpy_standin.types import message_class

_MSG = 'rcl_interfaces/msg/'
_VALUE_FIELDS = (
    '', 'bool_value', 'integer_value', 'double_value', 'string_value', 'byte_array_value',
    'bool_array_value', 'integer_array_value', 'double_array_value', 'string_array_value',
)
_RELATIVE_TOLERANCE = 1e-6
"""Tolerance of comparisons with the limits and steps of floating-point ranges."""


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
        self.post_callbacks: list[Callable[[list[Parameter]], None]] = []

    # Declaring

    def declare(
        self, namespace: str, parameters: Iterable[Sequence[Any]], ignore_override: bool = False
    ) -> list[Parameter]:
        """Declare parameters.

        Args:
            namespace: prefix of the names, or ''.
            parameters: for each parameter its name and optionally its default (or type) and
                descriptor.
            ignore_override: use the defaults even if there are overrides.

        Raises:
            ParameterAlreadyDeclaredException: a parameter is already declared.
            InvalidParameterException: a name is invalid.
            InvalidParameterTypeException: an override has another type.
            InvalidParameterValueException: a value was rejected.
            ValueError: a parameter of fixed type has neither type nor default.
        """
        declarations = []
        for entry in parameters:
            if not 1 <= len(entry) <= 3:
                raise TypeError(f'{entry!r}: expected a name, a value or type, a descriptor')
            declarations.append(self._declaration(namespace, ignore_override, *entry))
        declared = [p.name for p, _ in declarations if p.name in self._values]
        if declared:
            raise ParameterAlreadyDeclaredException(declared)
        for parameter, descriptor in declarations:
            result = self._set([parameter], {parameter.name: descriptor})
            if not result.successful:
                if result.reason.startswith('Wrong parameter type'):
                    kind = Parameter.Type(descriptor.type).name
                    raise InvalidParameterTypeException(parameter, kind)
                raise InvalidParameterValueException(
                    parameter.name, parameter.value, result.reason
                )
        return [self._values[parameter.name] for parameter, _ in declarations]

    def _declaration(
        self,
        namespace: str,
        ignore_override: bool,
        name: str,
        value: Any = None,
        descriptor: Any = None,
    ) -> tuple[Parameter, Any]:
        """Return the initial value and the complete descriptor of a parameter to declare."""
        if not isinstance(name, str):
            raise TypeError(f'{name!r}: expected the name of a parameter')
        name = f'{namespace}.{name}' if namespace else name
        if not name or not re.fullmatch(r'[^\s]+', name):
            raise InvalidParameterException(name)
        untyped = descriptor is None and value is None
        if descriptor is None:
            descriptor = _message('ParameterDescriptor', dynamic_typing=untyped)
        elif type(descriptor) is not message_class(_MSG + 'ParameterDescriptor'):
            raise TypeError(f'{descriptor!r}: expected a ParameterDescriptor')
        if isinstance(value, Parameter.Type):
            if value == Parameter.Type.NOT_SET:
                raise ValueError(f'{name}: cannot be of type NOT_SET')
            if descriptor.dynamic_typing:
                raise ValueError(f'{name}: dynamic_typing is not allowed together with a type')
            descriptor.type, value = value.value, None
        elif not descriptor.dynamic_typing:
            descriptor.type = Parameter.Type.from_parameter_value(value).value
            if descriptor.type == Parameter.Type.NOT_SET.value:
                raise ValueError(f'{name}: expected a default, or a type, or dynamic_typing')
        if not ignore_override and name in self.overrides:
            value = self.overrides[name].value
        return Parameter(name, value=value), descriptor

    def undeclare(self, name: str) -> None:
        """Undeclare a parameter.

        Raises:
            ParameterNotDeclaredException: the parameter is not declared.
            ParameterImmutableException: the parameter is read-only.
        """
        with self._lock:
            if self._descriptor(name).read_only:
                raise ParameterImmutableException(name)
            del self._values[name], self._descriptors[name]

    # Reading

    def has(self, name: str) -> bool:
        """Return whether a parameter is declared."""
        return name in self._values

    def get(self, name: str) -> Parameter:
        """Return a parameter.

        Raises:
            ParameterNotDeclaredException: the parameter is not declared.
            ParameterUninitializedException: the parameter has a type but no value yet.
        """
        self._descriptor(name)
        found = self._values[name]
        if found.type_ == Parameter.Type.NOT_SET and not self._descriptors[name].dynamic_typing:
            raise ParameterUninitializedException(name)
        return found

    def get_or_unset(self, name: str) -> Parameter:
        """Return a parameter; one without value if it is not declared."""
        return self._values.get(name) or Parameter(name)

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
        return self._descriptor(name)

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

    def _descriptor(self, name: str) -> Any:
        if name not in self._values:
            raise ParameterNotDeclaredException(name)
        return self._descriptors[name]

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

    def _set(self, parameters: Sequence[Parameter], new: dict[str, Any] | None = None) -> Any:
        """Set parameters; ``new`` contains the descriptors of parameters being declared."""
        with self._lock:
            try:
                for parameter in parameters:
                    self._check(parameter, (new or self._descriptors).get(parameter.name), new)
            except _Rejected as rejection:
                return _message('SetParametersResult', reason=str(rejection))
            for callback in list(self.callbacks):
                result = callback(list(parameters))
                if not result.successful:
                    return result
            event = _message('ParameterEvent', node=self._node_name)
            for parameter in parameters:
                name = parameter.name
                if new is None and parameter.type_ == Parameter.Type.NOT_SET:
                    event.deleted_parameters.append(parameter.to_parameter_msg())
                    self._values.pop(name, None)
                    self._descriptors.pop(name, None)
                    continue
                if new is not None:
                    self._descriptors[name] = new[name]
                self._descriptors.setdefault(
                    name,
                    _message(
                        'ParameterDescriptor',
                        name=name,
                        type=parameter.type_.value,
                        dynamic_typing=True,
                    ),
                )
                is_new = self.get_or_unset(name).type_ == Parameter.Type.NOT_SET
                (event.new_parameters if is_new else event.changed_parameters).append(
                    parameter.to_parameter_msg()
                )
                self._values[name] = parameter
        self._on_change(event)
        for post in list(self.post_callbacks):
            post(list(parameters))
        return _message('SetParametersResult', successful=True)

    def _check(self, parameter: Parameter, descriptor: Any, declared: Any) -> None:
        """Raise _Rejected if a descriptor does not allow a value."""
        if descriptor is None:
            return
        descriptor.name = parameter.name
        name, kind, value = parameter.name, parameter.type_, parameter.value
        if declared is None and descriptor.read_only:
            raise _Rejected(f'Trying to set a read-only parameter: {name}.')
        if descriptor.dynamic_typing:
            descriptor.type = kind.value
        elif kind == Parameter.Type.NOT_SET:
            if self.has(name):
                raise _Rejected('Static parameter cannot be undeclared')
        elif kind.value != descriptor.type:
            # An empty list gets the type BYTE_ARRAY, but is a valid value of any array type.
            expected = Parameter.Type(descriptor.type)
            if kind == Parameter.Type.BYTE_ARRAY and expected in _ARRAYS and not len(value):
                parameter.type_ = expected
                return
            raise _Rejected(f"Wrong parameter type, expected '{expected}' got '{kind}'")
        if kind == Parameter.Type.INTEGER and descriptor.integer_range:
            low, high, step = _limits(descriptor.integer_range[0])
            if not low <= value <= high:
                raise _Rejected(_out_of_range(name, low, high, value))
            if step and value != high and (value - low) % step:
                raise _Rejected(_no_step(name, low, high, value, step))
        if kind == Parameter.Type.DOUBLE and descriptor.floating_point_range:
            low, high, step = _limits(descriptor.floating_point_range[0])
            if _close(value, low) or _close(value, high):
                return
            if not low < value < high:
                raise _Rejected(_out_of_range(name, low, high, value))
            if step and not _close(low + round((value - low) / step) * step, value):
                raise _Rejected(_no_step(name, low, high, value, step))


def _limits(limits: Any) -> tuple[Any, Any, Any]:
    low, high = sorted((limits.from_value, limits.to_value))
    return low, high, limits.step


def _close(a: float, b: float) -> bool:
    return math.isclose(a, b, rel_tol=_RELATIVE_TOLERANCE)


def _out_of_range(name: str, low: Any, high: Any, value: Any) -> str:
    return f'Parameter {name} out of range. Min: {low}, Max: {high}, value: {value}'


def _no_step(name: str, low: Any, high: Any, value: Any, step: Any) -> str:
    return (
        f'The parameter value for {name} is not a valid step. '
        f'Min: {low}, max: {high}, value: {value}, step: {step}'
    )
