# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Work done ahead: everything in order, errors at their place, an end at any time."""

import itertools
import threading
import time

import pytest

from ratslam_ros.live.ahead import Ahead


def test_all_items_come_in_order() -> None:
    with Ahead(range(1000), 7) as items:
        assert list(items) == list(range(1000))


def test_an_error_is_raised_after_what_came_before_it() -> None:
    def source():  # type: ignore[no-untyped-def]
        yield 1
        yield 2
        raise ValueError('broken')

    got = []
    with pytest.raises(ValueError, match='broken'), Ahead(source()) as items:
        for item in items:
            got.append(item)
    assert got == [1, 2]


def test_leaving_early_ends_the_thread() -> None:
    before = threading.active_count()
    with Ahead(itertools.count(), 3) as items:
        assert next(items) == 0
    assert threading.active_count() == before


def test_no_more_than_a_few_are_made_ahead() -> None:
    made = []

    def source():  # type: ignore[no-untyped-def]
        for i in range(100):
            made.append(i)
            yield i

    with Ahead(source(), 5) as items:
        next(items)
        time.sleep(0.1)
        assert len(made) <= 1 + 5 + 1
