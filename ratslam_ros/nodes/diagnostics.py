# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a node tells of itself: counts, rates, step times, and warnings at a bounded rate."""

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
TOLD_FOR_S = 10.0
"""How long the diagnostics show what was warned about last."""


class Diagnostics:
    """Counts and warnings of one node, published on /diagnostics."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', STATE)
        self.counts: Counter[str] = Counter()
        """What was not used, by reason; what is not zero is a warning for good."""
        self.missing: dict[str, str] = {}
        """What the node knows that it lacks, by topic; told until it is mended."""
        self.times = StepTimes()
        self._warned_s: dict[str, float] = {}
        self._unsaid: Counter[str] = Counter()
        self._last_warning = ''
        self._last_warning_s = -TOLD_FOR_S

    def warn(self, key: str, text: str) -> None:
        """Log a warning, at most one a key every few seconds, and show it."""
        now_s = time.monotonic()
        self._last_warning, self._last_warning_s = text, now_s
        if now_s - self._warned_s.get(key, -WARN_PERIOD_S) < WARN_PERIOD_S:
            self._unsaid[key] += 1
            return
        self._warned_s[key] = now_s
        unsaid = self._unsaid.pop(key, 0)
        self._node.get_logger().warning(text + (f' ({unsaid} more like it)' if unsaid else ''))

    def drop(self, reason: str, text: str, number: int = 1) -> None:
        """Count messages that are not used, and warn."""
        if number > 0:
            self.counts[reason] += number
            self.warn(reason, text)

    def publish(self, values: Mapping[str, Any]) -> None:
        """Publish the node's state: ``values`` first, then the counts and step times."""
        lost = {reason: number for reason, number in sorted(self.counts.items()) if number}
        recent = time.monotonic() - self._last_warning_s < TOLD_FOR_S
        if self.missing:
            level, text = DiagnosticStatus.WARN, '; '.join(self.missing.values())
        elif recent:
            level, text = DiagnosticStatus.WARN, self._last_warning
        elif lost:
            told = ', '.join(f'{number} {reason}' for reason, number in lost.items())
            level, text = DiagnosticStatus.WARN, f'not used so far: {told}'
        else:
            level, text = DiagnosticStatus.OK, 'all used'
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
