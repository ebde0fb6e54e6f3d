# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publisher of large messages, which are made in short slices between other messages."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

MAX_LOAD_RATIO = 0.1
"""Largest share of a core for making them. The processor time of a slice is measured, because the
time for which a busy machine stops it may be a thousand times as long."""

SLICE_S = 0.002
"""Time after which a slice ends. One more step takes up to 1 ms, so that no message is delayed by
more than 5 ms."""

THREAD_BYTES = 2**18
"""Size of a message above which a thread publishes it; a smaller one takes less than 1 ms."""


class SlicedPublisher:
    """Makes messages step by step, in slices that pause for the other messages of the node."""

    def __init__(self, publisher: Any) -> None:
        """Create it for a topic."""
        self._publisher = publisher
        self._thread: threading.Thread | None = None
        self._next_slice_s = 0.0

    def close(self) -> None:
        """Wait until a message that is being published is sent, before the node is destroyed."""
        if self._thread is not None:
            self._thread.join()

    def _may_work(self) -> bool:
        """Return whether the next slice is due."""
        is_sending = self._thread is not None and self._thread.is_alive()
        return not is_sending and time.monotonic() >= self._next_slice_s

    def _work(self, steps: Iterator[bool]) -> None:
        """Do steps until the slice ends, or one yields that nothing is left to do at present."""
        start_s, worked_s = time.monotonic(), time.thread_time()
        while next(steps, False) and time.monotonic() < start_s + SLICE_S:
            pass
        worked_s = time.thread_time() - worked_s
        self._next_slice_s = time.monotonic() + worked_s / MAX_LOAD_RATIO

    def _send(self, size_bytes: int, make: Callable[[], Any]) -> None:
        """Publish a message of about a size, which is converted by a function."""

        def send() -> None:
            self._publisher.publish(make())

        if size_bytes < THREAD_BYTES:
            send()
        else:
            self._thread = threading.Thread(target=send)
            self._thread.start()
