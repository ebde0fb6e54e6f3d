# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exceptions of rclpy."""

from __future__ import annotations

from typing import Any


class RCLError(RuntimeError):
    """An error of the underlying DDS layer."""


class InvalidHandle(Exception):  # noqa: N818
    """An entity was used after its destruction."""


class UnknownROSArgsError(RuntimeError):
    """Unknown arguments after --ros-args."""


class RCLInvalidROSArgsError(RCLError):
    """Malformed arguments after --ros-args."""


class NotInitializedException(Exception):  # noqa: N818
    """rclpy.init() has not been called, or the context has been shut down."""

    def __init__(self, message: str | None = None) -> None:
        super().__init__('rclpy.init() has not been called.' + (f' {message}' if message else ''))


class NameValidationException(Exception):  # noqa: N818
    """An invalid name."""

    KIND = 'name'

    def __init__(self, name: str, error_msg: str, invalid_index: int = 0) -> None:
        self.name, self.error_msg, self.invalid_index = name, error_msg, invalid_index
        super().__init__(f'Invalid {self.KIND}: {error_msg}: {name!r}, at index {invalid_index}')


class InvalidNamespaceException(NameValidationException):
    """An invalid namespace."""

    KIND = 'namespace'


class InvalidNodeNameException(NameValidationException):
    """An invalid node name."""

    KIND = 'node name'


class InvalidTopicNameException(NameValidationException):
    """An invalid topic name."""

    KIND = 'topic name'


class InvalidServiceNameException(NameValidationException):
    """An invalid service name."""

    KIND = 'service name'


class ParameterException(Exception):  # noqa: N818
    """Base class of parameter errors."""

    TEXT = 'Parameter error'

    def __init__(self, parameters: Any) -> None:
        super().__init__(f'{self.TEXT}: {parameters}')


class ParameterNotDeclaredException(ParameterException):
    """Access to a parameter that is not declared."""

    TEXT = 'Invalid access to undeclared parameter(s)'


class ParameterAlreadyDeclaredException(ParameterException):
    """A second declaration of a parameter."""

    TEXT = 'Parameter(s) already declared'


class InvalidParameterException(ParameterException):
    """An invalid parameter name."""

    TEXT = 'Invalid parameter name'


class InvalidParameterTypeException(ParameterException):
    """A value whose type differs from the type of the parameter."""

    def __init__(self, desired_parameter: Any, expected_type: Any) -> None:
        self.TEXT = (
            f'Trying to set parameter {desired_parameter.name!r} to '
            f'{desired_parameter.value!r} of type {desired_parameter.type_.name!r}, '
            f'expecting type {expected_type!r}'
        )
        super().__init__(desired_parameter.name)


class InvalidParameterValueException(ParameterException):
    """A parameter value that was rejected."""

    def __init__(self, parameter: str, value: Any, reason: str) -> None:
        self.TEXT = f'Invalid parameter value ({value!r}) for parameter. Reason: {reason}'
        super().__init__(parameter)


class ParameterImmutableException(ParameterException):
    """An attempt to undeclare a read-only parameter."""

    TEXT = 'Attempted to modify read-only parameter'
