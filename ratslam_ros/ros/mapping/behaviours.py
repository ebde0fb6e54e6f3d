# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Behaviour reports of the robot, which label new links and report blocked attempts."""

from __future__ import annotations

from bisect import insort
from collections import deque
from collections.abc import Callable

from rclpy.node import Node
from std_msgs.msg import String

from ratslam_ros.core.common.state import State
from ratslam_ros.messages.goals import BehaviourReport
from ratslam_ros.messages.json_schema import decode, encode
from ratslam_ros.ros.decoded import decoded
from ratslam_ros.ros.qos import RESULT

VALIDITY_NS = 2_000_000_000
"""Time for which a report applies if no other follows; reports must come more often than this."""

MAX_WAITING = 10_000


class Behaviours:
    """Queue of behaviour reports that are applied when the map reaches their stamps.

    The map does not wait for reports, since a robot need not send any. A report that arrives
    after the map has passed its stamp applies from then on.
    """

    def __init__(
        self, node: Node, refuse: Callable[[str, str], None],
        log: Callable[[str, int, Callable[[], bytes]], None],
    ) -> None:  # fmt: skip
        """Subscribe.

        Args:
            node: the node that subscribes.
            refuse: called with the stream and the reason for a message that cannot be used.
            log: called with the stream, the stamp and the message of each report.
        """
        self._refuse, self._log = refuse, log
        self._waiting: deque[BehaviourReport] = deque(maxlen=MAX_WAITING)
        self._current = BehaviourReport.of(-VALIDITY_NS, '')
        node.create_subscription(String, 'goal_follower/behaviour', self._on_report, RESULT)

    def reset(self) -> None:
        """Drop all reports."""
        self._waiting.clear()
        self._current = BehaviourReport.of(-VALIDITY_NS, '')

    def state(self) -> State:
        """Return the current report and those that wait, for ``restore``."""
        return {'reports': [
            [one.stamp.ns, one.behaviour, one.failed, one.ahead_rad]
            for one in (self._current, *self._waiting)
        ]}  # fmt: skip

    def restore(self, state: State) -> None:
        """Restore what ``state`` returned."""
        self._current, *waiting = (BehaviourReport.of(*one) for one in state['reports'])
        self._waiting.clear()
        self._waiting.extend(waiting)

    def replay(self, payload: str) -> None:
        """Take a report from the log again, unless it is known."""
        report = decode(BehaviourReport, payload)
        waiting = [*self._waiting]
        known_ns = {one.stamp.ns for one in waiting}
        if report.stamp.ns > self._current.stamp.ns and report.stamp.ns not in known_ns:
            insort(waiting, report, key=lambda one: one.stamp.ns)
            self._waiting = deque(waiting, MAX_WAITING)

    def at(self, stamp_ns: int) -> str:
        """Return the reported behaviour at a stamp, or an empty string if there is none."""
        return self._current.behaviour if stamp_ns - self._current.stamp.ns <= VALIDITY_NS else ''

    def take(self, stamp_ns: int) -> list[BehaviourReport]:
        """Apply the reports up to a stamp; return those of failed attempts, in order."""
        failed = []
        while self._waiting and self._waiting[0].stamp.ns <= stamp_ns:
            self._current = self._waiting.popleft()
            if self._current.failed:
                failed.append(self._current)
        return failed

    @decoded(BehaviourReport, 'behaviour')
    def _on_report(self, report: BehaviourReport) -> None:
        last = self._waiting[-1] if self._waiting else self._current
        if report.stamp.ns < last.stamp.ns:
            self._refuse('behaviour', 'its stamp is before that of the last report')
            return
        self._waiting.append(report)
        self._log('behaviour', report.stamp.ns, encode(report).encode)
