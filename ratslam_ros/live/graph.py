# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Description of the visible ROS graph, for error messages."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

POLL_S = 0.02
MAX_NAME_COUNT = 12

_OF_EVERY_NODE = (
    '/describe_parameters', '/get_parameter_types', '/get_parameters', '/list_parameters',
    '/set_parameters', '/set_parameters_atomically', '/get_type_description',
)
_OF_ROS = ('/rosout', '/parameter_events')


def until(condition: Callable[[], bool], timeout_s: float) -> bool:
    """Wait for a condition on the graph; return whether it was met in time."""
    end_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() >= end_s:
            return False
        time.sleep(POLL_S)
    return True


def describe_services(node: Any) -> str:
    """List the available services, except those that every node has."""
    names = [name for name, _ in node.get_service_names_and_types()]
    return _listed('services', [name for name in names if not name.endswith(_OF_EVERY_NODE)])


def describe_topics(node: Any) -> str:
    """List the published topics."""
    names = [name for name, _ in node.get_topic_names_and_types() if name not in _OF_ROS]
    return _listed('topics', [name for name in names if node.count_publishers(name)])


def _listed(what: str, names: list[str]) -> str:
    if not names:
        return f'no {what} are visible; check ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE'
    more = f' and {len(names) - MAX_NAME_COUNT} more' if len(names) > MAX_NAME_COUNT else ''
    return f'visible {what}: {", ".join(sorted(names)[:MAX_NAME_COUNT])}{more}'
