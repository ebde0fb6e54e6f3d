# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a node: counts, rates, step times, and warnings at a limited rate."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from ratslam_ros.nodes.convert import time_of
from ratslam_ros.nodes.qos import STATE
from ratslam_ros.timing import StepTimes

WARN_PERIOD_S = 5.0
"""Shortest time between two logged warnings with the same key."""
WARNING_SHOWN_S = 10.0
"""How long the diagnostics show the last warning."""


class Diagnostics:
    """Counts and warnings of one node, published on /diagnostics."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', STATE)
        self.counts: Counter[str] = Counter()
        """Messages that were not used, by reason; a nonzero count keeps the level at WARN."""
        self.missing: dict[str, str] = {}
        """Known deficiencies by topic, shown until they are removed."""
        self.times = StepTimes()
        self._warned_s: dict[str, float] = {}
        self._suppressed: Counter[str] = Counter()
        self._last_warning = ''
        self._last_warning_s = -WARNING_SHOWN_S

    def warn(self, key: str, text: str) -> None:
        """Show a warning, and log it at most once per key every WARN_PERIOD_S."""
        now_s = time.monotonic()
        self._last_warning, self._last_warning_s = text, now_s
        if now_s - self._warned_s.get(key, -WARN_PERIOD_S) < WARN_PERIOD_S:
            self._suppressed[key] += 1
            return
        self._warned_s[key] = now_s
        suppressed = self._suppressed.pop(key, 0)
        more = f' ({suppressed} more of this kind)' if suppressed else ''
        self._node.get_logger().warning(text + more)

    def drop(self, reason: str, text: str, number: int = 1) -> None:
        """Count messages that are not used, and warn; a ``number`` of 0 or less does nothing."""
        if number > 0:
            self.counts[reason] += number
            self.warn(reason, text)

    def publish(self, values: Mapping[str, Any]) -> None:
        """Publish the node's status: ``values`` first, then the counts and step times."""
        lost = {reason: number for reason, number in sorted(self.counts.items()) if number}
        recent = time.monotonic() - self._last_warning_s < WARNING_SHOWN_S
        if self.missing:
            level, text = DiagnosticStatus.WARN, '; '.join(self.missing.values())
        elif recent:
            level, text = DiagnosticStatus.WARN, self._last_warning
        elif lost:
            listed = ', '.join(f'{number} {reason}' for reason, number in lost.items())
            level, text = DiagnosticStatus.WARN, f'messages not used since the start: {listed}'
        else:
            level, text = DiagnosticStatus.OK, 'all messages used'
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
