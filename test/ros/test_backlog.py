# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import threading

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


def test_items_beyond_the_limit_are_refused_except_one() -> None:
    entered, leave = threading.Event(), threading.Event()

    def process(item: int) -> None:
        entered.set()
        assert leave.wait(10.0)

    backlog = Backlog(process, max_bytes=10)
    assert backlog.put(0, 1000)
    assert entered.wait(10.0)  # being processed: it is no longer queued
    assert backlog.put(1, 1000)
    assert not backlog.put(2, 1)
    assert len(backlog) == 2
    threading.Timer(0.05, leave.set).start()
    assert backlog.close() == 1


def test_items_up_to_the_limit_are_queued() -> None:
    entered, leave = threading.Event(), threading.Event()

    def process(item: int) -> None:
        entered.set()
        assert leave.wait(10.0)

    backlog = Backlog(process, max_bytes=10)
    assert backlog.put(2, 1)
    assert entered.wait(10.0)
    assert backlog.put(3, 5)
    assert backlog.put(4, 5)
    assert not backlog.put(5, 1)
    threading.Timer(0.05, leave.set).start()
    assert backlog.close() == 2


def test_error_ends_the_thread_and_is_reported() -> None:
    def process(item: int) -> None:
        raise ZeroDivisionError(item)

    backlog = Backlog(process)
    backlog.put(7, 1)
    backlog._thread.join(10.0)
    assert isinstance(backlog.error, ZeroDivisionError)
    backlog.close()
