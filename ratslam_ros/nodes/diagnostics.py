# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a node: counts, rates, step times, and warnings at a limited rate."""

from __future__ import annotations

import os
import re
import time
from collections import Counter
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from ratslam_ros.nodes.convert import time_of
from ratslam_ros.nodes.qos import STATE
from ratslam_ros.starting import RESTARTS
from ratslam_ros.timing import StepTimes

WARN_PERIOD_S = 5.0
"""Shortest time between two logged warnings that differ in numbers only."""
WARNING_SHOWN_S = 10.0
"""How long the diagnostics show the last warning."""
MAX_KINDS = 100
"""Kinds of warnings that are told apart: texts may quote messages, so kinds are unlimited."""

_NUMBER = re.compile(r'[-+]?\d[\d.]*(?:e[-+]?\d+)?')


class Diagnostics:
    """Counts and warnings of one node, published on /diagnostics."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', STATE)
        self.counts: Counter[str] = Counter()
        """Messages that were not used, by reason."""
        self.missing: dict[str, str] = {}
        """What the node lacks at present, by topic; the level is WARN until it is removed."""
        self.error = ''
        """Why what the node learns may be lost, '' if it is saved; the level is then ERROR."""
        self.times = StepTimes()
        self._notices: dict[str, None] = {}
        self._warned_s: dict[str, float] = {}
        self._suppressed: Counter[str] = Counter()
        self._last_warning = ''
        self._last_warning_s = -WARNING_SHOWN_S
        if os.environ.get(RESTARTS):
            self.note(os.environ[RESTARTS])

    def warn(self, text: str) -> None:
        """Show a warning; log it unless one that differs only in numbers was logged recently."""
        now_s = time.monotonic()
        self._last_warning, self._last_warning_s = text, now_s
        kind = _NUMBER.sub('#', text)
        if now_s - self._warned_s.get(kind, -WARN_PERIOD_S) < WARN_PERIOD_S:
            self._suppressed[kind] += 1
            return
        self._warned_s.pop(kind, None)
        self._warned_s[kind] = now_s
        suppressed = self._suppressed.pop(kind, 0)
        more = f' ({suppressed} more of this kind)' if suppressed else ''
        self._node.get_logger().warning(text + more)
        while len(self._warned_s) > MAX_KINDS:
            oldest = next(iter(self._warned_s))
            del self._warned_s[oldest]
            self._suppressed.pop(oldest, None)

    def note(self, text: str) -> None:
        """Report a past event that the user must know of: once, and in all later diagnostics."""
        if text not in self._notices:
            self._notices[text] = None
            self.warn(text)

    def clear(self) -> None:
        """Forget what is missing and what was noted: the node starts over."""
        self.missing.clear()
        self._notices.clear()

    def drop(self, reason: str, text: str, number: int = 1) -> None:
        """Count messages that are not used, and warn; a ``number`` of 0 or less does nothing."""
        if number > 0:
            self.counts[reason] += number
            self.warn(text)

    def publish(self, values: Mapping[str, Any], state: str) -> None:
        """Publish the node's status: ``values`` first, then the counts and step times.

        Args:
            values: figures of the node by name.
            state: message while there is nothing to warn of: `waiting for ...`, `running` or
                `finished: ...`.
        """
        lost = {reason: number for reason, number in sorted(self.counts.items()) if number}
        recent = time.monotonic() - self._last_warning_s < WARNING_SHOWN_S
        if self.error:
            level, text = DiagnosticStatus.ERROR, self.error
        elif self.missing:
            level, text = DiagnosticStatus.WARN, '; '.join(self.missing.values())
        elif recent:
            level, text = DiagnosticStatus.WARN, self._last_warning
        else:
            level, text = DiagnosticStatus.OK, state
            if lost:
                listed = ', '.join(f'{number} {reason}' for reason, number in lost.items())
                text += f'; messages not used since the start: {listed}'
        values = {**values, **({'notice': '; '.join(self._notices)} if self._notices else {})}
        shown = {**values, **{reason: self.counts[reason] for reason in sorted(self.counts)}}
        for step, figures in self.times.summary_ms().items():
            shown[f'{step}_median_ms'] = figures['median']
            shown[f'{step}_p99_ms'] = figures['p99']
        status = DiagnosticStatus(
            level=level,
            name=f'ratslam: {self._node.get_fully_qualified_name().lstrip("/")}',
            message=text,
            hardware_id='',
            values=[KeyValue(key=key, value=str(value)) for key, value in shown.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = time_of(self._node.get_clock().now().nanoseconds)
        self._publisher.publish(array)
