# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Queue of images that wait to be processed in a thread of their own.

Processing an image takes longer than receiving one. The executor therefore only queues images:
those that exceed the queue are dropped here and counted, and not unnoticed in the middleware.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar('Item')

MAX_BYTES = 256 * 2**20
"""About 290 raw colour images of 640x480, ten seconds at 30 Hz; minutes of compressed images."""


class Backlog(Generic[Item]):
    """A queue of limited size, and the thread that processes its items."""

    def __init__(
        self,
        process: Callable[[Item], None],
        failed: Callable[[BaseException], None],
        max_bytes: int = MAX_BYTES,
    ) -> None:
        """Start the thread.

        Args:
            process: called in the thread for each item, in order.
            failed: called in the thread with an exception that ``process`` raised; the thread then
                ends.
            max_bytes: limit of the queued bytes; one item is queued whatever its size.
        """
        self._process = process
        self._failed = failed
        self._max_bytes = max_bytes
        self._bytes = 0
        self._items: deque[tuple[Item, int]] = deque()
        self._changed = threading.Condition()
        self._open = True
        self._busy = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __len__(self) -> int:
        return len(self._items) + self._busy

    def put(self, item: Item, size: int) -> bool:
        """Append an item of ``size`` bytes; return False if it does not fit."""
        with self._changed:
            if self._items and self._bytes + size > self._max_bytes:
                return False
            self._items.append((item, size))
            self._bytes += size
            self._changed.notify_all()
        return True

    def clear(self) -> int:
        """Drop all queued items; return their number."""
        with self._changed:
            dropped = len(self._items)
            self._items.clear()
            self._bytes = 0
        return dropped

    def close(self) -> int:
        """End the thread after the current item; return the number of dropped items."""
        with self._changed:
            self._open = False
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()
        return self.clear()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.wait_for(lambda: self._items or not self._open)
                if not self._open:
                    return
                item, size = self._items.popleft()
                self._bytes -= size
                self._busy = True
            try:
                self._process(item)
            except BaseException as error:
                self._failed(error)
                return
