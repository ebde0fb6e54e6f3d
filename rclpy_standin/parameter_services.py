# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Services that let other nodes read and set a node's parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy_standin.exceptions import ParameterNotDeclaredException
from rclpy_standin.parameters import Parameter, Parameters
from rclpy_standin.types import message_class, service_class


def create_parameter_services(node: Any, parameters: Parameters, qos: Any) -> None:
    """Create the services through which other nodes read and set a node's parameters."""

    def describe(request: Any, response: Any) -> Any:
        if all(map(parameters.has, request.names)):
            response.descriptors = [parameters.describe(name) for name in request.names]
        return response

    def types(request: Any, response: Any) -> Any:
        if all(map(parameters.has, request.names)):
            response.types = [parameters.get(name).type_.value for name in request.names]
        return response

    def get(request: Any, response: Any) -> Any:
        if all(map(parameters.has, request.names)):
            response.values = [parameters.get(n).get_parameter_value() for n in request.names]
        return response

    def list_names(request: Any, response: Any) -> Any:
        response.result = parameters.list(request.prefixes, request.depth)
        return response

    def set_all(entries: Sequence[Any]) -> Any:
        try:
            return parameters.set([Parameter.from_parameter_msg(entry) for entry in entries])
        except (ParameterNotDeclaredException, ValueError) as error:
            return message_class('rcl_interfaces/msg/SetParametersResult')(reason=str(error))

    def set_each(request: Any, response: Any) -> Any:
        response.results = [set_all([entry]) for entry in request.parameters]
        return response

    def set_atomically(request: Any, response: Any) -> Any:
        response.result = set_all(request.parameters)
        return response

    for name, short, callback in (
        ('DescribeParameters', 'describe_parameters', describe),
        ('GetParameterTypes', 'get_parameter_types', types),
        ('GetParameters', 'get_parameters', get),
        ('ListParameters', 'list_parameters', list_names),
        ('SetParameters', 'set_parameters', set_each),
        ('SetParametersAtomically', 'set_parameters_atomically', set_atomically),
    ):
        kind = service_class(f'rcl_interfaces/srv/{name}')
        node.create_service(kind, f'~/{short}', callback, qos_profile=qos)
