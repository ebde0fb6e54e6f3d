# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Following a route without touching obstacles."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rooms import (
    SCAN_NS,
    SCAN_S,
    Drive,
    Line,
    corridor,
    dead_end,
    scan_in,
    scan_of_ranges,
    t_junction,
    way_to_point_m,
)

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.free_directions import WALL_DISTANCE_MOST_M
from ratslam_ros.core.driving.goal_follower import TRY_TIMEOUT_S, GoalFollower, in_robot_frame
from ratslam_ros.core.driving.steering import Command

P = GoalFollowerParameters()
AHEAD = np.array([[0.0, 0.0], [5.0, 0.0]])


def command_for(walls: list[Line], route: NDArray[np.float64]) -> Command:
    return GoalFollower(P).command(scan_in(walls), route)


# Following


def test_straight_route_is_driven_to_its_end() -> None:
    drive = Drive(corridor(1.0), [(0.0, 0.0), (6.0, 0.0)])
    commands = drive.steps(8.0)
    assert commands[0].speed_mps > 0.95 * P.speed_mps
    assert all(abs(command.turn_rate_radps) < 0.15 for command in commands)
    drive.steps(8.0)
    assert drive.away_m(6.0, 0.0) < 0.2
    assert abs(drive.pose.y_m) < 0.1


def test_junction_follows_branch_of_route() -> None:
    drive = Drive(t_junction(5.0), [(0.0, 0.0), (4.0, 0.0), (4.0, 5.0)])
    commands = drive.steps(25.0)
    assert drive.away_m(4.0, 5.0) < 0.3
    assert drive.nearest_m > P.robot_radius_m
    assert not any(command.failed for command in commands)
    assert 'turn' not in {command.behaviour for command in commands[:40]}


def test_displaced_route_is_followed_along_corridor() -> None:
    """The map is distorted, so the route leads into the wall of the corridor."""
    drive = Drive(corridor(0.8), [(0.0, 0.0), (10.0, 1.0)])
    drive.steps(12.0)
    assert drive.pose.x_m > 6.0
    assert drive.nearest_m > P.robot_radius_m


@pytest.mark.parametrize('bearing_deg', [180.0 - 1e-6, -180.0 + 1e-6, 120.0, -120.0, 96.0, -96.0])
def test_route_behind_robot_starts_shortest_turn(bearing_deg: float) -> None:
    bearing = math.radians(bearing_deg)
    drive = Drive(corridor(1.0), [(0.0, 0.0), (9.0 * math.cos(bearing), 9.0 * math.sin(bearing))])
    turned_rad = 0.0
    for _ in range(100):
        before = drive.pose
        command = drive.step()
        if command.behaviour != 'turn':
            break
        assert command.speed_mps == 0.0
        assert abs(command.turn_rate_radps) <= P.turn_rate_radps
        turned_rad += math.remainder(drive.pose.heading_rad - before.heading_rad, math.tau)
    left_rad = bearing - turned_rad
    # The turn does not overshoot.
    assert 0.0 <= left_rad * math.copysign(1.0, bearing) < math.radians(25.0)


@pytest.mark.parametrize('bearing_deg', [94.0, 70.0, -70.0, -94.0])
def test_route_beside_robot_starts_without_turning(bearing_deg: float) -> None:
    bearing = math.radians(bearing_deg)
    command = command_for([], np.array([[0.0, 0.0], [math.cos(bearing), math.sin(bearing)]]))
    assert command.behaviour != 'turn'
    assert command.ahead_rad == pytest.approx(bearing, abs=math.radians(4.5))


OPEN_DOOR: list[Line] = [
    [(-20.0, 1.0), (4.0, 1.0), (4.0, 2.0)], [(5.0, 2.0), (5.0, 1.0), (20.0, 1.0)],
    [(-20.0, -1.0), (20.0, -1.0)],
]
BOX: Line = [(4.0, -0.3), (4.0, 0.3), (4.6, 0.3), (4.6, -0.3), (4.0, -0.3)]


@pytest.mark.parametrize(
    ('walls', 'behaviour', 'most'),
    [(corridor(1.0), '', 0), (OPEN_DOOR, 'left_wall', 1), ([*corridor(1.5), BOX], 'left_wall', 6)],
)
def test_noisy_laser_does_not_make_the_robot_oscillate(
    walls: list[Line], behaviour: str, most: int
) -> None:
    drive = Drive(walls, [(0.0, 0.0), (8.0, 0.0)], range_sd_m=0.02)
    drive.behaviour = behaviour
    turns = np.array([command.turn_rate_radps for command in drive.steps(15.0)])
    signs = np.sign(turns[np.abs(turns) > 0.2])
    assert np.count_nonzero(np.diff(signs)) <= most
    assert drive.away_m(8.0, 0.0) < 0.3
    assert drive.nearest_m > P.robot_radius_m


def test_turning_has_hysteresis() -> None:
    """Without hysteresis the robot would oscillate."""
    route = 5.0 * np.array([[0.0, 0.0], [math.cos(0.7), math.sin(0.7)]])
    assert command_for([], route).behaviour != 'turn'
    follower = GoalFollower(P)
    assert follower.command(scan_in([]), -AHEAD).behaviour == 'turn'
    assert follower.command(scan_in([]), route).behaviour == 'turn'


def test_speed_decreases_before_end_of_route() -> None:
    lengths_m = [0.02, 0.1, 0.2, 0.5, 1.0, 3.0]
    speeds = [
        command_for(corridor(), AHEAD * length_m / 5.0).speed_mps for length_m in lengths_m
    ]
    assert speeds == sorted(speeds)
    assert speeds[-1] > 0.95 * P.speed_mps
    for speed, length_m in zip(speeds, lengths_m, strict=True):
        # The offset of 0.1 m/s lets the robot reach the end.
        assert 0.0 < speed <= 0.1 + math.sqrt(2.0 * P.braking_mps2 * length_m)


# Blocked routes


def test_blocked_route_fails_once_per_timeout() -> None:
    follower = GoalFollower(P)
    failed_s = []
    for step in range(100):
        stamp_ns = step * SCAN_NS
        command = follower.command(scan_in(dead_end(0.42), stamp_ns=stamp_ns), AHEAD)
        assert command.speed_mps == 0.0
        assert command.ahead_rad == pytest.approx(0.0)
        if command.failed:
            failed_s.append(stamp_ns * 1e-9)
    assert failed_s == pytest.approx([TRY_TIMEOUT_S * n for n in (1, 2, 3)])


def test_waiting_robot_turns_to_route() -> None:
    turned = np.array([[0.0, 0.0], [5.0 * math.cos(0.8), 5.0 * math.sin(0.8)]])
    command = command_for(dead_end(0.4, 0.4), turned)
    assert (command.speed_mps, command.ahead_rad) == pytest.approx((0.0, 0.8))
    assert 0.0 < command.turn_rate_radps <= P.turn_rate_radps


@pytest.mark.parametrize(('at_m', 'half_width_m'), [(2.1, 1.5), (2.17, 1.0)])
def test_robot_stops_before_blocked_passage(at_m: float, half_width_m: float) -> None:
    drive = Drive(dead_end(at_m, half_width_m), [(0.0, 0.0), (9.0, 0.0)])
    drive.steps(6.0)
    commands = drive.steps(2.0 * TRY_TIMEOUT_S)
    assert all(command.speed_mps == 0.0 for command in commands)
    assert sum(command.failed for command in commands) == 2
    assert drive.nearest_m > P.robot_radius_m


def test_temporary_obstacle_does_not_fail() -> None:
    free, closed = corridor(0.7), [*corridor(0.7), [(2.0, 0.7), (2.0, -0.7)]]
    drive = Drive(free, [(0.0, 0.0), (9.0, 0.0)])
    waited_s = 0.0
    for _ in range(3):
        drive.steps(0.5)
        drive.walls = [*free, [(drive.pose.x_m + 0.8, 0.7), (drive.pose.x_m + 0.8, -0.7)]]
        waiting = drive.steps(TRY_TIMEOUT_S - 0.5)
        assert not any(command.failed for command in waiting)
        waited_s += sum(command.speed_mps == 0.0 for command in waiting) * SCAN_S
        drive.walls = free
    assert waited_s > TRY_TIMEOUT_S  # in total
    assert not any(command.failed for command in drive.steps(20.0))
    assert drive.away_m(9.0, 0.0) < 0.3
    drive = Drive(closed, [(0.0, 0.0), (9.0, 0.0)])  # a permanent one does
    assert any(command.failed for command in drive.steps(10.0))
    assert drive.nearest_m > P.robot_radius_m


# Safety

SCANS = st.lists(st.floats(0.05, 3.0) | st.just(math.inf), min_size=1, max_size=40)
ROUTES = st.lists(
    st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)), min_size=2, max_size=6
)


@given(SCANS, ROUTES)
def test_speed_allows_stopping_before_obstacles(
    ranges_m: list[float], route: list[tuple[float, float]]
) -> None:
    scan = scan_of_ranges(ranges_m)
    command = GoalFollower(P).command(scan, np.array(route))
    assert 0.0 <= command.speed_mps <= P.speed_mps
    assert abs(command.turn_rate_radps) <= P.turn_rate_radps
    if command.speed_mps == 0.0:
        return
    # No point ahead is within the braking distance plus the stop distance.
    stop_m = command.speed_mps**2 / (2.0 * P.braking_mps2) + P.stop_distance_m
    angles = scan.angle_min_rad + scan.angle_increment_rad * np.arange(len(ranges_m))
    for range_m, angle in zip(ranges_m, angles.tolist(), strict=True):
        point = range_m * math.cos(angle), range_m * math.sin(angle)
        if math.isfinite(range_m) and point[0] > 1e-9:
            gap_m = way_to_point_m((0.0, 0.0), (stop_m, 0.0), point) - P.robot_radius_m
            assert gap_m > -1e-6


# Learned walls


@pytest.mark.parametrize(('behaviour', 'side'), [('left_wall', 1.0), ('right_wall', -1.0)])
def test_learned_wall_is_followed_until_final_approach(behaviour: str, side: float) -> None:
    drive = Drive(corridor(2.0), [(0.0, 0.0), (6.0, 0.0)])
    drive.behaviour = behaviour
    commands = drive.steps(7.0)
    assert {command.behaviour for command in commands} == {behaviour}
    assert drive.pose.y_m * side == pytest.approx(2.0 - WALL_DISTANCE_MOST_M, abs=0.1)
    drive.steps(9.0)
    assert drive.away_m(6.0, 0.0) < 0.2
    assert drive.nearest_m > P.robot_radius_m


@pytest.mark.parametrize('bearing_deg', [94.0, -94.0, 96.0, -96.0, 180.0])
def test_wall_following_turns_first_if_route_leads_back(bearing_deg: float) -> None:
    bearing = math.radians(bearing_deg)
    route = np.array([[0.0, 0.0], [2.0 * math.cos(bearing), 2.0 * math.sin(bearing)]])
    command = GoalFollower(P).command(scan_in([]), route, 'left_wall')
    assert (command.behaviour == 'turn') == (abs(bearing_deg) > 95.0)


def test_wall_leading_away_from_route_is_left() -> None:
    drive = Drive(t_junction(5.0), [(0.0, 0.0), (4.0, 0.0), (4.0, -5.0)])
    drive.behaviour = 'left_wall'  # outdated beyond the branch
    drive.steps(25.0)
    assert drive.away_m(4.0, -5.0) < 0.3
    assert drive.nearest_m > P.robot_radius_m


def test_nearest_path_is_chosen_instead_of_wall() -> None:
    """Milford et al. (2006), section IV.C: the direction that is closest to the route."""
    found = []
    for choice in ('learned_wall', 'nearest'):
        drive = Drive(corridor(2.0), [(0.0, -0.5), (8.0, -0.5)])
        drive.follower = GoalFollower(replace(P, path_choice=choice))
        drive.behaviour = 'left_wall'
        drive.steps(6.0)
        found.append(drive.pose.y_m)
    assert found[1] == pytest.approx(-0.5, abs=0.05)
    assert found[0] == pytest.approx(2.0 - WALL_DISTANCE_MOST_M, abs=0.1)


# Robot frame


def test_in_robot_frame_has_x_ahead_and_y_left() -> None:
    local_m = in_robot_frame(Pose(1.0, 2.0, math.pi / 2), np.array([[1.0, 3.0], [0.0, 2.0]]))
    assert local_m == pytest.approx(np.array([[1.0, 0.0], [0.0, 1.0]]))
    assert in_robot_frame(Pose(1.0, 2.0, 0.3), np.empty((0, 2))).shape == (0, 2)
