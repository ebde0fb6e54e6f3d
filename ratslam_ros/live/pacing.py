# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When each message of a recording is due, by a steady clock."""

from __future__ import annotations

import time
from collections.abc import Callable


class Pacing:
    """One pass through a recording at a rate; 0 is as fast as possible.

    Every message is due at a time that is counted from the start of the pass, so that delays do
    not add up, and what is late is caught up.
    """

    def __init__(
        self, first_ns: int, rate: float, now_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        """Start a pass.

        Args:
            first_ns: the recording's time of the first message.
            rate: recorded seconds a second.
            now_ns: a steady clock.
        """
        self._first_ns = self._published_ns = self._next_ns = first_ns
        self._rate = rate
        self._now_ns = now_ns
        self._start_ns = now_ns()

    def wait_s(self, log_ns: int) -> float:
        """Announce the next message, and return how long it has to wait."""
        self._next_ns = max(self._next_ns, log_ns)
        if self._rate == 0.0:
            return 0.0
        due_ns = self._start_ns + (log_ns - self._first_ns) / self._rate
        return max(0.0, (due_ns - self._now_ns()) * 1e-9)

    def published(self, log_ns: int) -> None:
        """Note that the message announced is out."""
        self._published_ns = max(self._published_ns, log_ns)

    @property
    def played_s(self) -> float:
        """How much of the recording is out."""
        return (self._published_ns - self._first_ns) * 1e-9

    def time_ns(self) -> int:
        """Return the recording's time now: it runs between two messages, but never past one."""
        paced_ns = self._first_ns + round((self._now_ns() - self._start_ns) * self._rate)
        return min(max(paced_ns, self._published_ns), self._next_ns)
