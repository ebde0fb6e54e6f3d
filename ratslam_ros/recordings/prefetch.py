# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Prefetching: reading and decoding on a second thread, so that the consumer rarely waits."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from itertools import islice
from typing import TypeVar

from ratslam_ros.images import UndecodableImage
from ratslam_ros.recordings.events import Event, ImageEvent

Item = TypeVar('Item')
Prepared = TypeVar('Prepared')

QUEUE_COUNT = 32  # A small number, because each item may hold an uncompressed image.
IMAGE_BATCH_COUNT = 16  # Handing over batches keeps the threads from switching at every event.
IMAGE_QUEUE_COUNT = 4


@contextmanager
def prefetch(
    items: Iterable[Item], queue_count: int = QUEUE_COUNT, batch_count: int = 1
) -> Iterator[Iterator[Item]]:
    """Iterate over items that are produced ahead of use on a second thread.

    The items keep their order. An exception of the iterable is raised after the complete batches
    that precede it. The thread has ended when the context is left, whether or not all items were
    consumed.

    Args:
        items: the source, iterated on the second thread only.
        queue_count: largest number of batches that wait for the consumer.
        batch_count: number of items handed over at once.
    """
    source = iter(items)

    def batch() -> list[Item]:
        return list(islice(source, batch_count))

    with ThreadPoolExecutor(1, 'prefetch') as pool:
        waiting = deque(pool.submit(batch) for _ in range(queue_count))

        def consumed() -> Iterator[Item]:
            while found := waiting.popleft().result():
                waiting.append(pool.submit(batch))
                yield from found

        try:
            yield consumed()
        finally:
            pool.shutdown(cancel_futures=True)


def prefetch_prepared(
    events: Iterable[Event], prepare: Callable[[ImageEvent], Prepared],
    batch_count: int = IMAGE_BATCH_COUNT,
) -> AbstractContextManager[Iterator[tuple[Event, Prepared | None]]]:
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

    return prefetch(
        ((event, prepared(event)) for event in events), IMAGE_QUEUE_COUNT, batch_count
    )
