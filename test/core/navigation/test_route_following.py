# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Choice of routes, progress along them, recovery and arrival."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation import route_following
from ratslam_ros.core.navigation.goals import Goal
from ratslam_ros.core.navigation.route_following import (
    AT_GOAL_M,
    MAX_DWELL_S,
    RECEDING_M,
    RECOVERY_M,
    STUCK_M,
    STUCK_S,
    Guidance,
    RouteFollowing,
    point_ahead,
)
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.core.pose_cells.map_action import Action, MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnreachableGoal

NOWHERE = Place(0.0, 0.0, 0.0)
PARAMETERS = GoalRecallParameters(route_switch_s=5.0)
S = 1_000_000_000


class Robot:
    """A robot with exact odometry and an exact map."""

    def __init__(self) -> None:
        self.map = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
        self.planner = RoutePlanner(PARAMETERS, self.map)
        self.pose = Pose(0.0, 0.0, 0.0)
        self.stamp_ns = 0
        self.following: RouteFollowing | None = None
        self.arrive()

    def start(self, goal: Goal | int) -> Guidance:
        goal = goal if isinstance(goal, Goal) else Goal(goal)
        self.following = RouteFollowing(self.planner, goal)
        return self.update()

    def update(self) -> Guidance:
        assert self.following is not None
        return self.following.update(self.stamp_ns)

    def wait(self, seconds: float) -> None:
        self._integrate(Motion(seconds, 0.0, 0.0))

    def drive(self, way_m: float, heading: float = 0.0, speed_mps: float = 0.5) -> None:
        """Turn on the spot, without delay, and drive straight; headings are in quarter turns."""
        turn = math.remainder(heading * math.pi / 2 - self.pose.heading_rad, math.tau)
        self._integrate(Motion(0.0, 0.0, turn))
        self._integrate(Motion(abs(way_m) / speed_mps, way_m, 0.0))

    def _integrate(self, motion: Motion) -> None:
        self.pose = moved(self.pose, motion)
        self.map.integrate(motion)
        if not self.map.covariance.reason:
            self.map.covariance.replace(np.zeros((3, 3)))
        self.stamp_ns += round(motion.dt_s * S)

    def arrive(self, target: int | None = None, linked: bool = True) -> int:
        """Arrive at an experience, None for a new one; the view gives the relative heading."""
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
        """Return the nearest experience and its distance in m."""
        away_m = np.hypot(*(self.map.poses[:, :2] - self.pose[:2]).T)
        return int(np.argmin(away_m)), float(away_m.min())

    def explore(self, way_m: float, heading: float = 0.0, every_m: float = 0.5) -> list[int]:
        """Drive straight and create experiences on the way."""
        ids = []
        for _ in range(round(way_m / every_m)):
            self.drive(every_m, heading)
            ids.append(self.arrive())
        return ids


def back_at_the_start(length_m: float = 10.0) -> Robot:
    """Return a robot at (0, 0) with a map of a corridor along x, every 0.5 m."""
    robot = Robot()
    for known in reversed([0, *robot.explore(length_m)[:-1]]):
        robot.drive(0.5, 2.0)
        robot.arrive(known)
    return robot


def test_route_is_followed_to_its_end() -> None:
    robot = back_at_the_start()
    guidance = robot.start(20)
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
    assert robot.update().status == 'following'  # within the radius, but still approaching
    robot.drive(0.25)
    guidance = robot.update()
    assert (guidance.status, robot.pose.x_m) == ('succeeded', pytest.approx(10.0))
    assert (guidance.replanned, guidance.switched) == (1, 0)


def test_route_ends_at_goal_beside_experience() -> None:
    robot = back_at_the_start()
    guidance = robot.start(Goal(10, Pose(0.0, 0.25, 0.0)))
    assert guidance.positions_m[-2:] == pytest.approx(np.array([[5.0, 0.0], [5.0, 0.25]]))
    assert guidance.goal == pytest.approx((5.0, 0.25, 0.0))


def test_goal_beside_route_is_reached_at_end() -> None:
    for beside_m, expected in ((0.35, 'succeeded'), (0.37, 'lost')):
        robot = Robot()
        robot.explore(2.0)
        robot.map.current_id, robot.map.offset = 0, Pose(0.0, beside_m, 0.0)
        assert robot.start(3).status == 'following'
        robot.drive(1.25)
        assert robot.update().status == 'following'
        robot.drive(0.25)
        robot.arrive(linked=False)
        assert robot.update().status == expected


@pytest.mark.parametrize('beside_m', [0.1, 0.2])
def test_goal_is_reached_at_closest_approach(beside_m: float) -> None:
    robot = back_at_the_start()
    robot.start(Goal(10, Pose(0.0, beside_m, 0.0)))
    robot.drive(4.6)
    away_m = []
    while robot.update().status == 'following':
        away_m.append(math.hypot(5.0 - robot.pose.x_m, beside_m))
        robot.drive(0.02)
    assert min(away_m) == pytest.approx(beside_m, abs=0.01)
    assert away_m[-1] < beside_m + RECEDING_M + 0.02
    assert robot.update().status == 'succeeded'


def test_goal_is_reached_exactly_or_after_dwelling() -> None:
    for x_m, after_s in ((5.0 - 0.9 * AT_GOAL_M, 0.0), (4.8, MAX_DWELL_S)):
        robot = back_at_the_start()
        robot.start(10)
        robot.drive(x_m)
        waited_s = 0.0
        while robot.update().status == 'following':
            robot.wait(0.5)
            waited_s += 0.5
        assert robot.update().status == 'succeeded'
        assert after_s <= waited_s <= after_s + 0.5


def test_pause_between_updates_is_not_stuck() -> None:
    robot = back_at_the_start(20.0)
    robot.start(40)
    robot.drive(0.5)
    robot.update()
    robot.stamp_ns += round(2 * STUCK_S * S)  # without updates
    assert not robot.update().explore


@pytest.mark.parametrize('turns', [False, True])
def test_stuck_robot_explores_and_resumes(turns: bool) -> None:
    robot = back_at_the_start(20.0)
    robot.start(40)
    began_ns = robot.stamp_ns
    step = 0
    while robot.update().status == 'following':
        step += 1
        if turns:  # back and forth
            robot.drive(0.5, 2.0 * (step % 2))
        else:
            robot.wait(1.0)
    assert STUCK_S <= (robot.stamp_ns - began_ns) / S <= STUCK_S + 1.0
    for _ in range(round(RECOVERY_M / 0.2)):
        assert robot.update().explore  # until it has driven RECOVERY_M
        robot.drive(0.2)
    guidance = robot.update()
    assert (guidance.status, guidance.explore) == ('following', False)


def test_slow_robot_is_not_stuck() -> None:
    robot = back_at_the_start(20.0)
    robot.start(40)
    for _ in range(round(4.0 * STUCK_S)):
        robot.drive(1.1 * STUCK_M / STUCK_S, speed_mps=1.1 * STUCK_M / STUCK_S)
        assert robot.update().status == 'following'


def test_goal_waits_while_the_pose_is_unknown() -> None:
    robot = back_at_the_start()
    assert robot.start(20).status == 'following'
    robot.map.lose('laser scans contradict it')
    robot.drive(2.0)
    paused = robot.update()
    assert (paused.status, paused.explore, len(paused.positions_m)) == ('lost', True, 0)
    assert 'laser scans contradict it' in paused.reason
    robot.arrive(4)
    resumed = robot.update()
    assert (resumed.status, resumed.reason) == ('following', '')
    assert resumed.positions_m[0] == pytest.approx((2.0, 0.0))


def test_position_on_route_never_moves_backwards() -> None:
    robot = back_at_the_start()
    robot.start(20)
    robot.drive(2.0)
    robot.arrive(4)
    remaining_s = robot.update().remaining_s
    robot.drive(1.0, 2.0)
    robot.arrive(2)
    guidance = robot.update()
    assert (guidance.remaining_s, guidance.replanned) == (remaining_s, 1)
    robot.drive(1.0, 2.0)  # 2 m behind the position, so the route is dropped
    robot.arrive(0)
    guidance = robot.update()
    assert guidance.remaining_s == pytest.approx(20.0)


def test_unrecognised_views_do_not_reverse_the_robot() -> None:
    robot = back_at_the_start()
    robot.start(20)
    previous_s = math.inf
    for _ in range(40):
        robot.drive(0.25)
        robot.arrive()  # its only route leads back to the start
        guidance = robot.update()
        if guidance.status == 'succeeded':
            break
        assert guidance.status == 'recovering'
        assert guidance.waypoint is not None
        assert guidance.waypoint.x_m > robot.pose.x_m
        assert guidance.remaining_s < previous_s
        previous_s = guidance.remaining_s
    assert guidance.status == 'succeeded'
    assert guidance.replanned == 1


def on_directed_route(links_s: Sequence[float], route_position: str) -> Robot:
    """Return a robot at (0, 0) that starts along a route of links of 1 m, driven in one direction.

    Args:
        links_s: durations of the links.
        route_position: see ``GoalRecallParameters``.
    """
    robot = Robot()
    robot.planner = RoutePlanner(
        GoalRecallParameters(
            route_back_factor=0.0, route_switch_s=0.0, route_position=route_position
        ),
        robot.map,
    )
    for seconds in links_s:
        robot.drive(1.0, speed_mps=1.0 / seconds)
        robot.arrive()
    robot.drive(1.0, 1.0)
    robot.drive(len(links_s), 2.0)
    robot.drive(1.0, 3.0)
    robot.arrive(0)
    assert robot.start(len(links_s)).status == 'following'
    return robot


def test_new_experience_has_no_route_over_directed_links() -> None:
    """Milford et al. (2006), section IV.D: the last route is followed until a place is known."""
    robot = on_directed_route([2.0] * 8, 'map')
    for _ in range(3):
        robot.drive(1.0)
        robot.arrive()  # an unknown view on the known path
        with pytest.raises(UnreachableGoal):
            robot.planner.route_to(8)
        guidance = robot.update()
        assert guidance.status == 'recovering'
        assert guidance.waypoint is not None
        assert abs(guidance.waypoint.heading_rad) < 0.1
    robot.drive(1.0)
    robot.arrive(4)
    assert robot.update().status == 'following'


# Route loss recovery of Milford et al. (2006), section IV.D


def lost_after_three_metres(route_position: str) -> Robot:
    """Return a robot that has followed its route for 3 m and arrives at a new experience.

    The links of the route to experience 8 take 1, 2, 3, 4, 4, 3, 2 and 1 s and are 1 m long. By
    equation (10), its nodes have the time stamps 0, 1, 3, 6, 10, 14, 17, 19 and 20 s.
    """
    robot = on_directed_route([1.0, 2.0, 3.0, 4.0, 4.0, 3.0, 2.0, 1.0], route_position)
    assert robot.update().arrival_s == pytest.approx([0, 1, 3, 6, 10, 14, 17, 19, 20])
    robot.drive(3.0, speed_mps=0.5)
    assert robot.update().remaining_s == pytest.approx(20.0 - 6.0)
    robot.arrive()
    return robot


@pytest.mark.parametrize(('waited_s', 'x_m', 'remaining_s'), [
    (0.0, 3.0, 14.0), (4.0, 4.0, 10.0), (13.5, 7.5, 0.5),
])
def test_position_on_lost_route_advances_by_elapsed_time(
    waited_s: float, x_m: float, remaining_s: float
) -> None:
    for position in ('map', 'elapsed_time'):
        robot = lost_after_three_metres(position)
        for _ in range(10):
            robot.wait(waited_s / 10)
            guidance = robot.update()
        at_m, left_s = (x_m, remaining_s) if position == 'elapsed_time' else (3.0, 14.0)
        assert guidance.status == 'recovering'
        assert guidance.positions_m[0] == pytest.approx((at_m, 0.0))
        assert guidance.remaining_s == pytest.approx(left_s)
        assert guidance.arrival_s[-1] == pytest.approx(left_s)


def test_lost_route_by_elapsed_time_ends_at_goal_time() -> None:
    robot = lost_after_three_metres('elapsed_time')
    robot.wait(13.9)
    assert robot.update().status == 'recovering'
    robot.wait(0.2)
    assert robot.update().status == 'lost'


def test_plan_replaces_route_followed_by_elapsed_time() -> None:
    robot = lost_after_three_metres('elapsed_time')
    robot.wait(10.0)  # the position on the route is 2.6 m ahead of the robot
    assert robot.update().remaining_s == pytest.approx(4.0)
    robot.drive(0.5, speed_mps=0.5)
    robot.drive(0.5, speed_mps=0.5)
    robot.arrive(4)
    guidance = robot.update()
    assert (guidance.status, guidance.switched) == ('following', 0)
    assert guidance.positions_m[0] == pytest.approx((4.0, 0.0))
    assert guidance.remaining_s == pytest.approx(10.0)


def test_unconfirmed_route_is_kept_for_limited_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(route_following, 'ROUTE_KEEP_S', 10.0)
    robot = back_at_the_start(20.0)
    robot.start(40)
    reversed_s = 0.0
    while reversed_s == 0.0:
        robot.drive(0.25)
        robot.arrive()
        guidance = robot.update()
        if guidance.status == 'following':
            reversed_s = robot.stamp_ns / S
        assert robot.pose.x_m < 10.0
    assert guidance.waypoint is not None
    assert abs(guidance.waypoint.heading_rad) == pytest.approx(math.pi)
    assert robot.pose.x_m == pytest.approx(5.0)  # 10 s after the start


def with_two_routes() -> tuple[Robot, list[int], list[int]]:
    """Return a robot at (0, 0) and two learned routes to (4, 0): 12 m and 4 m long."""
    robot = Robot()
    long = [0, *robot.explore(4.0, 1.0), *robot.explore(4.0, 0.0), *robot.explore(4.0, 3.0)]
    short = robot.explore(3.5, 2.0)
    robot.drive(0.5, 2.0)
    robot.arrive(0, linked=False)
    robot.pose = Pose(0.0, 0.0, 0.0)
    robot.map.offset = robot.pose
    return robot, long, short[::-1]


def test_faster_route_is_adopted_at_once() -> None:
    robot, long, short = with_two_routes()
    guidance = robot.start(long[-1])
    assert guidance.remaining_s == pytest.approx(24.0)
    robot.drive(0.5)
    robot.arrive(short[0])
    guidance = robot.update()
    assert (guidance.status, guidance.switched) == ('following', 1)
    assert guidance.remaining_s == pytest.approx(7.0)


def test_slower_route_is_adopted_after_delay() -> None:
    robot, long, short = with_two_routes()
    for heading, known in ((1.0, long[1]), (1.0, long[2])):
        robot.drive(0.5, heading)
        robot.arrive(known)
    robot.explore(0.5, 0.0)
    [beside] = robot.explore(0.5, 3.0)  # at (0.5, 0.5)
    robot.pose = robot.map.pose_of(short[0])
    robot.arrive(short[0], linked=False)
    assert robot.start(long[-1]).remaining_s == pytest.approx(7.0)
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


def test_route_is_kept_then_lost_without_new_one() -> None:
    robot = back_at_the_start(20.0)
    robot.start(40)
    robot.drive(0.5)
    robot.arrive(linked=False)
    guidance = robot.update()
    assert (guidance.status, guidance.explore) == ('recovering', False)
    assert guidance.positions_m[0] == pytest.approx((0.5, 0.0))
    for _ in range(2):
        robot.drive(2.0)
        guidance = robot.update()
    assert guidance.remaining_s == pytest.approx(31.0)
    robot.wait(50.9)
    assert robot.update().status == 'recovering'
    robot.wait(0.1)
    guidance = robot.update()
    assert (guidance.status, guidance.explore) == ('lost', True)
    assert len(guidance.positions_m) == 0
    assert guidance.remaining_s == math.inf
    robot.arrive(9)
    guidance = robot.update()
    assert (guidance.status, guidance.explore) == ('following', False)


def test_route_is_dropped_beyond_its_width() -> None:
    robot, long, short = with_two_routes()
    robot.drive(0.5)
    robot.arrive(short[0])
    robot.start(long[-1])
    robot.drive(1.4, 1.0)
    robot.arrive(linked=False)
    assert robot.update().status == 'recovering'
    robot.drive(0.2, 1.0)
    assert robot.update().status == 'lost'


def test_long_link_tolerates_larger_deviation() -> None:
    """After pruning, a link can lead straight through a wall."""
    robot = Robot()
    robot.drive(8.0)
    robot.arrive()
    robot.drive(8.0, 2.0)
    robot.arrive(0)
    robot.start(1)
    robot.drive(3.9, 1.0)
    robot.arrive(linked=False)
    assert robot.update().status == 'recovering'
    robot.drive(0.2, 1.0)
    assert robot.update().status == 'lost'


def unlearn(robot: Robot, x_m: float, heading: float) -> None:
    """Fail at a place until links are unlearned."""
    graph = robot.map
    nearest = int(np.argmin(np.abs(graph.poses[:, 0] - x_m) + np.abs(graph.poses[:, 1])))
    saved = graph.current_id, graph.offset
    at = graph.pose_of(nearest)
    graph.current_id = nearest
    graph.offset = Pose(x_m - at.x_m, -at.y_m, 0.0)
    before = graph.link_count
    for _ in range(50):
        if graph.unlearn_blocked('centreline', heading):
            break
    assert graph.link_count < before
    graph.current_id, graph.offset = saved


def test_route_is_dropped_if_link_ahead_is_unlearned() -> None:
    for x_m, heading, expected in ((6.0, 0.0, 'lost'), (1.0, math.pi, 'recovering')):
        robot = back_at_the_start()
        robot.start(20)
        robot.drive(3.0)
        robot.arrive(linked=False)  # no route leads from here
        assert robot.update().status == 'recovering'
        unlearn(robot, x_m, heading)
        assert robot.update().status == expected


def test_blocked_way_is_tried_again_for_the_next_goal_if_there_is_no_other() -> None:
    robot = back_at_the_start()
    unlearn(robot, 6.0, 0.0)
    guidance = robot.start(20)
    assert (guidance.status, guidance.remaining_s) == ('following', pytest.approx(20.0))
    assert robot.following is not None
    robot.drive(5.0)
    robot.update()
    robot.following.report_blocked()
    assert robot.update().status == 'lost'
    assert robot.start(20).status == 'following'


@pytest.mark.parametrize('is_pruned', [False, True])
def test_unlearned_links_are_not_tried_after_a_failure_before_them(is_pruned: bool) -> None:
    robot = back_at_the_start()
    unlearn(robot, 6.0, 0.0)
    assert robot.start(20).status == 'following'
    assert robot.following is not None
    assert robot.following.report_blocked()  # no unlearned link is near: the map counts it
    if is_pruned:
        robot.following.remove_pruned(20, 19, Pose(0.5, 0.0, 0.0))
    robot.update()
    robot.wait(route_following.ROUTE_KEEP_S)
    assert robot.update().status == 'lost'


def test_unlearned_link_causes_immediate_switch() -> None:
    robot, long, short = with_two_routes()
    robot.drive(0.5)
    robot.arrive(short[0])
    robot.drive(0.5, 2.0)
    robot.arrive(0)
    assert robot.start(long[-1]).remaining_s == pytest.approx(8.0)
    unlearn(robot, 2.0, 0.0)
    guidance = robot.update()
    assert (guidance.status, guidance.replanned) == ('following', 2)
    assert guidance.remaining_s == pytest.approx(24.0)


def test_removed_experience_keeps_route_and_goal() -> None:
    robot = back_at_the_start()
    robot.start(20)
    following = robot.following
    assert following is not None
    robot.map.on_pruned.append(following.remove_pruned)
    x_m = []
    for pruned in (20, 12, 13):  # new experiences reuse the ids
        robot.map.apply(MapAction('create', 0, pruned, 99, 0.0, NOWHERE))
        robot.map.apply(MapAction('set', -1, 0, 0, 0.0, NOWHERE))
        robot.pose = Pose(0.0, 0.0, 0.0)
        guidance = robot.update()
        assert guidance.status == 'following'
        assert guidance.goal is not None
        x_m.append(guidance.goal.x_m)
    assert x_m == pytest.approx([10.0] * 3)
    assert guidance.positions_m[-1] == pytest.approx((10.0, 0.0), abs=1e-6)


def test_point_ahead_lies_on_polyline() -> None:
    line = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    assert point_ahead(line, 0.5, 0.0) == pytest.approx((0.5, 0.0, 0.0))
    assert point_ahead(line, 1.0, 0.0) == pytest.approx((1.0, 0.0, 0.0))
    assert point_ahead(line, 2.0, 0.0) == pytest.approx((1.0, 1.0, math.pi / 2))
    assert point_ahead(line, 9.0, 0.0) == pytest.approx((1.0, 2.0, math.pi / 2))
    assert point_ahead(line[:1], 1.0, 0.7) == pytest.approx((0.0, 0.0, 0.7))


@pytest.mark.parametrize('seed', range(3))
def test_remaining_time_decreases_until_goal_on_random_maps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = Robot()
    for _ in range(40):  # a grid of streets, 2 m apart
        towards = int(rng.integers(4))
        for _ in range(4):
            robot.drive(0.5, towards)
            known, away_m = robot.nearest()
            robot.arrive(known if away_m < 0.1 else None)
    for goal in rng.integers(0, len(robot.map), 5).tolist():
        guidance = robot.start(goal)
        previous_s, replanned = math.inf, 0
        while guidance.status != 'succeeded':
            assert guidance.status in ('following', 'recovering')
            if guidance.replanned != replanned:
                previous_s, replanned = math.inf, guidance.replanned
            assert guidance.remaining_s <= previous_s + 1e-9
            assert (np.diff(guidance.arrival_s) >= 0.0).all()
            x_m, y_m = guidance.positions_m[0].tolist()
            assert math.hypot(x_m - robot.pose.x_m, y_m - robot.pose.y_m) <= 1.5
            previous_s = guidance.remaining_s
            x_m, y_m, _ = point_ahead(guidance.positions_m, 0.25, 0.0)
            bearing = math.atan2(y_m - robot.pose.y_m, x_m - robot.pose.x_m)
            robot.drive(0.1, bearing / (math.pi / 2))
            known, away_m = robot.nearest()
            if rng.uniform() < 0.1 or away_m > 0.4:
                robot.arrive()
            elif rng.uniform() < 0.2:  # recognised at a small offset
                robot.map.current_id = known
                robot.map.offset = composed(inverse(robot.map.pose_of(known)), robot.pose)
            guidance = robot.update()
            assert robot.stamp_ns < 10_000 * S
