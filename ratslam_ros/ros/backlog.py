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

    def __init__(self, process: Callable[[Item], None], max_bytes: int = MAX_BYTES) -> None:
        """Start the thread.

        Args:
            process: called in the thread for each item, in order.
            max_bytes: limit of the queued bytes; one item is queued whatever its size.
        """
        self.error: BaseException | None = None
        """The exception of ``process`` that has ended the thread, if any."""
        self._process, self._max_bytes = process, max_bytes
        self._bytes = 0
        self._items: deque[tuple[Item, int]] = deque()
        self._changed = threading.Condition()
        self._is_open, self._is_busy = True, False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __len__(self) -> int:
        return len(self._items) + self._is_busy

    def put(self, item: Item, size: int) -> bool:
        """Append an item of ``size`` bytes; return False if it does not fit."""
        with self._changed:
            if self._items and self._bytes + size > self._max_bytes:
                return False
            self._items.append((item, size))
            self._bytes += size
            self._changed.notify_all()
        return True

    def close(self) -> int:
        """End the thread after the current item; return the number of items that are dropped."""
        with self._changed:
            self._is_open = False
            self._changed.notify_all()
        self._thread.join()
        return len(self._items)

    def _run(self) -> None:
        try:
            while True:
                with self._changed:
                    self._is_busy = False
                    self._changed.wait_for(lambda: self._items or not self._is_open)
                    if not self._is_open:
                        return
                    item, size = self._items.popleft()
                    self._bytes -= size
                    self._is_busy = True
                self._process(item)
        except BaseException as error:
            self.error = error
