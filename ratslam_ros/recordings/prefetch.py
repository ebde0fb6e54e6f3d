# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Prefetching: reading and decoding on a second thread, so that the consumer rarely waits."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from typing import Generic, Self, TypeVar

from ratslam_ros.images import UndecodableImage
from ratslam_ros.recordings.events import Event, ImageEvent

Item = TypeVar('Item')
Prepared = TypeVar('Prepared')

QUEUE_COUNT = 32  # A small number, because each item may hold an uncompressed image.
IMAGE_BATCH_COUNT = 16  # Handing over batches keeps the threads from switching at every event.
IMAGE_QUEUE_COUNT = 4
CLOSE_POLL_S = 0.05


class Prefetch(AbstractContextManager['Prefetch[Item]'], Generic[Item]):
    """An iterator over the items of an iterable, produced ahead of use on a second thread.

    The items keep their order. An exception of the iterable is raised here after the complete
    batches that precede it. The thread starts on entering the context and has ended on leaving
    it, whether or not all items were consumed.
    """

    def __init__(
        self, items: Iterable[Item], queue_count: int = QUEUE_COUNT, batch_count: int = 1
    ) -> None:
        """Prepare the queue; nothing is read before the context is entered.

        Args:
            items: the source, iterated on the second thread only.
            queue_count: largest number of batches that wait for the consumer.
            batch_count: number of items handed over at once.
        """
        self._items = items
        self._batch_count = batch_count
        self._queue: queue.Queue[list[Item] | BaseException | None] = queue.Queue(queue_count)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._produce, name='prefetch', daemon=True)
        self._batch: Iterator[Item] = iter(())

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        while self._thread.is_alive():  # The thread may be blocked on a full queue.
            try:
                self._queue.get(timeout=CLOSE_POLL_S)
            except queue.Empty:
                continue

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Item:
        for item in self._batch:
            return item
        batch = self._queue.get()
        if batch is None:
            raise StopIteration
        if isinstance(batch, BaseException):
            raise batch
        self._batch = iter(batch)
        return next(self._batch)

    def _produce(self) -> None:
        try:
            batch: list[Item] = []
            for item in self._items:
                if self._stopped.is_set():
                    return
                batch.append(item)
                if len(batch) == self._batch_count:
                    self._queue.put(batch)
                    batch = []
            if batch:
                self._queue.put(batch)
            self._queue.put(None)
        except BaseException as error:
            self._queue.put(error)


def prefetch_prepared(
    events: Iterable[Event], prepare: Callable[[ImageEvent], Prepared],
    batch_count: int = IMAGE_BATCH_COUNT,
) -> Prefetch[tuple[Event, Prepared | None]]:  # fmt: skip
    """Prefetch events together with what ``prepare`` returns for their images.

    Args:
        events: the events of a recording.
        prepare: called on the second thread with each event that has an image.
        batch_count: number of events handed over at once.

    Returns:
        Pairs of an event and what was prepared, None if the event has no image or if the image
        cannot be decoded.
    """
    def prepared(event: Event) -> Prepared | None:
        try:
            return prepare(event) if isinstance(event, ImageEvent) else None
        except UndecodableImage:
            return None

    return Prefetch(
        ((event, prepared(event)) for event in events), IMAGE_QUEUE_COUNT, batch_count
    )
