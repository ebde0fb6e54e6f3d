# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Free directions of a robot in a scan."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rooms import (
    HERE,
    Line,
    corridor,
    dead_end,
    scan_in,
    scan_of_ranges,
    t_junction,
    way_to_point_m,
)

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving import free_directions
from ratslam_ros.core.driving.free_directions import (
    LOOKAHEADS_M,
    WALL_DISTANCE_MOST_M,
    WALL_LOOK_AHEAD_M,
    WALLS,
    DirectionCandidate,
    LocalMovement,
)

P = GoalFollowerParameters()
CLOSE = P.wall_distance_m
"""Parameters for following walls at the minimum distance only."""

BODY_M = P.robot_radius_m + P.margin_m
STEP_RAD = math.radians(3.0)
"""Angle between neighbouring directions."""

NO_OBSTACLE = [math.nan, math.inf, -math.inf, 0.0, -1.0]
RANGES = st.lists(
    st.floats(0.02, 9.0) | st.sampled_from(NO_OBSTACLE), min_size=1, max_size=60
)


def candidates_in(
    walls: list[Line], pose: Pose = HERE, most_m: float = WALL_DISTANCE_MOST_M
) -> list[DirectionCandidate]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(free_directions, 'WALL_DISTANCE_MOST_M', most_m)
        return LocalMovement(P, scan_in(walls, pose)).candidates()


def only(candidates: list[DirectionCandidate], behaviour: str) -> DirectionCandidate:
    (found,) = [each for each in candidates if each.behaviour == behaviour]
    return found


def centrelines_deg(candidates: list[DirectionCandidate]) -> list[float]:
    return sorted(
        math.degrees(each.heading_rad)
        for each in candidates
        if each.behaviour == 'centreline'
    )


# Rooms


def test_corridor_has_centreline_and_both_walls() -> None:
    candidates = candidates_in(corridor(1.0), most_m=CLOSE)
    left, right = only(candidates, 'left_wall'), only(candidates, 'right_wall')
    # The steepest heading that is free for the lookahead distance.
    steepest_rad = math.asin((1.0 - P.wall_distance_m) / WALL_LOOK_AHEAD_M)
    assert steepest_rad - STEP_RAD <= left.heading_rad <= steepest_rad
    assert left.free_m == pytest.approx((1.0 - P.wall_distance_m) / math.sin(left.heading_rad),
                                        abs=0.02)
    assert (right.heading_rad, right.free_m) == pytest.approx((-left.heading_rad, left.free_m))
    # The free distance is limited to the range of the laser.
    far = [candidate for candidate in candidates if candidate.free_m == 8.0]
    assert far
    assert all(candidate.behaviour == 'centreline' for candidate in far)
    assert centrelines_deg(candidates) == pytest.approx([0.0] * len(LOOKAHEADS_M), abs=1e-9)


@pytest.mark.parametrize('most_m', [WALL_DISTANCE_MOST_M, CLOSE])
@pytest.mark.parametrize(('width_m', 'is_entered'), [(1.1, True), (0.9, True), (0.7, False)])
def test_door_on_left_is_entered_if_wide_enough(
    most_m: float, width_m: float, is_entered: bool
) -> None:
    half = width_m / 2
    walls: list[Line] = [
        [(-20.0, 1.0), (-half, 1.0), (-half, 1.1), (-4.0, 1.1), (-4.0, 6.0)],
        [(20.0, 1.0), (half, 1.0), (half, 1.1), (4.0, 1.1), (4.0, 6.0), (-4.0, 6.0)],
        [(-20.0, -1.0), (20.0, -1.0)],
    ]
    candidates = candidates_in(walls, most_m=most_m)
    in_corridor = only(candidates_in(corridor(1.0), most_m=most_m), 'left_wall')
    left = only(candidates, 'left_wall')
    if is_entered:
        assert left.heading_rad > math.radians(75.0)
        assert left.free_m > 3.0
    else:
        assert left.heading_rad == pytest.approx(in_corridor.heading_rad, abs=2 * STEP_RAD)
    assert only(candidates, 'right_wall').heading_rad == pytest.approx(-in_corridor.heading_rad)
    # From 2 m before the door, the direction still follows the wall.
    before = only(candidates_in(walls, Pose(-3.0, 0.0, 0.0), most_m), 'left_wall')
    assert before.heading_rad == pytest.approx(in_corridor.heading_rad)


def test_near_dead_end_has_no_candidates() -> None:
    assert candidates_in(dead_end(0.5)) == []
    movement = LocalMovement(P, scan_in(dead_end(0.5)))
    assert movement.free_m(0.0) == pytest.approx(0.5 - BODY_M, abs=0.01)
    assert movement.free_m(0.0, P.robot_radius_m) == pytest.approx(
        0.5 - P.robot_radius_m, abs=0.01
    )
    # A distant one has a centreline.
    assert centrelines_deg(candidates_in(dead_end(2.0))) == pytest.approx([0.0], abs=1.5)


def test_t_junction_has_candidates_to_both_sides() -> None:
    candidates = candidates_in(t_junction(1.0))
    left, right = only(candidates, 'left_wall'), only(candidates, 'right_wall')
    assert left.heading_rad == pytest.approx(math.pi / 2, abs=0.25)
    assert right.heading_rad == pytest.approx(-left.heading_rad)
    centres = centrelines_deg(candidates)
    assert len(centres) == 2 * len(LOOKAHEADS_M)
    assert centres == pytest.approx([-deg for deg in reversed(centres)])
    assert all(60.0 < deg < 90.0 for deg in centres[len(LOOKAHEADS_M) :])


@pytest.mark.parametrize('aside_m', [0.0, 0.25, -0.4])
@pytest.mark.parametrize(
    ('gap_m', 'fits'), [(0.3, False), (2 * BODY_M - 0.03, False), (2 * BODY_M + 0.1, True)]
)
def test_gap_is_passed_only_if_wide_enough(gap_m: float, fits: bool, aside_m: float) -> None:
    at_m = 1.2
    walls: list[Line] = [
        [(at_m, 20.0), (at_m, aside_m + gap_m / 2)], [(at_m, aside_m - gap_m / 2), (at_m, -20.0)],
    ]
    movement = LocalMovement(P, scan_in(walls, beams=1441))
    bearing_rad = math.atan2(aside_m, at_m)
    through = [
        candidate
        for candidate in [*movement.candidates(), *movement.straight_directions()]
        if candidate.free_m * math.cos(candidate.heading_rad) > at_m
    ]
    assert bool(through) == fits
    for candidate in through:
        assert abs(at_m * math.tan(candidate.heading_rad) - aside_m) < gap_m / 2
    assert (movement.free_m(bearing_rad) > at_m) == fits


# Any scan


@given(RANGES, st.floats(-math.pi, math.pi), st.floats(0.05, 0.6))
def test_free_distance_ends_at_first_contact(
    ranges_m: list[float], heading_rad: float, half_width_m: float
) -> None:
    movement = LocalMovement(P, scan_of_ranges(ranges_m))
    free_m = movement.free_m(heading_rad, half_width_m)
    assert 0.0 <= free_m <= 8.0
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    end, on = (free_m * c, free_m * s), ((free_m + 0.01) * c, (free_m + 0.01) * s)
    touched = False
    for x, y in movement.points.tolist():
        if c * x + s * y <= 0.0:  # behind the robot
            continue
        gap_m = way_to_point_m((0.0, 0.0), end, (x, y)) - half_width_m
        assert gap_m >= -1e-6 or free_m == 0.0
        # The tolerance is for points that the body only grazes.
        touched |= way_to_point_m(end, on, (x, y)) < half_width_m + 1e-6
    assert touched or free_m == 8.0


@given(RANGES)
def test_candidates_have_their_minimum_free_distance(ranges_m: list[float]) -> None:
    movement = LocalMovement(P, scan_of_ranges(ranges_m))
    for candidate in movement.candidates():
        if candidate.behaviour == 'centreline':
            assert movement.free_m(candidate.heading_rad) >= LOOKAHEADS_M[0]
        else:
            # In doors the distance to the wall may be smaller.
            free_m = movement.free_m(candidate.heading_rad, (P.wall_distance_m + BODY_M) / 2)
            assert free_m >= candidate.free_m >= WALL_LOOK_AHEAD_M


@pytest.mark.parametrize('beams', [8, 60, 180])  # no beam is perpendicular to a direction
@pytest.mark.parametrize('seed', range(4))
def test_mirrored_scan_has_mirrored_candidates(seed: int, beams: int) -> None:
    ranges_m = np.random.default_rng(seed).uniform(0.1, 1.0 + 1.5 * seed, beams)
    original, mirrored = (
        LocalMovement(P, scan_of_ranges(ranges)).candidates()
        for ranges in (ranges_m, ranges_m[::-1])
    )
    other = {'left_wall': 'right_wall', 'right_wall': 'left_wall', 'centreline': 'centreline'}
    expected = [(other[each.behaviour], -each.heading_rad, each.free_m) for each in original]
    found = [(each.behaviour, each.heading_rad, each.free_m) for each in mirrored]
    for (a, a_rad, a_m), (b, b_rad, b_m) in zip(sorted(expected), sorted(found), strict=True):
        assert a == b
        assert (a_rad, a_m) == pytest.approx((b_rad, b_m), abs=1e-9)


@given(RANGES)
def test_beams_without_return_are_no_obstacles(ranges_m: list[float]) -> None:
    scan = scan_of_ranges(ranges_m)
    ends = [
        (r * math.cos(angle), r * math.sin(angle))
        for r, angle in zip(
            ranges_m, scan.angle_min_rad + scan.angle_increment_rad * np.arange(len(ranges_m)),
            strict=True,
        )
        if math.isfinite(r) and r > 0.0
    ]
    points = LocalMovement(P, scan).points
    assert points == pytest.approx(np.array(ends).reshape(-1, 2))


@pytest.mark.parametrize('nothing', NO_OBSTACLE)
def test_scan_without_returns_is_free(nothing: float) -> None:
    movement = LocalMovement(P, scan_of_ranges([nothing] * 181))
    assert {candidate.free_m for candidate in movement.candidates()} == {8.0}
    left, right = (only(movement.candidates(), side) for side in WALLS)
    assert (left.heading_rad, right.heading_rad) == (math.pi / 2, -math.pi / 2)


def test_scan_points_start_at_minimum_angle() -> None:
    ahead_and_left = Scan(0, -0.5, 0.5, np.array([math.inf, 2.0, 1.0]))
    points = LocalMovement(P, ahead_and_left).points
    assert points == pytest.approx(np.array([(2.0, 0.0), (math.cos(0.5), math.sin(0.5))]))
    assert len(LocalMovement(P, Scan(0, 0.0, 0.1, np.empty(0))).points) == 0
