# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exceptions, named as rclpy names them."""

from __future__ import annotations

from typing import Any


class RCLError(RuntimeError):
    """Something that the layer below refused."""


class InvalidHandle(Exception):  # noqa: N818
    """Something was used after it had been destroyed."""


class UnknownROSArgsError(RuntimeError):
    """Arguments after --ros-args that ROS does not know."""


class RCLInvalidROSArgsError(RCLError):
    """Arguments after --ros-args that are malformed."""


class NotInitializedException(Exception):  # noqa: N818
    """rclpy.init() has not been called, or the context has been shut down."""

    def __init__(self, message: str | None = None) -> None:
        super().__init__('rclpy.init() has not been called.' + (f' {message}' if message else ''))


class NameValidationException(Exception):  # noqa: N818
    """A name that ROS does not allow."""

    KIND = 'name'

    def __init__(self, name: str, error_msg: str, invalid_index: int = 0) -> None:
        self.name, self.error_msg, self.invalid_index = name, error_msg, invalid_index
        super().__init__(f'Invalid {self.KIND}: {error_msg}: {name!r}, at index {invalid_index}')


class InvalidNamespaceException(NameValidationException):
    """A namespace that ROS does not allow."""

    KIND = 'namespace'


class InvalidNodeNameException(NameValidationException):
    """A node name that ROS does not allow."""

    KIND = 'node name'


class InvalidTopicNameException(NameValidationException):
    """A topic name that ROS does not allow."""

    KIND = 'topic name'


class InvalidServiceNameException(NameValidationException):
    """A service name that ROS does not allow."""

    KIND = 'service name'


class ParameterException(Exception):  # noqa: N818
    """Base of all that is wrong with parameters."""

    def __init__(self, error_msg: str, parameters: Any) -> None:
        super().__init__(f'{error_msg}: {parameters}')


class ParameterNotDeclaredException(ParameterException):
    """A parameter that was never declared."""

    def __init__(self, parameters: Any) -> None:
        super().__init__('Invalid access to undeclared parameter(s)', parameters)


class ParameterAlreadyDeclaredException(ParameterException):
    """A parameter that is declared a second time."""

    def __init__(self, parameters: Any) -> None:
        super().__init__('Parameter(s) already declared', parameters)


class InvalidParameterException(ParameterException):
    """A parameter name that ROS does not allow."""

    def __init__(self, parameter_name: str) -> None:
        super().__init__('Invalid parameter name', parameter_name)


class InvalidParameterTypeException(ParameterException):
    """A parameter was given a value of another type than it has."""

    def __init__(self, desired_parameter: Any, expected_type: Any) -> None:
        super().__init__(
            f'Trying to set parameter {desired_parameter.name!r} to '
            f'{desired_parameter.value!r} of type {desired_parameter.type_.name!r}, '
            f'expecting type {expected_type!r}',
            desired_parameter.name,
        )


class InvalidParameterValueException(ParameterException):
    """A parameter's value was refused."""

    def __init__(self, parameter: str, value: Any, reason: str) -> None:
        super().__init__(
            f'Invalid parameter value ({value!r}) for parameter. Reason: {reason}', parameter
        )


class ParameterImmutableException(ParameterException):
    """A read-only parameter was to be undeclared."""

    def __init__(self, parameter_name: str) -> None:
        super().__init__('Attempted to modify read-only parameter', parameter_name)


class ParameterUninitializedException(ParameterException):
    """A parameter that was declared with a type alone has no value yet."""

    def __init__(self, parameter_name: str) -> None:
        super().__init__(
            'The parameter is not initialized, and its type is not dynamic', parameter_name
        )


class ROSInterruptException(Exception):  # noqa: N818
    """An operation was interrupted by shutdown."""

    def __init__(self) -> None:
        super().__init__('rclpy.shutdown() has been called')
