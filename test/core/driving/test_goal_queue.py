# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Driving by the goal memory alone, between walls: goals in order, moved goals, blocked ways."""

from __future__ import annotations

import math
from typing import Any

import pytest
from rooms import SCAN_NS, SCAN_S, Line, clearance_m, scan_in

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config, GoalMemoryParameters, additions
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.goal_follower import GoalFollower
from ratslam_ros.core.driving.goal_queue import GoalQueue, SoughtGoal, route_towards
from ratslam_ros.core.goal_memory.goal_memory import GoalMemory
from ratslam_ros.core.pose_cells.pose_cells import PoseCells


def square(x0: float, y0: float, x1: float, y1: float) -> Line:
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]


RING = [square(-1.0, -1.0, 7.0, 5.0), square(1.0, 1.0, 5.0, 3.0)]
"""Corridors of 2 m around a block; the robot starts in the corner (0, 0), heading along x."""


class Robot:
    """A robot with exact odometry and a laser, without views."""

    def __init__(self) -> None:
        cells = Config().with_values({
            'pose_cells.pc_dim_x': 60, 'pose_cells.pc_dim_y': 50,
            'pose_cells.pc_cell_x_size': 0.25,
        }).pose_cells
        chosen = additions.GOAL_ROUTES.instead_of(GoalMemory, GoalMemoryParameters(True))
        self.cells, self.memory = PoseCells(cells), chosen(cells)
        self.queue, self.follower = GoalQueue(), GoalFollower(GoalFollowerParameters())
        self.walls, self.pose, self.stamp_ns = list(RING), Pose(0.0, 0.0, 0.0), 0
        self.nearest_m = math.inf

    def move(self, speed_mps: float, turn_rate_radps: float) -> None:
        motion = Motion(SCAN_S, speed_mps * SCAN_S, turn_rate_radps * SCAN_S)
        self.pose = moved(self.pose, motion)
        self.cells.integrate(motion)
        self.memory.integrate(motion, self.cells)
        self.stamp_ns += SCAN_NS

    def led(self, *places: tuple[float, float]) -> None:
        """Drive straight to places, at 0.5 m/s."""
        for x_m, y_m in places:
            to_x, to_y = x_m - self.pose.x_m, y_m - self.pose.y_m
            turn_rad = wrap(math.atan2(to_y, to_x) - self.pose.heading_rad)
            for _ in range(10):
                self.move(0.0, turn_rad / 10 / SCAN_S)
            count = round(math.hypot(to_x, to_y) / 0.5 / SCAN_S)
            for _ in range(count):
                self.move(math.hypot(to_x, to_y) / count / SCAN_S, 0.0)

    def mark(self, name: str) -> None:
        self.memory.mark(name, self.cells.peak)

    def sought(self) -> SoughtGoal | None:
        return self.queue.update(self.stamp_ns, self.memory, self.cells.peak)

    def step(self) -> SoughtGoal | None:
        """Drive on for a scan, as the nodes do."""
        sought = self.sought()
        if sought is None or sought.bearing_rad is None:
            self.move(0.0, 0.0)
            return sought
        scan = scan_in(self.walls, self.pose, self.stamp_ns, beams=181)
        command = self.follower.command(scan, route_towards(sought.bearing_rad))
        blocked = self.queue.blocked() if command.failed else None
        if blocked is not None:
            self.memory.blocked(self.cells.peak, *blocked)
        self.move(command.speed_mps, command.turn_rate_radps)
        clear_m = clearance_m(self.walls, self.pose.x_m, self.pose.y_m)
        self.nearest_m = min(self.nearest_m, clear_m)
        return sought

    def seek(self, *names: str, limit_s: float = 120.0) -> dict[str, Any]:
        """Drive to goals in order; return where each was reached, or why it was given up."""
        for name in names:
            self.queue.append(name)
        ended: dict[str, Any] = {}
        for _ in range(round(limit_s / SCAN_S)):
            sought = self.step()
            if sought is None:
                break
            if sought.is_reached:
                ended[sought.name] = self.pose.x_m, self.pose.y_m
            elif sought.given_up:
                ended[sought.name] = sought.given_up
        return ended


def ring(*further: tuple[float, float]) -> Robot:
    """Return a robot that was led round the ring, and then elsewhere."""
    robot = Robot()
    robot.mark('home')
    robot.led((6.0, 0.0), (6.0, 4.0))
    robot.mark('far')
    robot.led((0.0, 4.0), (0.0, 0.0), *further)
    return robot


# Goals


def test_queued_goals_are_reached_in_order() -> None:
    robot = ring((2.0, 0.0))
    ended = robot.seek('far', 'home')
    assert [*ended] == ['far', 'home']
    assert ended['far'] == pytest.approx((6.0, 4.0), abs=0.5)
    assert ended['home'] == pytest.approx((0.0, 0.0), abs=0.5)
    assert robot.nearest_m > GoalFollowerParameters().robot_radius_m
    assert robot.sought() is None


def test_goal_marked_anew_changes_direction_at_once() -> None:
    robot = ring((3.0, 0.0))  # it heads along x
    robot.queue.append('home')
    before = robot.sought()
    assert before is not None and before.bearing_rad is not None
    assert abs(before.bearing_rad) > math.radians(140.0)
    robot.memory.mark('home', robot.memory.goal('far'))
    after = robot.sought()
    assert after is not None and after.bearing_rad is not None
    assert abs(after.bearing_rad) < math.radians(40.0)
    assert robot.seek()['home'] == pytest.approx((6.0, 4.0), abs=0.5)


def test_cancelling_empties_queue_and_ends_sought_goal() -> None:
    robot = ring()
    assert robot.queue.cancel('cancelled') is None
    for name in ('far', 'home', 'home'):  # sent twice
        robot.queue.append(name)
    assert [*robot.queue.names] == ['far', 'home']
    assert robot.step()
    cancelled = robot.queue.cancel('cancelled')
    assert cancelled is not None
    assert (cancelled.name, cancelled.given_up) == ('far', 'cancelled')
    assert robot.sought() is None
    assert robot.queue.blocked() is None


def test_goal_that_is_not_marked_is_given_up() -> None:
    robot = ring()
    robot.queue.append('kitchen')
    robot.queue.append('home')
    sought = robot.sought()
    assert sought is not None and 'no goal is named' in sought.given_up
    assert [*robot.queue.names] == ['home']


# Blocked ways


def test_blocked_way_is_avoided_by_another_one() -> None:
    robot = ring()
    robot.walls.append([(2.5, -1.0), (2.5, 1.0)])  # from the left corner along x
    ended = robot.seek('far')
    assert ended['far'] == pytest.approx((6.0, 4.0), abs=0.5)
    assert robot.nearest_m > GoalFollowerParameters().robot_radius_m


def test_blocked_goal_is_given_up_and_next_one_sought(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('ratslam_ros.core.driving.goal_queue.MAX_TRY_COUNT', 4)
    robot = ring((1.5, 0.0))
    robot.walls += [[(3.0, -1.0), (3.0, 1.0)], [(3.0, 3.0), (3.0, 5.0)]]
    ended = robot.seek('far', 'home')
    assert ended['far'] == 'the way is blocked: 4 tries have failed'
    assert ended['home'] == pytest.approx((0.0, 0.0), abs=0.5)


def test_goal_without_progress_is_given_up() -> None:
    robot = ring()
    robot.queue.append('far')
    for _ in range(1198):
        sought = robot.sought()
        assert sought is not None and not sought.given_up
        robot.stamp_ns += SCAN_NS
    robot.move(0.5, 0.0)
    robot.stamp_ns += 2 * SCAN_NS
    sought = robot.sought()
    assert sought is not None and sought.given_up == 'no progress within 120 s'


def test_stamps_that_jump_back_begin_the_time_limit_anew() -> None:
    robot = ring()
    robot.queue.append('far')
    for stamp_s, is_over in ((1000, False), (500, False), (600, False), (620, True)):
        robot.stamp_ns = stamp_s * 10**9
        sought = robot.sought()
        assert sought is not None and bool(sought.given_up) == is_over
