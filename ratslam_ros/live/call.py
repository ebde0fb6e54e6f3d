# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ratslam call: one request to a service."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import rclpy
import yaml
from rosidl_runtime_py import message_to_yaml, set_message_fields
from rosidl_runtime_py.utilities import get_service

from ratslam_ros.errors import UnusableInput
from ratslam_ros.live import graph, ros


def call(
    service: str, kind: str, values: str, timeout_s: float, ros_arguments: Sequence[str] = ()
) -> str:
    """Call a service, and return its answer as YAML.

    Raises:
        UnusableInput: the service or its type does not exist, or the values do not fit it.
        Silence: the service is there and gave no answer.
    """
    service_type = _type(kind)
    request = request_of(service_type, kind, values)
    with ros.node('_ratslam_call', ros_arguments) as node:
        name = node.resolve_service_name(service)
        client = node.create_client(service_type, name)
        end_s = time.monotonic() + timeout_s
        if not client.wait_for_service(timeout_sec=timeout_s):
            node.destroy_client(client)  # which is in the graph too
            kinds = dict(node.get_service_names_and_types()).get(name)
            if kinds:
                raise UnusableInput(f'{name} is of type {", ".join(kinds)}, not {kind}')
            raise UnusableInput(f'nobody offers {name} ({graph.services(node)})')
        future = client.call_async(request)
        while not future.done():
            rclpy.spin_once(node, timeout_sec=0.1)
            if time.monotonic() > end_s and not future.done():
                raise ros.Silence(
                    f'{name} gave no answer within {timeout_s:g} s; between a machine with ROS '
                    'and one without, services need RMW_IMPLEMENTATION=rmw_cyclonedds_cpp'
                )
        return str(message_to_yaml(future.result())).rstrip('\n')


def request_of(service_type: Any, kind: str, values: str) -> Any:
    """Return the request that a YAML text asks for; raises UnusableInput."""
    try:
        fields = yaml.safe_load(values) if values.strip() else {}
    except yaml.YAMLError as error:
        raise UnusableInput(f'{values!r} is no YAML: {" ".join(str(error).split())}') from None
    request = service_type.Request()
    known = ', '.join(request.get_fields_and_field_types()) or 'no fields'
    if not isinstance(fields or {}, Mapping):
        raise UnusableInput(f'{values!r}: expected fields such as "{{data: true}}" ({known})')
    try:
        set_message_fields(request, fields or {})
    except (AttributeError, TypeError, ValueError, AssertionError) as error:
        told = ' '.join(str(error).split())
        raise UnusableInput(
            f'{values!r} does not fit {kind}: {told}; its request has {known}'
        ) from None
    return request


def _type(kind: str) -> Any:
    try:
        return get_service(kind)
    except (ImportError, AttributeError, ValueError, KeyError, LookupError):
        raise UnusableInput(
            f'{kind} is no service type that is known here: expected one such as '
            'std_srvs/srv/Trigger'
        ) from None
