# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publication times of the messages of a recording."""

from __future__ import annotations

import time
from collections.abc import Callable


class Pacing:
    """Schedule of one pass through a recording at a given speed.

    All due times are relative to the start of the pass, so that delays do not accumulate and late
    messages are caught up.
    """

    def __init__(
        self, first_ns: int, rate: float, now_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        """Start a pass.

        Args:
            first_ns: recording time of the first message.
            rate: speed relative to real time; 0: as fast as possible.
            now_ns: monotonic clock.
        """
        self._first_ns = self._published_ns = self._next_ns = first_ns
        self._rate = rate
        self._now_ns = now_ns
        self._start_ns = now_ns()

    def wait_s(self, log_ns: int) -> float:
        """Return the time in seconds until the next message is due.

        Args:
            log_ns: recording time of the message.
        """
        self._next_ns = max(self._next_ns, log_ns)
        if self._rate == 0.0:
            return 0.0
        due_ns = self._start_ns + (log_ns - self._first_ns) / self._rate
        return max(0.0, (due_ns - self._now_ns()) * 1e-9)

    def published(self, log_ns: int) -> None:
        """Register that the message with this recording time was published."""
        self._published_ns = max(self._published_ns, log_ns)

    @property
    def played_s(self) -> float:
        """Duration of the published part of the recording."""
        return (self._published_ns - self._first_ns) * 1e-9

    def time_ns(self) -> int:
        """Return the current recording time, which does not advance past the next message."""
        paced_ns = self._first_ns + round((self._now_ns() - self._start_ns) * self._rate)
        return min(max(paced_ns, self._published_ns), self._next_ns)
