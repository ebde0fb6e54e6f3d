# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a scan leaves free for a robot."""

from __future__ import annotations

import math
from dataclasses import replace

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

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.free_directions import (
    LOOK_AHEAD_M,
    WALLS,
    Behaviour,
    DirectionCandidate,
    LocalMovement,
)

P = GoalFollowerParameters()
CLOSE = replace(P, wall_distance_most_m=P.wall_distance_m)
"""Along walls as close as may be, however wide the way is."""

BODY_M = P.robot_radius_m + P.margin_m
STEP_RAD = math.radians(3.0)
"""Between two directions that are looked at."""

NO_OBSTACLE = [math.nan, math.inf, -math.inf, 0.0, -1.0]
RANGES = st.lists(
    st.floats(0.02, 9.0) | st.sampled_from(NO_OBSTACLE), min_size=1, max_size=60
)


def options_in(
    walls: list[Line], pose: Pose = HERE, p: GoalFollowerParameters = P
) -> list[DirectionCandidate]:
    return LocalMovement(p, scan_in(walls, pose)).options()


def only(options: list[DirectionCandidate], behaviour: str) -> DirectionCandidate:
    (found,) = [option for option in options if option.behaviour == behaviour]
    return found


def centrelines_deg(options: list[DirectionCandidate]) -> list[float]:
    return sorted(
        math.degrees(option.heading_rad)
        for option in options
        if option.behaviour == 'centreline'
    )


# Rooms


def test_a_corridor_goes_on_ahead_and_each_wall_is_steered_to() -> None:
    options = options_in(corridor(1.0), p=CLOSE)
    left, right = only(options, 'left_wall'), only(options, 'right_wall')
    # So far to the side that the robot, 0.58 m from where it touches, is at the wall in 0.8 m.
    steepest_rad = math.asin((1.0 - P.wall_distance_m) / P.wall_look_ahead_m)
    assert steepest_rad - STEP_RAD <= left.heading_rad <= steepest_rad
    assert left.open_m == pytest.approx((1.0 - P.wall_distance_m) / math.sin(left.heading_rad),
                                        abs=0.02)  # fmt: skip
    assert (right.heading_rad, right.open_m) == pytest.approx((-left.heading_rad, left.open_m))
    # Beyond the laser's reach nothing bars the way.
    far = [option for option in options if option.open_m == 8.0]
    assert far
    assert all(option.behaviour == 'centreline' for option in far)
    assert centrelines_deg(options) == pytest.approx([0.0] * len(LOOK_AHEAD_M), abs=1e-9)


def test_a_robot_that_is_as_far_from_a_wall_as_it_should_be_goes_along_it() -> None:
    beside = 1.0 - P.wall_distance_m - 0.01
    left = only(options_in(corridor(1.0), Pose(0.0, beside, 0.0), CLOSE), 'left_wall')
    assert left.heading_rad == pytest.approx(0.0, abs=1e-9)
    right = only(options_in(corridor(1.0), Pose(0.0, -beside, 0.0), CLOSE), 'right_wall')
    assert right.heading_rad == pytest.approx(0.0, abs=1e-9)
    nearer = only(options_in(corridor(1.0), Pose(0.0, beside + 0.1, 0.0), CLOSE), 'left_wall')
    assert nearer.heading_rad < -STEP_RAD  # away from it


def followed(half_width_m: float, side: Behaviour, y_m: float) -> float:
    """Return the y at which a robot ends that follows a wall of a corridor for 8 m."""
    pose = Pose(0.0, y_m, 0.0)
    for _ in range(160):
        movement = LocalMovement(P, scan_in(corridor(half_width_m), pose))
        option = movement.wall(side, 0.0, math.pi / 2)
        assert option is not None
        turned = Pose(0.0, 0.0, max(-0.15, min(option.heading_rad, 0.15)))
        pose = composed(composed(pose, turned), Pose(0.05, 0.0, 0.0))
    return pose.y_m


@pytest.mark.parametrize('y_m', [0.0, 0.5, -0.5])
@pytest.mark.parametrize('side', WALLS)
def test_in_a_passage_both_walls_are_followed_in_its_middle(side: Behaviour, y_m: float) -> None:
    assert followed(0.98, side, y_m) == pytest.approx(0.0, abs=0.25)


@pytest.mark.parametrize('y_m', [1.7, 2.0, 2.4])
@pytest.mark.parametrize(('side', 'sign'), [('left_wall', 1.0), ('right_wall', -1.0)])
def test_where_there_is_room_a_wall_is_followed_at_the_greater_distance(
    side: Behaviour, sign: float, y_m: float
) -> None:
    y_m = followed(3.0, side, sign * y_m)
    assert 3.0 - sign * y_m == pytest.approx(P.wall_distance_most_m, abs=0.2)


@pytest.mark.parametrize('p', [P, CLOSE])
@pytest.mark.parametrize(('width_m', 'is_taken'), [(1.1, True), (0.9, True), (0.7, False)])
def test_a_door_to_the_left_is_entered_where_it_is_wide_enough(
    p: GoalFollowerParameters, width_m: float, is_taken: bool
) -> None:
    half = width_m / 2
    walls: list[Line] = [
        [(-20.0, 1.0), (-half, 1.0), (-half, 1.1), (-4.0, 1.1), (-4.0, 6.0)],
        [(20.0, 1.0), (half, 1.0), (half, 1.1), (4.0, 1.1), (4.0, 6.0), (-4.0, 6.0)],
        [(-20.0, -1.0), (20.0, -1.0)],
    ]
    options = options_in(walls, p=p)
    in_corridor = only(options_in(corridor(1.0), p=p), 'left_wall')
    left = only(options, 'left_wall')
    if is_taken:
        assert left.heading_rad > math.radians(75.0)
        assert left.open_m > 3.0
    else:
        assert left.heading_rad == pytest.approx(in_corridor.heading_rad, abs=2 * STEP_RAD)
    assert only(options, 'right_wall').heading_rad == pytest.approx(-in_corridor.heading_rad)
    # Seen from 2 m before it a door is no reason to leave the wall.
    before = only(options_in(walls, Pose(-3.0, 0.0, 0.0), p), 'left_wall')
    assert before.heading_rad == pytest.approx(in_corridor.heading_rad)


def test_a_dead_end_leaves_no_way_on_but_to_turn() -> None:
    assert options_in(dead_end(0.5)) == []
    movement = LocalMovement(P, scan_in(dead_end(0.5)))
    assert movement.open_m(0.0) == pytest.approx(0.5 - BODY_M, abs=0.01)
    assert movement.open_m(0.0, P.robot_radius_m) == pytest.approx(
        0.5 - P.robot_radius_m, abs=0.01
    )
    # Further off there is room to drive up to it.
    assert centrelines_deg(options_in(dead_end(2.0))) == pytest.approx([0.0], abs=1.5)


def test_a_t_junction_leads_to_both_sides_and_not_ahead() -> None:
    options = options_in(t_junction(1.0))
    left, right = only(options, 'left_wall'), only(options, 'right_wall')
    assert left.heading_rad == pytest.approx(math.pi / 2, abs=0.25)
    assert right.heading_rad == pytest.approx(-left.heading_rad)
    centres = centrelines_deg(options)
    assert len(centres) == 2 * len(LOOK_AHEAD_M)
    assert centres == pytest.approx([-deg for deg in reversed(centres)])
    assert all(60.0 < deg < 90.0 for deg in centres[len(LOOK_AHEAD_M) :])


def test_far_off_the_branches_of_a_junction_are_one_way_on() -> None:
    assert np.abs(centrelines_deg(options_in(t_junction(6.0)))).max() < 1.5


@pytest.mark.parametrize('aside_m', [0.0, 0.25, -0.4])
@pytest.mark.parametrize(
    ('gap_m', 'fits'), [(0.3, False), (2 * BODY_M - 0.03, False), (2 * BODY_M + 0.1, True)]
)
def test_no_way_leads_through_a_gap_that_is_narrower_than_the_robot(
    gap_m: float, fits: bool, aside_m: float
) -> None:
    at_m = 1.2
    walls: list[Line] = [
        [(at_m, 20.0), (at_m, aside_m + gap_m / 2)], [(at_m, aside_m - gap_m / 2), (at_m, -20.0)],
    ]  # fmt: skip
    movement = LocalMovement(P, scan_in(walls, beams=1441))
    bearing_rad = math.atan2(aside_m, at_m)
    through = [
        option
        for option in [*movement.options(), *movement.fan()]
        if option.open_m * math.cos(option.heading_rad) > at_m
    ]
    assert bool(through) == fits
    for option in through:
        assert abs(at_m * math.tan(option.heading_rad) - aside_m) < gap_m / 2
    assert (movement.open_m(bearing_rad) > at_m) == fits


# Any scan


@given(RANGES, st.floats(-math.pi, math.pi), st.floats(0.05, 0.6))
def test_a_body_touches_nothing_on_what_is_open_and_something_at_its_end(
    ranges_m: list[float], heading_rad: float, half_width_m: float
) -> None:
    movement = LocalMovement(P, scan_of_ranges(ranges_m))
    open_m = movement.open_m(heading_rad, half_width_m)
    assert 0.0 <= open_m <= 8.0
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    end, on = (open_m * c, open_m * s), ((open_m + 0.01) * c, (open_m + 0.01) * s)
    touched = False
    for x, y in movement.points.tolist():
        if c * x + s * y <= 0.0:  # behind: it is left
            continue
        gap_m = way_to_point_m((0.0, 0.0), end, (x, y)) - half_width_m
        assert gap_m >= -1e-6 or open_m == 0.0
        # A point that is only brushed lets the body pass.
        touched |= way_to_point_m(end, on, (x, y)) < half_width_m + 1e-6
    assert touched or open_m == 8.0


@given(RANGES)
def test_every_option_is_as_open_as_it_says_it_must_be(ranges_m: list[float]) -> None:
    movement = LocalMovement(P, scan_of_ranges(ranges_m))
    for option in movement.options():
        if option.behaviour == 'centreline':
            assert movement.open_m(option.heading_rad) >= LOOK_AHEAD_M[0]
        else:
            # Through doors it need not keep all of its distance.
            open_m = movement.open_m(option.heading_rad, (P.wall_distance_m + BODY_M) / 2)
            assert open_m >= option.open_m >= P.wall_look_ahead_m


@pytest.mark.parametrize('beams', [8, 60, 180])  # none is at a right angle to a direction
@pytest.mark.parametrize('seed', range(20))
def test_a_mirrored_scan_has_mirrored_options(seed: int, beams: int) -> None:
    ranges_m = np.random.default_rng(seed).uniform(0.1, 1.0 + seed / 4.0, beams)
    seen, mirrored = (
        LocalMovement(P, scan_of_ranges(ranges)).options() for ranges in (ranges_m, ranges_m[::-1])
    )
    other = {'left_wall': 'right_wall', 'right_wall': 'left_wall', 'centreline': 'centreline'}
    expected = [(other[option.behaviour], -option.heading_rad, option.open_m) for option in seen]
    found = [(option.behaviour, option.heading_rad, option.open_m) for option in mirrored]
    for (a, a_rad, a_m), (b, b_rad, b_m) in zip(sorted(expected), sorted(found), strict=True):
        assert a == b
        assert (a_rad, a_m) == pytest.approx((b_rad, b_m), abs=1e-9)


@given(RANGES)
def test_beams_without_an_end_are_no_obstacles(ranges_m: list[float]) -> None:
    scan = scan_of_ranges(ranges_m)
    ends = [
        (r * math.cos(angle), r * math.sin(angle))
        for r, angle in zip(
            ranges_m, scan.angle_min_rad + scan.angle_increment_rad * np.arange(len(ranges_m)),
            strict=True,
        )
        if math.isfinite(r) and r > 0.0
    ]  # fmt: skip
    points = LocalMovement(P, scan).points
    assert points == pytest.approx(np.array(ends).reshape(-1, 2))


@pytest.mark.parametrize('nothing', NO_OBSTACLE)
def test_where_nothing_is_seen_all_is_open(nothing: float) -> None:
    movement = LocalMovement(P, scan_of_ranges([nothing] * 181))
    assert {option.open_m for option in movement.options()} == {8.0}
    left, right = only(movement.options(), 'left_wall'), only(movement.options(), 'right_wall')
    assert (left.heading_rad, right.heading_rad) == (math.pi / 2, -math.pi / 2)


def test_the_fan_is_every_direction_as_far_as_the_body_comes() -> None:
    movement = LocalMovement(P, scan_in(t_junction(5.0)))
    fan = movement.fan()
    assert [option.heading_rad for option in fan] == movement.headings_rad.tolist()
    for option in fan:
        assert option.behaviour == 'straight'
        assert option.open_m == pytest.approx(movement.open_m(option.heading_rad))


@pytest.mark.parametrize(('behaviour', 'side'), [('left_wall', 1.0), ('right_wall', -1.0)])
def test_a_wall_is_looked_for_about_a_direction(behaviour: Behaviour, side: float) -> None:
    movement = LocalMovement(P, scan_in(corridor(1.5)))
    anywhere = only(movement.options(), behaviour)
    assert movement.wall(behaviour, 0.0, math.pi) == anywhere
    within = movement.wall(behaviour, 0.0, 0.2)
    assert within is not None
    assert within.heading_rad == pytest.approx(0.2 * side, abs=math.radians(3.0))
    across = LocalMovement(P, scan_in(corridor(0.6)))
    assert across.wall(behaviour, side * math.pi / 2, 0.5) is None  # only a wall is there


def test_beams_count_from_where_the_scan_begins() -> None:
    ahead_and_left = Scan(0, -0.5, 0.5, np.array([math.inf, 2.0, 1.0]))
    points = LocalMovement(P, ahead_and_left).points
    assert points == pytest.approx(np.array([(2.0, 0.0), (math.cos(0.5), math.sin(0.5))]))
    assert len(LocalMovement(P, Scan(0, 0.0, 0.1, np.empty(0))).points) == 0
