# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam echo``: print the messages of a topic."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import rclpy
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosidl_runtime_py import message_to_yaml
from rosidl_runtime_py.utilities import get_message

from ratslam_ros.errors import NoAnswer, UnusableInput
from ratslam_ros.live import graph, ros

DISCOVERY_TIMEOUT_S = 5.0
"""Time to wait for a publisher if the message type is not given."""

MAX_FIELD_LENGTH = 128
"""Largest number of characters or array elements printed of one field; --field prints all."""

QUEUE_DEPTH = 100


def echo(
    topic: str, kind: str | None, once: bool, field: str | None, timeout_s: float,
    ros_arguments: Sequence[str],
) -> None:
    """Print messages, separated by ``---``, until interrupted or once.

    Args:
        topic: name of the topic.
        kind: message type, None for that of the publishers.
        once: stop after one message.
        field: dotted path of the field to print, None for the whole message.
        timeout_s: largest time without a message.
        ros_arguments: what follows ``--ros-args``.

    Raises:
        UnusableInput: the topic, type or field does not exist.
        NoAnswer: no message arrived in time.
    """
    message_type = None if kind is None else message_of_name(kind)
    with ros.node('_ratslam_echo', ros_arguments) as node:
        name = node.resolve_topic_name(topic)
        found = _find(node, name, kind, timeout_s)
        if message_type is None:
            message_type = message_of_name(found)
        elif found and get_message(found) is not message_type:
            raise UnusableInput(f'{name} is of type {found}: expected {kind}')
        _print_messages(node, name, message_type, once, field, timeout_s)


def message_of_name(kind: str) -> Any:
    """Return the message class of a type name such as std_msgs/msg/String; see ``ros.found``."""
    return ros.found(get_message, kind, 'message', 'std_msgs/msg/String')


def text_of(message: Any, field: str | None) -> str:
    """Format a message as YAML, or one of its fields in full length.

    Raises:
        UnusableInput: the field does not exist.
    """
    if field is None:
        text = str(message_to_yaml(message, truncate_length=MAX_FIELD_LENGTH))
        return text.rstrip('\n') + '\n---'
    value = message
    for part in field.split('.'):
        try:
            value = value[int(part)] if part.isdecimal() else getattr(value, part)
        except (AttributeError, IndexError, TypeError):
            names: list[str] = list(getattr(value, 'get_fields_and_field_types', dict)())
            raise UnusableInput(
                f'--field {field}: {type(value).__name__} has no {part!r}'
                + (f': expected one of {", ".join(names)}' if names else '')
            ) from None
    if hasattr(value, 'get_fields_and_field_types'):
        return str(message_to_yaml(value)).rstrip('\n')
    if isinstance(value, (str, bool, int, float, bytes)):
        return str(value)
    return str([item.item() if hasattr(item, 'item') else item for item in value])


def _find(node: Any, name: str, kind: str | None, timeout_s: float) -> str:
    """Wait for a publisher; return the type of the topic, or '' if it has no publisher."""
    limit_s = min(timeout_s, DISCOVERY_TIMEOUT_S if kind is None else math.inf)
    graph.until(lambda: bool(node.count_publishers(name)), limit_s)
    kinds = dict(node.get_topic_names_and_types()).get(name, [])
    if len(kinds) > 1 and kind is None:
        raise UnusableInput(f'{name} has the types {", ".join(kinds)}: give the one to print')
    if kind is not None:
        same = [one for one in kinds if get_message(one) is get_message(kind)]
        return str((same or kinds or [''])[0])
    if not kinds:
        raise UnusableInput(f'{name} does not exist ({graph.describe_topics(node)})')
    return str(kinds[0])


def _compatible_qos(node: Any, name: str) -> QoSProfile:
    """Return the strictest QoS profile that is compatible with all publishers of a topic."""
    offered = [info.qos_profile for info in node.get_publishers_info_by_topic(name)]
    reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
    latched = offered and all(
        qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered
    )
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=QUEUE_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _print_messages(
    node: Any, name: str, message_type: Any, once: bool, field: str | None, timeout_s: float
) -> None:
    printed_count = 0
    last_s = time.monotonic()

    def receive(message: Any) -> None:
        nonlocal printed_count, last_s
        if once and printed_count:
            return
        print(text_of(message, field), flush=True)
        printed_count, last_s = printed_count + 1, time.monotonic()

    node.create_subscription(message_type, name, receive, _compatible_qos(node, name))
    while not (once and printed_count):
        rclpy.spin_once(node, timeout_sec=0.1)
        if time.monotonic() - last_s > timeout_s:
            publishers = node.count_publishers(name)
            raise NoAnswer(
                f'no message on {name} for {timeout_s:g} s, '
                + (f'from {publishers} publishers' if publishers else graph.describe_topics(node))
            )
