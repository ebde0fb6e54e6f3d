# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ratslam echo: what is published on a topic."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import rclpy
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosidl_runtime_py import message_to_yaml
from rosidl_runtime_py.utilities import get_message

from ratslam_ros.errors import UnusableInput
from ratslam_ros.live import graph, ros

FIND_S = 5.0
LONGEST = 128  # characters or numbers of one field that are shown; --field shows all
DEPTH = 100


@dataclass(frozen=True)
class EchoOptions:
    """What is shown, and how long it is waited for."""

    kind: str | None = None
    once: bool = False
    field: str | None = None
    timeout_s: float = math.inf


def echo(topic: str, options: EchoOptions, ros_arguments: Sequence[str] = ()) -> None:
    """Print messages, with ``---`` between them, until interrupted or once.

    Raises:
        UnusableInput: the topic, type or field does not exist.
        Silence: no message came for the time allowed.
    """
    message_type = None if options.kind is None else message_of_name(options.kind)
    with ros.node('_ratslam_echo', ros_arguments) as node:
        name = node.resolve_topic_name(topic)
        found = _find(node, name, options)
        if message_type is None:
            message_type = message_of_name(found)
        elif found and get_message(found) is not message_type:
            raise UnusableInput(f'{name} is of type {found}: expected {options.kind}')
        _show(node, name, message_type, options)


def message_of_name(kind: str) -> Any:
    """Return the message class of a name such as std_msgs/msg/String."""
    try:
        return get_message(kind)
    except (ImportError, AttributeError, ValueError, KeyError, LookupError):
        raise UnusableInput(
            f'{kind} is no message type that is known here: expected one such as '
            'std_msgs/msg/String'
        ) from None


def text_of(message: Any, field: str | None) -> str:
    """Return a message as YAML, or one of its fields as it is; raises UnusableInput."""
    if field is None:
        return str(message_to_yaml(message, truncate_length=LONGEST)).rstrip('\n') + '\n---'
    value = message
    for part in field.split('.'):
        try:
            value = value[int(part)] if part.isdecimal() else getattr(value, part)
        except (AttributeError, IndexError, TypeError):
            known: list[str] = list(getattr(value, 'get_fields_and_field_types', dict)())
            raise UnusableInput(
                f'--field {field}: there is no {part!r} in {type(value).__name__}'
                + (f': expected one of {", ".join(known)}' if known else '')
            ) from None
    if hasattr(value, 'get_fields_and_field_types'):
        return str(message_to_yaml(value)).rstrip('\n')
    if isinstance(value, (str, bool, int, float, bytes)):
        return str(value)
    return str([item.item() if hasattr(item, 'item') else item for item in value])


def _find(node: Any, name: str, options: EchoOptions) -> str:
    """Wait for a publisher; return the topic's type, '' if only its type argument is known."""
    limit_s = min(options.timeout_s, FIND_S if options.kind is None else math.inf)
    graph.until(lambda: bool(node.count_publishers(name)), limit_s)
    kinds = dict(node.get_topic_names_and_types()).get(name, [])
    if len(kinds) > 1 and options.kind is None:
        raise UnusableInput(f'{name} has the types {", ".join(kinds)}: give the one to show')
    if options.kind is not None:
        same = [kind for kind in kinds if get_message(kind) is get_message(options.kind)]
        return str((same or kinds or [''])[0])
    if not kinds:
        raise UnusableInput(f'{name} does not exist ({graph.topics(node)})')
    return str(kinds[0])


def _quality(node: Any, name: str) -> QoSProfile:
    """Return what fits all publishers of a topic, and asks for as much as they all offer."""
    offered = [info.qos_profile for info in node.get_publishers_info_by_topic(name)]
    reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
    latched = offered and all(
        qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered
    )
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _show(node: Any, name: str, message_type: Any, options: EchoOptions) -> None:
    shown = 0
    heard_s = time.monotonic()

    def take(message: Any) -> None:
        nonlocal shown, heard_s
        if options.once and shown:
            return
        print(text_of(message, options.field), flush=True)
        shown, heard_s = shown + 1, time.monotonic()

    node.create_subscription(message_type, name, take, _quality(node, name))
    while not (options.once and shown):
        rclpy.spin_once(node, timeout_sec=0.1)
        if time.monotonic() - heard_s > options.timeout_s:
            publishers = node.count_publishers(name)
            raise ros.Silence(
                f'no message on {name} for {options.timeout_s:g} s, '
                + (f'from {publishers} publishers' if publishers else graph.topics(node))
            )
