# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Grid of cuts: which messages a cut includes, whatever the streams of a node."""

import random

from helpers import START_NS, S

from ratslam_ros.maps.cut_grid import (
    CUT_PERIOD_NS,
    NUMBERS_PER_POINT,
    NUMBERS_PER_RUN,
    CutGrid,
    index_of,
)
from ratslam_ros.maps.saved_map import Cut


def at(index: int) -> Cut:
    """Return the cut at a point of the grid."""
    return Cut(index * NUMBERS_PER_POINT, index * CUT_PERIOD_NS)


def cuts(stamps: list[int]) -> dict[int, list[int]]:
    """Return the stamps that each cut includes, by its number."""
    grid, processed, found = CutGrid(), [], {}
    for stamp_ns in stamps:
        cut = grid.before(stamp_ns)
        if cut is not None:
            assert all(stamp <= cut.stamp_ns < stamp_ns for stamp in processed)
            found[cut.number] = list(processed)
        processed.append(stamp_ns)
    return found


def test_cut_includes_all_messages_up_to_its_stamp() -> None:
    stamps = [START_NS + i * S // 4 for i in range(40)]
    for number, processed in cuts(stamps).items():
        limit_ns = number // NUMBERS_PER_POINT * CUT_PERIOD_NS
        assert processed == [stamp for stamp in stamps if stamp <= limit_ns]


def test_nodes_with_different_streams_cut_at_the_same_stamps() -> None:
    chance = random.Random(1)
    odometry = sorted(START_NS + chance.randrange(60 * S) for _ in range(900))
    images = sorted(START_NS + chance.randrange(60 * S) for _ in range(40))
    both = cuts(sorted(odometry + images))
    alone = cuts(images)
    assert len(both) == 29
    common = both.keys() & alone.keys()
    assert len(common) > 10
    for number in common:
        assert [stamp for stamp in both[number] if stamp in images] == alone[number]


def test_message_on_the_grid_belongs_to_its_cut() -> None:
    grid = CutGrid()
    on_grid_ns = START_NS // CUT_PERIOD_NS * CUT_PERIOD_NS
    assert grid.before(on_grid_ns - 1) is None
    assert grid.before(on_grid_ns) is None
    assert grid.before(on_grid_ns + 1) == at(on_grid_ns // CUT_PERIOD_NS)


def test_restored_grid_continues_the_cuts() -> None:
    stamps = [START_NS + i * S // 3 for i in range(60)]
    grid = CutGrid()
    for number, stamp_ns in enumerate(stamps):
        cut = grid.before(stamp_ns)
        if cut is not None:
            other = CutGrid()
            other.restore(cut)
            rest = [other.before(stamp) for stamp in stamps[number:]]
            assert [c for c in rest if c] == [
                at(n // NUMBERS_PER_POINT) for n in cuts(stamps) if n > cut.number
            ]


def test_cut_of_a_pause_is_none_of_the_grid() -> None:
    """Messages may come late, after which the next point has another state."""
    grid = CutGrid()
    assert grid.now() is None
    grid.before(4 * S + 1)
    pause = Cut(2 * NUMBERS_PER_POINT + 1, 4 * S + 1)
    assert grid.now() == pause
    assert index_of(pause) == 3
    restarted = CutGrid()
    restarted.restore(pause)
    for one in (grid, restarted):
        assert one.before(5 * S) is None
        assert one.now(pause.number + 1) == Cut(pause.number + 1, 5 * S)
        assert one.before(6 * S + 1) == at(3)


def test_cut_of_an_earlier_version_has_a_smaller_number() -> None:
    """Its number was that of its point, so that the next cut is due at once."""
    grid = CutGrid()
    grid.restore(Cut(3, 6 * S))
    assert grid.before(6 * S + 1) == at(3)


def test_node_without_messages_follows_the_cuts_of_others() -> None:
    grid, others = CutGrid(), at(7).number
    assert grid.now(others) == Cut(others, 0)
    grid.before(4 * S + 1)
    assert grid.now(others) == Cut(others, 4 * S + 1)
    assert grid.before(100 * S) == at(49)
    assert grid.now(others) == Cut(at(49).number + 1, 100 * S)


def test_earlier_stamps_get_higher_numbers() -> None:
    grid = CutGrid()
    grid.before(100 * S)
    grid.start_run()
    assert grid.last_ns is None
    assert grid.before(2 * S) is None
    cut = grid.before(5 * S)
    assert cut == Cut(NUMBERS_PER_RUN + 2 * NUMBERS_PER_POINT, 4 * S)
    assert index_of(cut) == 2
