# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Grid of cuts: which messages a cut includes, whatever the streams of a node."""

import random

from helpers import START_NS, S

from ratslam_ros.maps.cut_grid import CUT_PERIOD_NS, NUMBERS_PER_RUN, CutGrid, index_of
from ratslam_ros.maps.saved_map import Cut


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
        limit_ns = number * CUT_PERIOD_NS
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
    assert grid.before(on_grid_ns + 1) == Cut(on_grid_ns // CUT_PERIOD_NS, on_grid_ns)


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
                Cut(n, n * CUT_PERIOD_NS) for n in cuts(stamps) if n > cut.number
            ]


def test_cut_of_a_pause_has_the_number_of_the_next_point() -> None:
    grid = CutGrid()
    assert grid.now() is None
    grid.before(4 * S + 1)
    assert grid.now() == Cut(3, 4 * S + 1)
    restarted = CutGrid()
    restarted.restore(Cut(3, 4 * S + 1))
    for one in (grid, restarted):
        assert one.before(5 * S) is None
        assert one.before(6 * S + 1) == Cut(3, 6 * S)


def test_node_without_messages_follows_the_cuts_of_others() -> None:
    grid = CutGrid()
    assert grid.now(7) == Cut(7, 0)
    grid.before(4 * S + 1)
    assert grid.now(7) == Cut(7, 4 * S + 1)
    assert grid.before(100 * S) == Cut(49, 98 * S)
    assert grid.now(7) == Cut(50, 100 * S)


def test_earlier_stamps_get_higher_numbers() -> None:
    grid = CutGrid()
    grid.before(100 * S)
    grid.start_run()
    assert grid.last_ns is None
    assert grid.before(2 * S) is None
    cut = grid.before(5 * S)
    assert cut == Cut(NUMBERS_PER_RUN + 2, 4 * S)
    assert index_of(cut) == 2
