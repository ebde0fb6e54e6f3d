# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One sender per topic: if two nodes publish templates or actions, only those of one are used.

The ids in these messages are numbers of the sender's memory, so messages of two senders would
corrupt the map. It happens if two launch files run at once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import String

from ratslam_ros.messages.mapping import UNKNOWN_SENDER, sender_of
from ratslam_ros.ros.inputs import publisher_count

HOLD_S = 0.5
"""Wall-clock time for which messages of a new sender wait for one of the present sender. Two that
process the same images send within milliseconds of each other; a sender that has ended remains in
the graph for seconds if it was killed."""

MAX_HELD = 1000
"""Number of messages that may wait; the oldest are dropped."""


class SingleSender:
    """Passes on the messages of one sender of a topic, and of its successor when it has ended."""

    def __init__(
        self, node: Node, topic: str, deliver: Callable[[String], None],
        report: Callable[[str], None],
    ) -> None:  # fmt: skip
        """Remember what to do; nothing is subscribed.

        Args:
            node: the receiver.
            topic: the topic.
            deliver: receives the messages of one sender.
            report: receives a line about each message of another one, which is ignored.
        """
        self._node, self._topic = node, topic
        self._deliver, self._report = deliver, report
        self._sender = UNKNOWN_SENDER
        self._held: deque[String] = deque(maxlen=MAX_HELD)
        self._timer = node.create_timer(
            HOLD_S, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._timer.cancel()

    def take(self, message: String) -> None:
        """Pass on a message of the sender, or decide later whether another one has replaced it."""
        sender = sender_of(message.data)
        if sender in (UNKNOWN_SENDER, self._sender) or self._sender == UNKNOWN_SENDER:
            if sender != UNKNOWN_SENDER:
                self._sender = sender
            if self._held:  # Both are alive.
                self._held.clear()
                self._timer.cancel()
                self._report_other()
            self._deliver(message)
        elif publisher_count(self._node, self._topic) <= 1:
            self._replace(sender)
            self._deliver(message)
        else:
            if not self._held:
                self._timer.reset()
            self._held.append(message)

    def _on_timer(self) -> None:
        """Use the new sender: the present one has not sent anything since its first message."""
        self._timer.cancel()
        if self._held:
            self._replace(sender_of(self._held[-1].data))

    def _replace(self, sender: int) -> None:
        held = [message for message in self._held if sender_of(message.data) == sender]
        self._held.clear()
        self._timer.cancel()
        self._sender = sender
        for message in held:
            self._deliver(message)

    def _report_other(self) -> None:
        topic = self._node.resolve_topic_name(self._topic)
        names = sorted(
            f'{info.node_namespace.rstrip("/")}/{info.node_name}'
            for info in self._node.get_publishers_info_by_topic(topic)
        )
        self._report(
            f'two nodes publish it ({" and ".join(names)}); the messages of the first one are '
            'used, and the others are ignored: end one of the two, such as a second launch file'
        )
