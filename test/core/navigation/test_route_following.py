# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which route is followed, where the robot is on it, and when it is left."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Goal
from ratslam_ros.core.navigation.route_following import (
    ARRIVED_M,
    LEAVING_M,
    LINGER_S,
    STRAY_M,
    STUCK_M,
    STUCK_S,
    Guidance,
    RouteFollowing,
    point_ahead,
)
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.core.pose_cells.map_action import Action, MapAction
from ratslam_ros.core.pose_cells.torus import Place

NOWHERE = Place(0.0, 0.0, 0.0)
PARAMETERS = GoalRecallParameters(route_keep_s=30.0, route_switch_s=5.0)
S = 1_000_000_000


class Robot:
    """A robot that knows where it is; its map is as good."""

    def __init__(self) -> None:
        self.map = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
        self.recall = RoutePlanner(PARAMETERS)
        self.pose = Pose(0.0, 0.0, 0.0)
        self.stamp_ns = 0
        self.following: RouteFollowing | None = None
        self.arrive()

    def set_out(self, goal: Goal | int) -> Guidance:
        self.following = RouteFollowing(
            self.recall, self.map, goal if isinstance(goal, Goal) else Goal(goal)
        )
        return self.update()

    def update(self, located: bool = True) -> Guidance:
        assert self.following is not None
        return self.following.update(self.stamp_ns, located=located)

    def wait(self, seconds: float) -> None:
        self._integrate(Motion(seconds, 0.0, 0.0))

    def drive(self, way_m: float, heading: float = 0.0, speed_mps: float = 0.5) -> None:
        """Turn on the spot, at once, and drive straight on; headings are quarter turns."""
        turn = math.remainder(heading * math.pi / 2 - self.pose.heading_rad, math.tau)
        self._integrate(Motion(0.0, 0.0, turn))
        self._integrate(Motion(abs(way_m) / speed_mps, way_m, 0.0))

    def _integrate(self, motion: Motion) -> None:
        self.pose = moved(self.pose, motion)
        self.map.integrate(motion)
        self.stamp_ns += round(motion.dt_s * S)

    def arrive(self, target: int | None = None, linked: bool = True) -> int:
        """Come to an experience, None for a new one; the views tell how the robot is turned."""
        known = len(self.map)
        target = known if target is None else target
        source = self.map.current_id if linked else -1
        turned = 0.0
        if target < known:
            turned = wrap(self.pose.heading_rad - self.map.pose_of(target).heading_rad)
        kind: Action = 'create' if target == known else 'link'
        self.map.apply(MapAction(kind, source, target, target, turned, NOWHERE))
        return target

    def nearest(self) -> tuple[int, float]:
        """Return the nearest experience, and how far it is."""
        away_m = np.hypot(*(self.map.poses[:, :2] - self.pose[:2]).T)
        return int(np.argmin(away_m)), float(away_m.min())

    def explore(self, way_m: float, heading: float = 0.0, every_m: float = 0.5) -> list[int]:
        """Drive straight on and learn experiences on the way."""
        ids = []
        for _ in range(round(way_m / every_m)):
            self.drive(every_m, heading)
            ids.append(self.arrive())
        return ids


def back_at_the_start(length_m: float = 10.0) -> Robot:
    """Return a robot at (0, 0) whose map is a straight corridor along x, every 0.5 m."""
    robot = Robot()
    for known in reversed([0, *robot.explore(length_m)[:-1]]):
        robot.drive(0.5, 2.0)
        robot.arrive(known)
    return robot


def test_a_known_way_is_followed_to_its_end() -> None:
    robot = back_at_the_start()
    guidance = robot.set_out(20)
    assert guidance.positions_m[:, 0] == pytest.approx(np.arange(0.0, 10.1, 0.5))
    assert guidance.arrival_s == pytest.approx(np.arange(0.0, 20.1))
    assert guidance.waypoint == pytest.approx((1.0, 0.0, 0.0))
    for known in range(1, 20):
        for _ in range(2):
            robot.drive(0.25)
            guidance = robot.update()
            assert guidance.status == 'following'
            assert guidance.positions_m[0] == pytest.approx((robot.pose.x_m, 0.0))
            assert guidance.remaining_s == pytest.approx(2 * (10.0 - robot.pose.x_m))
            assert guidance.arrival_s[-1] == guidance.remaining_s
        robot.arrive(known)
    robot.drive(0.25)
    assert robot.update().status == 'following'  # within the radius, and it comes closer yet
    robot.drive(0.25)
    guidance = robot.update()
    assert (guidance.status, robot.pose.x_m) == ('succeeded', pytest.approx(10.0))
    assert (guidance.replanned, guidance.switched) == (1, 0)


def test_the_place_of_a_goal_is_beside_its_experience() -> None:
    robot = back_at_the_start()
    guidance = robot.set_out(Goal(10, Pose(0.0, 0.25, 0.0)))
    assert guidance.positions_m[-2:] == pytest.approx(np.array([[5.0, 0.0], [5.0, 0.25]]))
    assert guidance.goal == pytest.approx((5.0, 0.25, 0.0))


def test_a_goal_that_is_passed_beside_the_way_is_reached() -> None:
    for beside_m, expected in ((0.35, 'succeeded'), (0.37, 'lost')):
        robot = Robot()
        robot.explore(2.0)
        robot.map.current_id, robot.map.offset = 0, Pose(0.0, beside_m, 0.0)
        assert robot.set_out(3).status == 'following'
        robot.drive(1.25)
        assert robot.update().status == 'following'
        robot.drive(0.25)
        robot.arrive(linked=False)
        assert robot.update().status == expected


def test_a_robot_that_waits_does_not_run_ahead() -> None:
    robot = back_at_the_start()
    robot.set_out(20)
    robot.drive(0.75)
    before = robot.update()
    robot.wait(STUCK_S - 2.0)
    after = robot.update()
    assert after.remaining_s == before.remaining_s
    assert after.status == 'following'


@pytest.mark.parametrize('beside_m', [0.1, 0.2])
def test_a_goal_is_reached_where_the_robot_comes_closest_to_it(beside_m: float) -> None:
    robot = back_at_the_start()
    robot.set_out(Goal(10, Pose(0.0, beside_m, 0.0)))
    robot.drive(4.6)
    away_m = []
    while robot.update().status == 'following':
        away_m.append(math.hypot(5.0 - robot.pose.x_m, beside_m))
        robot.drive(0.02)
    assert min(away_m) == pytest.approx(beside_m, abs=0.01)
    assert away_m[-1] < beside_m + LEAVING_M + 0.02  # it has not gone on much further
    assert robot.update().status == 'succeeded'


def test_a_goal_is_reached_at_its_place_and_by_who_stays_beside_it() -> None:
    for x_m, after_s in ((5.0 - 0.9 * ARRIVED_M, 0.0), (4.8, LINGER_S)):
        robot = back_at_the_start()
        robot.set_out(10)
        robot.drive(x_m)
        waited_s = 0.0
        while robot.update().status == 'following':
            robot.wait(0.5)
            waited_s += 0.5
        assert robot.update().status == 'succeeded'
        assert after_s <= waited_s <= after_s + 0.5


def test_a_pause_is_no_getting_nowhere() -> None:
    robot = back_at_the_start(20.0)
    robot.set_out(40)
    robot.drive(0.5)
    robot.update()
    robot.stamp_ns += round(2 * STUCK_S * S)  # and nobody asked in between
    assert not robot.update().explore


@pytest.mark.parametrize('turns', [False, True])
def test_a_robot_that_gets_nowhere_strays(turns: bool) -> None:
    robot = back_at_the_start(20.0)
    robot.set_out(40)
    began_ns = robot.stamp_ns
    step = 0
    while robot.update().status == 'following':
        step += 1
        if turns:  # to and fro
            robot.drive(0.5, 2.0 * (step % 2))
        else:
            robot.wait(1.0)
    assert STUCK_S <= (robot.stamp_ns - began_ns) / S <= STUCK_S + 1.0
    for _ in range(round(STRAY_M / 0.2)):
        assert robot.update().explore  # until it has come some way
        robot.drive(0.2)
    guidance = robot.update()
    assert (guidance.status, guidance.explore) == ('following', False)


def test_a_slow_robot_that_gets_on_does_not_stray() -> None:
    robot = back_at_the_start(20.0)
    robot.set_out(40)
    for _ in range(round(4.0 * STUCK_S)):
        robot.drive(1.1 * STUCK_M / STUCK_S, speed_mps=1.1 * STUCK_M / STUCK_S)
        assert robot.update().status == 'following'


def test_where_nobody_knows_how_far_it_came_time_tells() -> None:
    robot = back_at_the_start()
    before = robot.set_out(20).remaining_s
    for seconds in (3.0, 0.5, 4.5):
        robot.wait(seconds)
        before -= seconds
        guidance = robot.update(located=False)
        assert guidance.remaining_s == pytest.approx(before)
    assert guidance.positions_m[0] == pytest.approx((4.0, 0.0))
    robot.wait(100.0)
    assert robot.update(located=False).status == 'following'  # the map still has it at the start
    robot.arrive(linked=False)
    assert robot.update(located=False).status == 'lost'  # and now the old route is at its end


def test_the_place_on_the_route_never_goes_back() -> None:
    robot = back_at_the_start()
    robot.set_out(20)
    robot.drive(2.0)
    robot.arrive(4)
    there = robot.update().remaining_s
    robot.drive(1.0, 2.0)
    robot.arrive(2)
    guidance = robot.update()
    assert (guidance.remaining_s, guidance.replanned) == (there, 1)
    robot.drive(1.0, 2.0)  # 2 m behind: that is no place on this route any more
    robot.arrive(0)
    guidance = robot.update()
    assert guidance.remaining_s == pytest.approx(20.0)


def test_unrecognised_views_in_a_known_corridor_do_not_turn_the_robot_round() -> None:
    robot = back_at_the_start()
    robot.set_out(20)
    left_s = math.inf
    for _ in range(40):
        robot.drive(0.25)
        robot.arrive()  # the shortest way from here leads back to the start
        guidance = robot.update()
        if guidance.status == 'succeeded':
            break
        assert guidance.status == 'recovering'
        assert guidance.waypoint is not None
        assert guidance.waypoint.x_m > robot.pose.x_m
        assert guidance.remaining_s < left_s
        left_s = guidance.remaining_s
    assert guidance.status == 'succeeded'
    assert guidance.replanned == 1


def test_the_old_route_is_kept_for_a_time_only() -> None:
    robot = back_at_the_start(20.0)
    robot.recall.parameters = replace(PARAMETERS, route_keep_s=10.0)
    robot.set_out(40)
    turned_s = 0.0
    while turned_s == 0.0:
        robot.drive(0.25)
        robot.arrive()
        guidance = robot.update()
        if guidance.status == 'following':
            turned_s = robot.stamp_ns / S
        assert robot.pose.x_m < 10.0
    assert guidance.waypoint is not None
    assert abs(guidance.waypoint.heading_rad) == pytest.approx(math.pi)
    assert robot.pose.x_m == pytest.approx(5.0)  # 10 s after the start


def with_a_short_cut() -> tuple[Robot, list[int], list[int]]:
    """Return a robot at (0, 0), and two ways to (4, 0) that it learned: 12 m long, and 4 m."""
    robot = Robot()
    long = [0, *robot.explore(4.0, 1.0), *robot.explore(4.0, 0.0), *robot.explore(4.0, 3.0)]
    short = robot.explore(3.5, 2.0)
    robot.drive(0.5, 2.0)
    robot.arrive(0, linked=False)
    robot.pose = Pose(0.0, 0.0, 0.0)
    robot.map.offset = robot.pose
    return robot, long, short[::-1]


def test_a_shorter_route_is_taken_at_once() -> None:
    robot, long, short = with_a_short_cut()
    guidance = robot.set_out(long[-1])
    assert guidance.remaining_s == pytest.approx(24.0)
    robot.drive(0.5)
    robot.arrive(short[0])
    guidance = robot.update()
    assert (guidance.status, guidance.switched) == ('following', 1)
    assert guidance.remaining_s == pytest.approx(7.0)


def test_a_longer_route_is_taken_after_a_time() -> None:
    robot, long, short = with_a_short_cut()
    for heading, known in ((1.0, long[1]), (1.0, long[2])):
        robot.drive(0.5, heading)
        robot.arrive(known)
    robot.explore(0.5, 0.0)
    [beside] = robot.explore(0.5, 3.0)  # at (0.5, 0.5)
    robot.pose = robot.map.pose_of(short[0])
    robot.arrive(short[0], linked=False)
    assert robot.set_out(long[-1]).remaining_s == pytest.approx(7.0)
    robot.drive(0.5, 1.0)
    robot.arrive(beside, linked=False)
    statuses = []
    for _ in range(8):
        guidance = robot.update()
        statuses.append(guidance.status)
        robot.wait(1.0)
    assert statuses == ['recovering'] * 5 + ['following'] * 3
    assert guidance.switched == 1
    assert guidance.remaining_s == pytest.approx(24.0)


def test_where_no_route_is_found_the_last_one_is_kept_and_then_lost() -> None:
    robot = back_at_the_start(20.0)
    robot.recall.parameters = replace(PARAMETERS, route_keep_s=20.0)
    robot.set_out(40)
    robot.drive(0.5)
    robot.arrive(linked=False)
    guidance = robot.update()
    assert (guidance.status, guidance.explore) == ('recovering', False)
    assert guidance.positions_m[0] == pytest.approx((0.5, 0.0))
    for _ in range(2):
        robot.drive(2.0)
        guidance = robot.update()
    assert guidance.remaining_s == pytest.approx(31.0)
    robot.wait(10.9)
    assert robot.update().status == 'recovering'
    robot.wait(0.1)
    guidance = robot.update()
    assert (guidance.status, guidance.explore) == ('lost', True)
    assert len(guidance.positions_m) == 0
    assert guidance.remaining_s == math.inf
    robot.arrive(9)
    guidance = robot.update()
    assert (guidance.status, guidance.explore) == ('following', False)


def test_a_robot_that_is_beside_its_route_leaves_it_at_once() -> None:
    robot, long, short = with_a_short_cut()
    robot.drive(0.5)
    robot.arrive(short[0])
    robot.set_out(long[-1])
    robot.drive(1.4, 1.0)
    robot.arrive(linked=False)
    assert robot.update().status == 'recovering'
    robot.drive(0.2, 1.0)
    assert robot.update().status == 'lost'


def test_the_way_that_a_long_link_stands_for_may_bow() -> None:
    """Where experiences were pruned one link leads past them, straight through the wall."""
    robot = Robot()
    robot.drive(8.0)
    robot.arrive()
    robot.drive(8.0, 2.0)
    robot.arrive(0)
    robot.set_out(1)
    robot.drive(3.9, 1.0)
    robot.arrive(linked=False)
    assert robot.update().status == 'recovering'
    robot.drive(0.2, 1.0)
    assert robot.update().status == 'lost'


def unlearn(robot: Robot, x_m: float, heading: float) -> None:
    """Fail at a place until links are unlearned."""
    graph = robot.map
    there = Pose(x_m, 0.0, 0.0)
    nearest = int(np.argmin(np.abs(graph.poses[:, 0] - x_m) + np.abs(graph.poses[:, 1])))
    was = graph.current_id, graph.offset
    at = graph.pose_of(nearest)
    graph.current_id = nearest
    graph.offset = Pose(there.x_m - at.x_m, there.y_m - at.y_m, 0.0)
    before = graph.link_count
    for _ in range(50):
        if graph.report_blocked('centreline', heading):
            break
    assert graph.link_count < before
    graph.current_id, graph.offset = was


def test_a_route_over_an_unlearned_link_is_dropped_if_that_is_ahead() -> None:
    for x_m, heading, expected in ((6.0, 0.0, 'lost'), (1.0, math.pi, 'recovering')):
        robot = back_at_the_start()
        robot.set_out(20)
        robot.drive(3.0)
        robot.arrive(linked=False)  # no other route is found from here
        assert robot.update().status == 'recovering'
        unlearn(robot, x_m, heading)
        assert robot.update().status == expected


def test_another_way_is_taken_at_once_where_a_link_is_unlearned() -> None:
    robot, long, short = with_a_short_cut()
    robot.drive(0.5)
    robot.arrive(short[0])
    robot.drive(0.5, 2.0)
    robot.arrive(0)
    assert robot.set_out(long[-1]).remaining_s == pytest.approx(8.0)
    unlearn(robot, 2.0, 0.0)
    guidance = robot.update()
    assert (guidance.status, guidance.replanned) == ('following', 2)
    assert guidance.remaining_s == pytest.approx(24.0)


def test_a_forgotten_experience_takes_neither_route_nor_goal_away() -> None:
    robot = back_at_the_start()
    robot.set_out(20)
    following = robot.following
    assert following is not None
    robot.map.on_pruned.append(following.forgotten)
    x_m = []
    for forgotten in (20, 12, 13):  # the robot finds a place that it has no number left for
        robot.map.apply(MapAction('create', 0, forgotten, 99, 0.0, NOWHERE))
        robot.map.apply(MapAction('set', -1, 0, 0, 0.0, NOWHERE))
        robot.pose = Pose(0.0, 0.0, 0.0)
        guidance = robot.update()
        assert guidance.status == 'following'
        assert guidance.goal is not None
        x_m.append(guidance.goal.x_m)
    assert x_m == pytest.approx([10.0] * 3)
    assert guidance.positions_m[-1] == pytest.approx((10.0, 0.0), abs=1e-6)


def test_the_point_ahead_lies_on_the_way() -> None:
    way = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    assert point_ahead(way, 0.5, 0.0) == pytest.approx((0.5, 0.0, 0.0))
    assert point_ahead(way, 1.0, 0.0) == pytest.approx((1.0, 0.0, 0.0))
    assert point_ahead(way, 2.0, 0.0) == pytest.approx((1.0, 1.0, math.pi / 2))
    assert point_ahead(way, 9.0, 0.0) == pytest.approx((1.0, 2.0, math.pi / 2))
    assert point_ahead(way[:1], 1.0, 0.7) == pytest.approx((0.0, 0.0, 0.7))


@pytest.mark.parametrize('seed', range(8))
def test_on_any_map_the_way_gets_shorter_until_the_goal_is_reached(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = Robot()
    for _ in range(40):  # streets of a town, 2 m apart
        towards = int(rng.integers(4))
        for _ in range(4):
            robot.drive(0.5, towards)
            known, away_m = robot.nearest()
            robot.arrive(known if away_m < 0.1 else None)
    for goal in rng.integers(0, len(robot.map), 5).tolist():
        guidance = robot.set_out(goal)
        left_s, replanned = math.inf, 0
        while guidance.status != 'succeeded':
            assert guidance.status in ('following', 'recovering')
            if guidance.replanned != replanned:
                left_s, replanned = math.inf, guidance.replanned
            assert guidance.remaining_s <= left_s + 1e-9
            assert (np.diff(guidance.arrival_s) >= 0.0).all()
            x_m, y_m = guidance.positions_m[0].tolist()
            assert math.hypot(x_m - robot.pose.x_m, y_m - robot.pose.y_m) <= 1.5
            left_s = guidance.remaining_s
            x_m, y_m, _ = point_ahead(guidance.positions_m, 0.25, 0.0)
            bearing = math.atan2(y_m - robot.pose.y_m, x_m - robot.pose.x_m)
            robot.drive(0.1, bearing / (math.pi / 2))
            known, away_m = robot.nearest()
            if rng.uniform() < 0.1 or away_m > 0.4:
                robot.arrive()
            elif rng.uniform() < 0.2:  # recognised, a little beside where it was learned
                robot.map.current_id = known
                robot.map.offset = composed(inverse(robot.map.pose_of(known)), robot.pose)
            guidance = robot.update()
            assert robot.stamp_ns < 10_000 * S
