# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a regular stream that a restarted node has lost are recognised by the stamps."""

from __future__ import annotations

import pytest

from ratslam_ros.pipeline.continuity import NEW_COUNT, Continuity


def judged(known: list[int], new: list[int]) -> Continuity:
    continuity = Continuity(known)
    for count, stamp_ns in enumerate(new, 1):
        assert continuity.add(stamp_ns) == (count >= NEW_COUNT)
    return continuity


def test_complete_stream_has_lost_nothing() -> None:
    assert judged([100, 120, 140], [160, 180, 200, 220, 240]).lost() is None


@pytest.mark.parametrize('missing', [1, 2, 20])
def test_missing_messages_are_recognised_without_recovered_ones(missing: int) -> None:
    first = 100 + 20 * (missing + 1)
    continuity = judged([100], [first + 20 * n for n in range(NEW_COUNT)])
    assert continuity.lost() == (100, first)


def test_several_gaps_are_one_span() -> None:
    # A neighbour has logged two of the messages.
    continuity = judged([100, 160, 180], [300, 320, 340, 360, 380])
    assert continuity.lost() == (100, 300)


def test_jitter_and_duplicates_are_no_loss() -> None:
    assert judged([100, 118, 141], [141, 158, 182, 199, 199]).lost() is None


def test_silent_stream_is_not_judged() -> None:
    continuity = Continuity([100])
    assert continuity.lost() is None
    assert not continuity.has_new
    assert continuity.last_ns == 100
