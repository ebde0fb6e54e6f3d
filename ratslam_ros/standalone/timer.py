# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Timers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ratslam_ros.standalone.clock import Clock, ClockChange, TimeJump
from ratslam_ros.standalone.node_parts import CallbackGroup, NodePart


class Timer(NodePart):
    """Calls something again and again."""

    def __init__(
        self,
        node: Any,
        callback: Callable[[], Any] | None,
        period_ns: int,
        clock: Clock,
        callback_group: CallbackGroup | None,
        autostart: bool = True,
    ) -> None:
        super().__init__(node, callback_group)
        if period_ns < 0:
            raise ValueError('timer period must not be negative')
        self.callback, self.clock = callback, clock
        self.timer_period_ns = period_ns
        self._canceled = not autostart
        self._last_ns = clock.now_ns()
        self._next_ns = self._last_ns + period_ns
        clock.timers.add(self)

    def is_ready(self) -> bool:
        """Tell whether it is to be called."""
        return not self._canceled and self.clock.now_ns() >= self._next_ns

    def is_canceled(self) -> bool:
        """Tell whether it was stopped."""
        return self._canceled

    def cancel(self) -> None:
        """Stop it, until it is reset."""
        self._canceled = True

    def reset(self) -> None:
        """Begin a new period now."""
        self._last_ns = self.clock.now_ns()
        self._next_ns = self._last_ns + self.timer_period_ns
        self._canceled = False
        self._node.wake()

    def time_until_next_call(self) -> int | None:
        """Return when it is to be called, in ns of its clock; None if never."""
        return None if self._canceled else self._next_ns - self.clock.now_ns()

    def wait_ns(self) -> int | None:
        """Return how long to wait at most, None where simulated time decides."""
        if self._canceled:
            return None
        left_ns = self._next_ns - self.clock.now_ns()
        return None if left_ns > 0 and self.clock.is_simulated else max(0, left_ns)

    def execute(self) -> bool:
        """Call back if it is time; return whether it was."""
        now_ns = self.clock.now_ns()
        if self._canceled or self._closed or now_ns < self._next_ns:
            return False
        self._last_ns = now_ns
        self._next_ns += self.timer_period_ns
        if self._next_ns <= now_ns:  # periods were missed: they are left out
            behind_ns, period_ns = now_ns - self._next_ns, self.timer_period_ns
            self._next_ns = (
                self._next_ns + (1 + behind_ns // period_ns) * period_ns if period_ns else now_ns
            )
        if self.callback is not None:
            self.callback()
        return True

    def on_jump(self, jump: TimeJump, before_ns: int) -> None:
        """Follow a jump of the clock."""
        now_ns = self.clock.now_ns()
        if jump.clock_change != ClockChange.ROS_TIME_NO_CHANGE:
            if now_ns and before_ns:  # what was left of the period is left still
                self._next_ns += now_ns - before_ns
                self._last_ns = self._next_ns - self.timer_period_ns
        elif now_ns < self._last_ns:
            self._last_ns, self._next_ns = now_ns, now_ns + self.timer_period_ns
        if not self._canceled and self._next_ns <= now_ns:
            self._node.wake()

    def close(self) -> None:
        """Let go of the clock."""
        self._closed = True
        self.clock.timers.discard(self)
