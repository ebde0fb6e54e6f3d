# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a node: counts, rates, step times, and warnings at a limited rate."""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from ratslam_ros.pipeline.live_stages import Reporter
from ratslam_ros.ros.convert import time_of
from ratslam_ros.ros.qos import STATE
from ratslam_ros.starting import RESTARTS
from ratslam_ros.timing import StepTimes

WARN_PERIOD_S, LONGEST_WARN_PERIOD_S = 5.0, 3600.0
"""Shortest time between two logged warnings that differ in numbers only. It doubles with each one
up to an hour, until there is none for an hour."""
WARNING_SHOWN_S = 10.0
"""How long the diagnostics show the last warning."""
MAX_KINDS = 100
"""Kinds of warnings that are told apart: texts may quote messages, so kinds are unlimited. All
further ones count as one kind."""

_NUMBER = re.compile(r'[-+]?\d[\d.]*(?:e[-+]?\d+)?')


@dataclass
class _Kind:
    """When a kind of warning is logged again, and how many have been left out."""

    due_s: float = -math.inf
    period_s: float = WARN_PERIOD_S
    suppressed: int = 0


class Diagnostics(Reporter):
    """Counts and warnings of one node, published on /diagnostics."""

    def __init__(self, node: Node) -> None:
        super().__init__()
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', STATE)
        self.missing: dict[str, str] = {}
        """What the node lacks at present, by topic; the level is WARN until it is removed."""
        self.error = ''
        """Why what the node learns may be lost, '' if it is saved; the level is then ERROR."""
        self.times = StepTimes()
        self._notices: dict[str, None] = {}
        self._kinds: dict[str, _Kind] = {}
        self._last_warning = ''
        self._last_warning_s = -WARNING_SHOWN_S
        if os.environ.get(RESTARTS):
            self.note(os.environ[RESTARTS])

    def warn(self, text: str) -> None:
        """Show a warning; log those that differ in numbers only at growing intervals."""
        now_s = time.monotonic()
        self._last_warning, self._last_warning_s = text, now_s
        name = _NUMBER.sub('#', text)
        if len(self._kinds) >= MAX_KINDS and name not in self._kinds:
            name = ''
        kind = self._kinds.setdefault(name, _Kind())
        if now_s < kind.due_s:
            kind.suppressed += 1
            return
        is_rare = now_s >= kind.due_s + LONGEST_WARN_PERIOD_S
        kind.period_s = WARN_PERIOD_S if is_rare else min(2 * kind.period_s, LONGEST_WARN_PERIOD_S)
        kind.due_s = now_s + kind.period_s
        more = f' ({kind.suppressed} more of this kind)' if kind.suppressed else ''
        kind.suppressed = 0
        self._node.get_logger().warning(text + more)

    def lacks(self, name: str, text: str) -> None:
        """Show what is missing until it is removed from ``missing``; log it once."""
        if name not in self.missing:
            self._node.get_logger().warning(text)
        self.missing[name] = text

    def note(self, text: str) -> None:
        """Report a past event that the user must know of: once, and in all later diagnostics."""
        if text not in self._notices:
            self._notices[text] = None
            self.warn(text)

    def clear(self) -> None:
        """Forget what is missing and what was noted: the node starts over."""
        self.missing.clear()
        self._notices.clear()

    def refuse(self, stream: str, reason: str) -> None:
        """Count and report a message that cannot be used."""
        self.drop('refused', f'a message of {stream} was refused: {reason}')

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
        notices = {'notice': '; '.join(self._notices)} if self._notices else {}
        shown = {**values, **notices, **dict(sorted(self.counts.items()))}
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
