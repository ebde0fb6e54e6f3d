# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detours round obstacles on the route."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rooms import Drive, Line, clearance_m, corridor, scan_in

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.detour import (
    COLUMN_COUNT,
    GRID_BACK_M,
    GRID_FRONT_M,
    GRID_SIDE_M,
    ROW_COUNT,
    plan_detour,
)
from ratslam_ros.core.driving.free_directions import DirectionCandidate, LocalMovement

P = GoalFollowerParameters()
STRAIGHT = np.array([[0.0, 0.0], [7.0, 0.0]])


def box(x_m: float, aside_m: float, width_m: float, depth_m: float = 0.5) -> Line:
    right, left = aside_m - width_m / 2, aside_m + width_m / 2
    return [(x_m, right), (x_m, left), (x_m + depth_m, left), (x_m + depth_m, right), (x_m, right)]


def detour(
    walls: list[Line], route: NDArray[np.float64] = STRAIGHT, last_rad: float = 0.0
) -> DirectionCandidate | None:
    movement = LocalMovement(P, scan_in(walls, Pose(0.0, 0.0, 0.0), 0, beams=181))
    return plan_detour(movement, route, P, last_rad)


@pytest.mark.parametrize(
    ('half_m', 'width_m', 'aside_m', 'behaviour'),
    [(1.12, 0.6, 0.0, ''), (1.4, 1.4, 0.4, ''), (2.0, 0.6, 0.15, 'right_wall'),
     (2.0, 1.4, 0.0, 'left_wall')],
)
def test_drive_with_box_on_route_avoids_it(
    half_m: float, width_m: float, aside_m: float, behaviour: str
) -> None:
    drive = Drive([*corridor(half_m), box(3.0, aside_m, width_m)], [(0.0, 0.0), (7.0, 0.0)])
    drive.behaviour = behaviour
    assert not any(command.failed for command in drive.steps(20.0))
    assert drive.away_m(7.0, 0.0) < 0.3
    assert drive.nearest_m > P.robot_radius_m


def test_gap_narrower_than_robot_reports_failed_tries() -> None:
    gap_m = 0.4
    walls = [*corridor(1.1), box(3.0, -gap_m / 2, 2.2 - gap_m)]
    drive = Drive(walls, [(0.0, 0.0), (7.0, 0.0)])
    commands = drive.steps(14.0)
    assert 2 <= sum(command.failed for command in commands) <= 4
    assert drive.nearest_m > P.robot_radius_m
    assert detour(walls) is None


def test_turning_in_place_reports_failed_tries() -> None:
    """In a closed room with boxes, the robot sees a detour, but none after turning towards it."""
    rng = np.random.default_rng(29)
    half = rng.uniform(1.2, 3.0)
    walls = [*corridor(half), [(3.5, -half), (3.5, half)]]
    for _ in range(rng.integers(1, 6)):
        x_m, aside_m = rng.uniform(0.8, 3.2), rng.uniform(-half, half)
        width_m, depth_m = rng.uniform(0.1, 1.2), rng.uniform(0.1, 0.8)
        walls.append(box(x_m, aside_m, width_m, depth_m))
    drive = Drive(walls, [(0.0, 0.0), (7.0, 0.0)])
    drive.steps(10.0)
    assert sum(command.failed for command in drive.steps(20.0)) >= 5


@pytest.mark.parametrize('range_m', [3.0, math.inf])
def test_beams_without_return_count_as_free(range_m: float) -> None:
    """A wide box in a hall whose walls are beyond the range of the laser."""
    scan = scan_in([*corridor(8.0), box(1.0, 0.1, 1.2)], Pose(0.0, 0.0, 0.0), 0, beams=181)
    far = np.where(scan.ranges_m > range_m, math.inf, scan.ranges_m)
    chosen = plan_detour(LocalMovement(P, replace(scan, ranges_m=far)), STRAIGHT, P)
    assert chosen is not None
    assert -1.2 < chosen.heading_rad < -0.3


def test_too_long_detour_returns_none() -> None:
    """A wall across the route has a gap at the side, through which the robot fits."""
    for aside_m, is_found in ((0.8, True), (2.2, False)):
        posts: list[Line] = [[(1.0, -6.0), (1.0, aside_m - 0.4)], [(1.0, aside_m + 0.4), (1.0, 6)]]
        assert (detour(posts) is not None) == is_found


@pytest.mark.parametrize('side', [1.0, -1.0])
def test_detour_is_shortest_and_equal_ones_keep_heading(side: float) -> None:
    walls = [*corridor(2.0), box(1.0, -0.3 * side, 1.0)]
    chosen = detour(walls)
    assert chosen is not None
    assert 0.2 < side * chosen.heading_rad < math.pi / 2
    again = detour([*corridor(2.0), box(1.0, 0.0, 1.0)], last_rad=side * 0.6)
    assert again is not None
    assert side * again.heading_rad > 0.2


def test_detour_starts_in_free_direction() -> None:
    found = 0
    for seed in range(40):
        rng = np.random.Generator(np.random.PCG64(seed))
        walls = corridor(rng.uniform(0.8, 2.5))
        for _ in range(rng.integers(1, 5)):
            place = rng.uniform((0.4, -1.5, 0.1), (4.0, 1.5, 1.5)).tolist()
            walls.append(box(*place))
        route = np.cumsum(rng.uniform((0.1, -0.5), (1.5, 0.5), (rng.integers(2, 8), 2)), axis=0)
        chosen = detour(walls, route, rng.uniform(-math.pi, math.pi))
        if chosen is None:
            continue
        found += 1
        for away_m in (0.05, 0.1):
            x_m = away_m * math.cos(chosen.heading_rad)
            y_m = away_m * math.sin(chosen.heading_rad)
            assert clearance_m(walls, x_m, y_m) > min(P.robot_radius_m, clearance_m(walls, 0, 0))
    assert 15 < found < 40


def test_route_leaving_grid_at_once_returns_none() -> None:
    for route in ([[0.0, 3.0], [0.0, 5.0]], [[0.0, 0.0]], [[-2.0, 0.0], [0.0, 0.0]]):
        assert detour(corridor(4.0), np.array(route)) is None
    behind = detour(corridor(4.0), np.array([[0.0, 0.0], [-3.0, 0.0]]))
    assert behind is not None
    assert abs(behind.heading_rad) > 2.5
    assert round(20 * GRID_SIDE_M) == ROW_COUNT - 1
    assert round(10 * (GRID_BACK_M + GRID_FRONT_M)) == COLUMN_COUNT - 1
