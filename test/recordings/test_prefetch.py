# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of prefetching: order, errors, shutdown and bounded memory."""

import itertools
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from ratslam_ros.images import EncodedImage, Frame, Pixels
from ratslam_ros.recordings import ImageEvent, TemplateEvent
from ratslam_ros.recordings.prefetch import prefetch, prefetch_prepared


@pytest.mark.parametrize('batch_count', [1, 16])
def test_items_keep_their_order(batch_count: int) -> None:
    with prefetch(range(1000), 7, batch_count) as items:
        assert list(items) == list(range(1000))


def test_source_error_is_raised_after_preceding_items() -> None:
    def source() -> Iterator[int]:
        yield 1
        yield 2
        raise ValueError('broken')

    got = []
    with pytest.raises(ValueError, match='broken'), prefetch(source()) as items:
        for item in items:
            got.append(item)
    assert got == [1, 2]


@pytest.mark.parametrize('batch_count', [1, 16])
def test_leaving_early_ends_the_thread(batch_count: int) -> None:
    before = threading.active_count()
    with prefetch(itertools.count(), 3, batch_count) as items:
        assert next(items) == 0
    assert threading.active_count() == before


@pytest.mark.parametrize('batch_count', [1, 4])
def test_prefetched_items_are_bounded_by_the_queue(batch_count: int) -> None:
    made = []

    def source() -> Iterator[int]:
        for i in range(100):
            made.append(i)
            yield i

    with prefetch(source(), 5, batch_count) as items:
        next(items)
        time.sleep(0.1)
        # One batch with the consumer, five in the queue, one that waits for room in it.
        assert len(made) <= (1 + 5 + 1) * batch_count


def test_images_are_prepared_on_the_thread() -> None:
    threads: list[str] = []

    def prepare(event: ImageEvent) -> Pixels:
        threads.append(threading.current_thread().name)
        return event.grey()

    pixels = np.arange(6, dtype=np.uint8).reshape(2, 3)
    events = [
        ImageEvent(0, 0, Frame(pixels)),
        TemplateEvent(1, 1, '{}'),
        ImageEvent(2, 2, EncodedImage(b'no image', 'jpeg')),
    ]
    with prefetch_prepared(events, prepare) as prepared:
        pairs = list(prepared)
    assert [event for event, _ in pairs] == events
    np.testing.assert_array_equal(pairs[0][1], pixels)
    assert [image for _, image in pairs[1:]] == [None, None]
    assert threads == ['prefetch_0'] * 2
