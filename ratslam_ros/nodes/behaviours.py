# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the robot says that it does -> the behaviour of a link, and tries that have failed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from rclpy.node import Node
from std_msgs.msg import String

from ratslam_ros.messages.goals import BehaviourReport, decode_behaviour
from ratslam_ros.messages.json_schema import MalformedMessage
from ratslam_ros.nodes.qos import RESULT

HOLDS_NS = 2_000_000_000
"""Who steers the robot says so more often than this; after it, nobody does."""

MOST_WAITING = 10_000


class Behaviours:
    """Notes of what the robot does, until the map has come as far as their stamps.

    Nothing waits for them, as a robot need not tell what it does: a note that comes after the
    map has gone past its stamp is used for what comes next.
    """

    def __init__(self, node: Node, refuse: Callable[[str, str], None]) -> None:
        """Listen.

        Args:
            node: that takes the messages.
            refuse: called with the stream and the reason for a message that cannot be used.
        """
        self._refuse = refuse
        self._waiting: deque[BehaviourReport] = deque(maxlen=MOST_WAITING)
        self._now = BehaviourReport(-HOLDS_NS, '')
        node.create_subscription(String, 'goal_follower/behaviour', self._on_note, RESULT)

    def forget(self) -> None:
        """Begin anew."""
        self._waiting.clear()
        self._now = BehaviourReport(-HOLDS_NS, '')

    def at(self, stamp_ns: int) -> str:
        """Return the behaviour at a stamp, empty if nobody tells."""
        return self._now.behaviour if stamp_ns - self._now.stamp_ns <= HOLDS_NS else ''

    def take(self, stamp_ns: int) -> list[BehaviourReport]:
        """Go on to a stamp; return the tries up to it that have failed, the first one first."""
        failed = []
        while self._waiting and self._waiting[0].stamp_ns <= stamp_ns:
            self._now = self._waiting.popleft()
            if self._now.failed:
                failed.append(self._now)
        return failed

    def _on_note(self, message: String) -> None:
        try:
            note = decode_behaviour(message.data)
        except MalformedMessage as error:
            self._refuse('behaviour', str(error))
            return
        last = self._waiting[-1] if self._waiting else self._now
        if note.stamp_ns < last.stamp_ns:
            self._refuse('behaviour', 'its stamp is before that of the last one')
            return
        self._waiting.append(note)
