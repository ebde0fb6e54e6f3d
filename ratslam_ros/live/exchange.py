# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam echo``, ``pub`` and ``call``: exchange messages and requests of any type.

Each command takes its parsed options, which cli/live_commands.py declares.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import rclpy
import yaml
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosidl_runtime_py import message_to_yaml, set_message_fields
from rosidl_runtime_py.utilities import get_message, get_service

from ratslam_ros.errors import NoAnswer, UnusableInput
from ratslam_ros.live import ros
from ratslam_ros.ros.qos import LATCHED

DISCOVERY_TIMEOUT_S = 5.0
"""Time to wait for a publisher if the message type is not given."""

ACKNOWLEDGE_TIMEOUT_S = 5.0
"""Longest time to wait until all subscribers have received a message of a limited number."""

MAX_FIELD_LENGTH = 128
"""Largest number of characters or array elements printed of one field; --field prints all."""

QUEUE_DEPTH = 100
POLL_S = 0.02
MAX_NAME_COUNT = 12

_OF_EVERY_NODE = (
    '/describe_parameters', '/get_parameter_types', '/get_parameters', '/list_parameters',
    '/set_parameters', '/set_parameters_atomically', '/get_type_description',
)
_OF_ROS = ('/rosout', '/parameter_events')


def call(options: argparse.Namespace) -> None:
    """Call a service, and print the response as YAML.

    Raises:
        UnusableInput: the service or its type does not exist, or the values do not fit it.
        NoAnswer: the service exists but did not respond in time.
    """
    kind, timeout_s = options.type, options.timeout
    service_type = _type(get_service, kind, 'service', 'std_srvs/srv/Trigger')
    request = service_type.Request()
    set_stamps = _set_fields(request, kind, options.values)
    with ros.node('_ratslam_call', options.ros_args) as node:
        name = node.resolve_service_name(options.service)
        client = node.create_client(service_type, name)
        end_s = time.monotonic() + timeout_s
        if not client.wait_for_service(timeout_sec=timeout_s):
            # The client itself is in the graph, and for a while after its end.
            node.destroy_client(client)
            kinds = set(dict(node.get_service_names_and_types()).get(name, ())) - {kind}
            if kinds:
                raise UnusableInput(f'{name} is of type {", ".join(sorted(kinds))}, not {kind}')
            raise UnusableInput(f'no node offers {name} ({_visible_services(node)})')
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
        print(str(message_to_yaml(future.result())).rstrip('\n'))


def pub(options: argparse.Namespace) -> None:
    """Publish a message repeatedly, and print each.

    As for ``ros2 topic pub``, a header may be ``auto`` and a stamp ``now``, which is the time of
    each publication. If the number of messages is given, a subscriber is awaited first.

    Raises:
        UnusableInput: the type does not exist, is not that of the topic, or does not fit.
        NoAnswer: no node has subscribed in time.
    """
    kind, times, timeout_s = options.type, options.times, options.timeout
    message = _message_type(kind)()
    set_stamps = _set_fields(message, kind, options.values)
    with ros.node('_ratslam_pub', options.ros_args) as node:
        name = node.resolve_topic_name(options.topic)
        publisher = node.create_publisher(type(message), name, LATCHED)

        def is_subscribed() -> bool:
            kinds = dict(node.get_topic_names_and_types()).get(name, [])
            if others := [one for one in kinds if get_message(one) is not type(message)]:
                raise UnusableInput(f'{name} is of type {", ".join(others)}, not {kind}')
            return bool(publisher.get_subscription_count())

        if times and not _until(is_subscribed, timeout_s):
            raise NoAnswer(
                f'no node has subscribed to {name} within {timeout_s:g} s '
                f'({_visible_topics(node)})'
            )
        count, next_s = 0, time.monotonic()
        while times is None or count < times:
            while (left_s := next_s - time.monotonic()) > 0.0:
                rclpy.spin_once(node, timeout_sec=left_s)
            next_s += 1.0 / options.rate
            for set_stamp in set_stamps:
                set_stamp(node.get_clock().now().to_msg())
            count += 1
            print(f'publishing #{count}: {message!r}\n', flush=True)
            ros.send(publisher, message)
            if times:
                publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_TIMEOUT_S))


def echo(options: argparse.Namespace) -> None:
    """Print messages, separated by ``---``, until interrupted or once.

    Raises:
        UnusableInput: the topic, type or field does not exist.
        NoAnswer: no message arrived in time.
    """
    kind = options.type
    given = None if kind is None else _message_type(kind)
    with ros.node('_ratslam_echo', options.ros_args) as node:
        name = node.resolve_topic_name(options.topic)
        limit_s = min(options.timeout, DISCOVERY_TIMEOUT_S if kind is None else math.inf)
        _until(lambda: bool(node.count_publishers(name)), limit_s)
        kinds = dict(node.get_topic_names_and_types()).get(name, [])
        if given is not None:
            if kinds and given not in map(get_message, kinds):
                raise UnusableInput(f'{name} is of type {kinds[0]}: expected {kind}')
        elif len(kinds) > 1:
            raise UnusableInput(f'{name} has the types {", ".join(kinds)}: give the one to print')
        elif not kinds:
            raise UnusableInput(f'{name} does not exist ({_visible_topics(node)})')
        _print_messages(node, name, given or _message_type(kinds[0]), options)


def _print_messages(
    node: Any, name: str, message_type: Any, options: argparse.Namespace
) -> None:
    once, timeout_s, printed_count = options.once, options.timeout, 0
    last_s = time.monotonic()

    def receive(message: Any) -> None:
        nonlocal printed_count, last_s
        if once and printed_count:
            return
        print(_text_of(message, options.field), flush=True)
        printed_count, last_s = printed_count + 1, time.monotonic()

    node.create_subscription(message_type, name, receive, _compatible_qos(node, name))
    while not (once and printed_count):
        rclpy.spin_once(node, timeout_sec=0.1)
        if time.monotonic() - last_s > timeout_s:
            publishers = node.count_publishers(name)
            raise NoAnswer(
                f'no message on {name} for {timeout_s:g} s, '
                + (f'from {publishers} publishers' if publishers else _visible_topics(node))
            )


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


def _text_of(message: Any, field: str | None) -> str:
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


# Types and values


def _message_type(kind: str) -> Any:
    return _type(get_message, kind, 'message', 'std_msgs/msg/String')


def _type(find: Callable[[str], Any], kind: str, what: str, example: str) -> Any:
    """Return the class of a message or service type.

    Raises:
        UnusableInput: the type is not installed.
    """
    try:
        return find(kind)
    except (ImportError, AttributeError, ValueError, LookupError):
        raise UnusableInput(
            f'the {what} type {kind} is not installed: expected one such as {example}'
        ) from None


def _set_fields(message: Any, kind: str, values: str) -> list[Callable[[Any], None]]:
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
        fields = (yaml.safe_load(values) if values.strip() else None) or {}
    except yaml.YAMLError as error:
        raise UnusableInput(f'{values!r} is not YAML: {" ".join(str(error).split())}') from None
    names = ', '.join(message.get_fields_and_field_types()) or 'no fields'
    if not isinstance(fields, Mapping):
        raise UnusableInput(f'{values!r}: expected fields such as "{{data: true}}" ({names})')
    try:
        return list(set_message_fields(
            message, fields, expand_header_auto=True, expand_time_now=True
        ))
    except (AttributeError, TypeError, ValueError, AssertionError) as error:
        raise UnusableInput(f'{values!r} does not fit {kind}: {error}; it has {names}') from None


# The visible graph


def _until(condition: Callable[[], bool], timeout_s: float) -> bool:
    """Wait for a condition on the graph; return whether it was met in time."""
    end_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() >= end_s:
            return False
        time.sleep(POLL_S)
    return True


def _visible_services(node: Any) -> str:
    """List the available services, except those that every node has."""
    names = [name for name, _ in node.get_service_names_and_types()]
    return _listed('services', [name for name in names if not name.endswith(_OF_EVERY_NODE)])


def _visible_topics(node: Any) -> str:
    """List the published topics."""
    names = [name for name, _ in node.get_topic_names_and_types() if name not in _OF_ROS]
    return _listed('topics', [name for name in names if node.count_publishers(name)])


def _listed(what: str, names: list[str]) -> str:
    if not names:
        return f'no {what} are visible; check ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE'
    more = f' and {len(names) - MAX_NAME_COUNT} more' if len(names) > MAX_NAME_COUNT else ''
    return f'visible {what}: {", ".join(sorted(names)[:MAX_NAME_COUNT])}{more}'
