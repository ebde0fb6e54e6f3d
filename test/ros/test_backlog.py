# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import threading

import pytest

from ratslam_ros.ros.backlog import Backlog


def test_items_are_processed_in_order_in_another_thread() -> None:
    processed: list[int] = []
    done = threading.Event()

    def process(item: int) -> None:
        processed.append(item)
        if item == 99:
            done.set()

    backlog = Backlog(process)
    for n in range(100):
        assert backlog.put(n, 1)
    assert done.wait(10.0)
    assert processed == list(range(100))
    assert backlog.close() == 0


@pytest.mark.parametrize(('sizes', 'queued'), [((1000, 1), 1), ((5, 5, 1), 2)])
def test_items_beyond_the_limit_are_refused_except_one(
    sizes: tuple[int, ...], queued: int
) -> None:
    entered, leave = threading.Event(), threading.Event()

    def process(item: int) -> None:
        entered.set()
        assert leave.wait(10.0)

    backlog = Backlog(process, max_bytes=10)
    assert backlog.put(0, 1000)
    assert entered.wait(10.0)  # being processed: it is no longer queued
    accepted = [backlog.put(size, size) for size in sizes]
    assert accepted == [True] * queued + [False]
    assert len(backlog) == 1 + queued
    threading.Timer(0.05, leave.set).start()
    assert backlog.close() == queued


def test_error_ends_the_thread_and_is_reported() -> None:
    def process(item: int) -> None:
        raise ZeroDivisionError(item)

    backlog = Backlog(process)
    backlog.put(7, 1)
    backlog._thread.join(10.0)
    assert isinstance(backlog.error, ZeroDivisionError)
    backlog.close()
