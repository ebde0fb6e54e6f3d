# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Work done ahead on a second thread, so that whoever publishes never waits for a disk."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterable
from contextlib import AbstractContextManager
from typing import Generic, Self, TypeVar

Item = TypeVar('Item')

AHEAD = 32  # items; images may be large


class Ahead(AbstractContextManager['Ahead[Item]'], Generic[Item]):
    """The items of an iterable in order, made a few ahead; what it raises is raised here."""

    def __init__(self, items: Iterable[Item], size: int = AHEAD) -> None:
        self._items = items
        self._queue: queue.Queue[tuple[Item] | BaseException | None] = queue.Queue(size)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._work, name='ahead', daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        while self._thread.is_alive():  # it may wait for room
            try:
                self._queue.get(timeout=0.05)
            except queue.Empty:
                continue

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Item:
        item = self._queue.get()
        if item is None:
            raise StopIteration
        if isinstance(item, BaseException):
            raise item
        return item[0]

    def _work(self) -> None:
        try:
            for item in self._items:
                if self._stopped.is_set():
                    return
                self._queue.put((item,))
            self._queue.put(None)
        except BaseException as error:
            self._queue.put(error)
