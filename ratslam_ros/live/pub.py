# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam pub``: publish messages on a topic."""

from __future__ import annotations

import time
from collections.abc import Sequence

import rclpy
from rclpy.duration import Duration
from rosidl_runtime_py.utilities import get_message

from ratslam_ros.errors import NoAnswer, UnusableInput
from ratslam_ros.live import graph, ros
from ratslam_ros.live.call import set_fields
from ratslam_ros.live.echo import message_of_name
from ratslam_ros.live.sending import send
from ratslam_ros.ros.qos import LATCHED

ACKNOWLEDGE_TIMEOUT_S = 5.0
"""Longest time to wait until all subscribers have received a message of a limited number."""


def pub(
    topic: str, kind: str, values: str, times: int | None, rate_hz: float, timeout_s: float,
    ros_arguments: Sequence[str],
) -> None:
    """Publish a message repeatedly, and print each.

    Args:
        topic: name of the topic.
        kind: message type, such as std_msgs/msg/String.
        values: the fields as YAML; as for ``ros2 topic pub``, a header may be ``auto`` and a
            stamp ``now``, which is the time of each publication.
        times: number of messages, None: until interrupted; with a number, a subscriber is awaited
            first.
        rate_hz: messages per second.
        timeout_s: longest time to wait for a subscriber.
        ros_arguments: what follows ``--ros-args``.

    Raises:
        UnusableInput: the type does not exist, is not that of the topic, or does not fit.
        NoAnswer: no node has subscribed in time.
    """
    message = message_of_name(kind)()
    set_stamps = set_fields(message, kind, values)
    with ros.node('_ratslam_pub', ros_arguments) as node:
        name = node.resolve_topic_name(topic)
        publisher = node.create_publisher(type(message), name, LATCHED)

        def is_subscribed() -> bool:
            kinds = dict(node.get_topic_names_and_types()).get(name, [])
            if others := [one for one in kinds if get_message(one) is not type(message)]:
                raise UnusableInput(f'{name} is of type {", ".join(others)}, not {kind}')
            return bool(publisher.get_subscription_count())

        if times and not graph.until(is_subscribed, timeout_s):
            raise NoAnswer(
                f'no node has subscribed to {name} within {timeout_s:g} s '
                f'({graph.describe_topics(node)})'
            )
        count, next_s = 0, time.monotonic()
        while times is None or count < times:
            while (left_s := next_s - time.monotonic()) > 0.0:
                rclpy.spin_once(node, timeout_sec=left_s)
            next_s += 1.0 / rate_hz
            for set_stamp in set_stamps:
                set_stamp(node.get_clock().now().to_msg())
            count += 1
            print(f'publishing #{count}: {message!r}\n', flush=True)
            send(publisher, message)
            if times:
                publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_TIMEOUT_S))
