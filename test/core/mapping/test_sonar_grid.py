# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The occupancy plot of sonars: profile of a beam, and walls of a room in their cells."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.occupancy import HIGHEST, HIT, LOWEST, MISS
from ratslam_ros.core.mapping.sonar_grid import SonarGrid
from ratslam_ros.core.pose_cells.torus import Place, Torus
from ratslam_simulator.floor_plan import parse_floor_plan
from ratslam_simulator.sonar import PIONEER, SonarOptions, Sonars
from ratslam_simulator.world import build_world

TORUS = Torus(40, 30, 36)
CELL_M = 0.25
CONE_RAD = math.radians(30.0)
AHEAD = Pose(0.0, 0.0, 0.0)



def percent_of(odds: float) -> int:
    return round(100.0 / (1.0 + math.exp(-odds)))


def test_beam_has_published_profile() -> None:
    grid = SonarGrid(TORUS)
    grid.add(Place(10.0, 10.0, 0.0), CELL_M, AHEAD, CONE_RAD, 2.0)
    percent = grid.percent()
    assert percent[10, 14] == percent_of(MISS * (1.0 - (1.0 / 1.75) ** 2))  # 1 m: E_r = 0.67
    off_rad = math.atan2(1.0, 4.0)  # 14 degrees: E_a = 0.12
    away_m = 0.25 * math.hypot(4.0, 1.0)
    lateral = 1.0 - (2.0 * off_rad / CONE_RAD) ** 2
    assert percent[11, 14] == percent_of(MISS * lateral * (1.0 - (away_m / 1.75) ** 2))
    assert percent[10, 19] == percent[10, 20] == -1  # behind the echo
    assert percent[13, 18] == percent[7, 18] == -1  # 20 degrees from the axis


def test_echo_counts_once_on_its_arc() -> None:
    """At 2 m the arc gains in 7 cells, and all of them together by one reflector."""
    grid = SonarGrid(TORUS)
    grid.add(Place(10.0, 10.0, 0.0), CELL_M, AHEAD, CONE_RAD, 2.0)
    percent = grid.percent()
    on_arc = percent[:, 17:20]
    assert (on_arc > 50).sum() == 7
    odds = np.log(on_arc[on_arc > 50] / (100.0 - on_arc[on_arc > 50]))
    assert odds.sum() == pytest.approx(HIT, abs=0.1)
    assert percent[10, 18] == on_arc.max() == percent[9:12, 18].max()


def test_echo_is_attributed_where_other_beams_agree() -> None:
    """A beam from the side frees the left half of the arc, and the right half gains."""
    plain, other = SonarGrid(TORUS), SonarGrid(TORUS)
    for _ in range(10):
        other.add(Place(18.0, 16.0, 27.0), CELL_M, AHEAD, CONE_RAD, 1.5)  # to -y, until 10
        for grid in (plain, other):
            grid.add(Place(10.0, 10.0, 0.0), CELL_M, AHEAD, CONE_RAD, 2.0)
    before, after = (grid.percent() for grid in (plain, other))
    assert after[12, 18] < before[12, 18] < 90 < after[10, 18]


@pytest.mark.parametrize(
    ('cone_rad', 'range_m'),
    [(CONE_RAD, math.inf), (CONE_RAD, math.nan), (CONE_RAD, -math.inf), (0.0, 2.0)],
)
def test_lost_echo_changes_nothing(cone_rad: float, range_m: float) -> None:
    grid = SonarGrid(TORUS)
    grid.add(Place(10.0, 10.0, 0.0), CELL_M, AHEAD, cone_rad, range_m)
    assert (grid.percent() == -1).all()


def test_evidence_is_bounded_and_wraps_at_edges() -> None:
    grid = SonarGrid(TORUS)
    for _ in range(100):  # plane 9 of 36: to y
        grid.add(Place(5.0, 28.0, 9.0), CELL_M, AHEAD, CONE_RAD, 1.0)
    percent = grid.percent()
    assert percent[2, 5] == percent_of(HIGHEST)
    assert percent[29, 5] == percent_of(LOWEST)


def test_beam_longer_than_the_torus_ends_after_half_of_it() -> None:
    grid = SonarGrid(TORUS)
    grid.add(Place(10.0, 10.0, 0.0), CELL_M, AHEAD, CONE_RAD, 1e6)
    seen = grid.percent()[10] >= 0
    assert seen[10:30].all() and not seen[:10].any() and not seen[30:].any()


def test_walls_of_room_appear_in_their_cells() -> None:
    """A room from 0.5 to 4.5 m and 0.5 to 3.5 m. Late echoes appear behind its corners."""
    plan = parse_floor_plan('\n'.join(['#' * 10, *['#........#'] * 6, '#' * 10]), cell_m=0.5)
    world = build_world(plan, np.random.Generator(np.random.PCG64(1)))
    sonars = Sonars(world, np.random.Generator(np.random.PCG64(1)), SonarOptions())
    grid = SonarGrid(TORUS)
    for x_m in np.arange(1.0, 4.0, 0.05):
        for theta in (0.0, 18.0):
            ranges_m = sonars.ranges_m(Pose(x_m, 2.0, theta / TORUS.planes_per_rad))
            place = Place(x_m / CELL_M, 2.0 / CELL_M, theta)
            for mount, range_m in zip(PIONEER, ranges_m.tolist(), strict=True):
                grid.add(place, CELL_M, mount, CONE_RAD, range_m)
    percent = grid.percent()
    left, right, low, high = 2, 18, 2, 14  # walls at 0.5, 4.5, 0.5 and 3.5 m, in cells
    assert (percent[low, 8:15] > 80).all() and (percent[high, 8:15] > 80).all()
    assert (percent[7:10, left] > 80).all() and (percent[7:10, right] > 80).all()
    assert (percent[low + 2 : high - 1, 6:15] < 20).all()
