# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Timers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy_standin.clock import Clock
from rclpy_standin.node_parts import NodePart


class Timer(NodePart):
    """A timer that runs a callback periodically."""

    def __init__(
        self,
        node: Any,
        callback: Callable[[], Any] | None,
        period_ns: int,
        clock: Clock,
    ) -> None:
        super().__init__(node)
        if period_ns < 0:
            raise ValueError('timer period must not be negative')
        self.callback, self.clock = callback, clock
        self.timer_period_ns = period_ns
        self._canceled = False
        self._last_ns = clock.now_ns()
        self._next_ns = self._last_ns + period_ns
        clock.timers.add(self)

    def is_ready(self) -> bool:
        """Return whether the callback is due."""
        return not self._canceled and self.clock.now_ns() >= self._next_ns

    def cancel(self) -> None:
        """Cancel the timer until it is reset."""
        self._canceled = True

    def reset(self) -> None:
        """Start a new period now."""
        self._last_ns = self.clock.now_ns()
        self._next_ns = self._last_ns + self.timer_period_ns
        self._canceled = False
        self._node.wake()

    def wait_ns(self) -> int | None:
        """Return the longest time to wait, in ns; None if cancelled or awaiting simulated time."""
        if self._canceled:
            return None
        remaining_ns = self._next_ns - self.clock.now_ns()
        return None if remaining_ns > 0 and self.clock.is_simulated else max(0, remaining_ns)

    def execute(self) -> bool:
        """Run the callback if it is due; return whether it was."""
        now_ns = self.clock.now_ns()
        if self._canceled or self._closed or now_ns < self._next_ns:
            return False
        self._last_ns = now_ns
        self._next_ns += self.timer_period_ns
        if self._next_ns <= now_ns:  # skip missed periods
            behind_ns, period_ns = now_ns - self._next_ns, self.timer_period_ns
            self._next_ns = (
                self._next_ns + (1 + behind_ns // period_ns) * period_ns if period_ns else now_ns
            )
        if self.callback is not None:
            self.callback()
        return True

    def on_jump(self, is_switch: bool, before_ns: int) -> None:
        """Adjust the next call after a jump of the clock.

        Args:
            is_switch: whether simulated time was switched on or off.
            before_ns: the time before the jump.
        """
        now_ns = self.clock.now_ns()
        if is_switch:
            if now_ns and before_ns:  # keep the remaining time of the period
                self._next_ns += now_ns - before_ns
                self._last_ns = self._next_ns - self.timer_period_ns
        elif now_ns < self._last_ns:
            self._last_ns, self._next_ns = now_ns, now_ns + self.timer_period_ns
        if not self._canceled and self._next_ns <= now_ns:
            self._node.wake()

    def close(self) -> None:
        """Detach the timer from its clock."""
        self._closed = True
        self.clock.timers.discard(self)
