# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam call``: call a service."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import rclpy
import yaml
from rosidl_runtime_py import message_to_yaml, set_message_fields
from rosidl_runtime_py.utilities import get_service

from ratslam_ros.errors import NoAnswer, UnusableInput
from ratslam_ros.live import graph, ros


def call(
    service: str, kind: str, values: str, timeout_s: float, ros_arguments: Sequence[str] = ()
) -> str:
    """Call a service.

    Args:
        service: name of the service.
        kind: type of the service, such as std_srvs/srv/Trigger.
        values: the request as YAML; '' for the default values.
        timeout_s: time to wait for the service and its response.
        ros_arguments: what follows ``--ros-args``.

    Returns:
        The response as YAML.

    Raises:
        UnusableInput: the service or its type does not exist, or the values do not fit it.
        NoAnswer: the service exists but did not respond in time.
    """
    service_type = ros.found(get_service, kind, 'service', 'std_srvs/srv/Trigger')
    request = service_type.Request()
    set_stamps = set_fields(request, kind, values)
    with ros.node('_ratslam_call', ros_arguments) as node:
        name = node.resolve_service_name(service)
        client = node.create_client(service_type, name)
        end_s = time.monotonic() + timeout_s
        if not client.wait_for_service(timeout_sec=timeout_s):
            # The client itself is in the graph, and for a while after its end.
            node.destroy_client(client)
            kinds = set(dict(node.get_service_names_and_types()).get(name, ())) - {kind}
            if kinds:
                raise UnusableInput(f'{name} is of type {", ".join(sorted(kinds))}, not {kind}')
            raise UnusableInput(f'no node offers {name} ({graph.describe_services(node)})')
        for set_stamp in set_stamps:
            set_stamp(node.get_clock().now().to_msg())
        future = client.call_async(request)
        while not future.done():
            rclpy.spin_once(node, timeout_sec=0.1)
            if time.monotonic() > end_s and not future.done():
                raise NoAnswer(
                    f'{name} did not respond within {timeout_s:g} s; between a machine with ROS '
                    'and one without, services need RMW_IMPLEMENTATION=rmw_cyclonedds_cpp'
                )
        return str(message_to_yaml(future.result())).rstrip('\n')


def set_fields(message: Any, kind: str, values: str) -> list[Callable[[Any], None]]:
    """Set the fields of a message or request from YAML.

    Args:
        message: the message.
        kind: its type.
        values: the fields as YAML; '' leaves the default values.

    Returns:
        Functions that set the stamps given as ``auto`` or ``now``.

    Raises:
        UnusableInput: the text is not YAML, or does not fit the type.
    """
    try:
        fields = yaml.safe_load(values) if values.strip() else {}
    except yaml.YAMLError as error:
        raise UnusableInput(f'{values!r} is not YAML: {" ".join(str(error).split())}') from None
    names = ', '.join(message.get_fields_and_field_types()) or 'no fields'
    if not isinstance(fields or {}, Mapping):
        raise UnusableInput(f'{values!r}: expected fields such as "{{data: true}}" ({names})')
    try:
        return list(set_message_fields(
            message, fields or {}, expand_header_auto=True, expand_time_now=True
        ))
    except (AttributeError, TypeError, ValueError, AssertionError) as error:
        raise UnusableInput(f'{values!r} does not fit {kind}: {error}; it has {names}') from None
