# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The queue of goals and their outcomes."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Position
from ratslam_ros.core.navigation.navigator import MAX_OUTCOME_COUNT, Navigator
from ratslam_ros.core.navigation.route_following import STUCK_S
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnreachableGoal

NOWHERE = Place(0.0, 0.0, 0.0)
S = 1_000_000_000


class Robot:
    """A robot in a corridor along x, with an experience at each metre from 0."""

    def __init__(self, parameters: GoalRecallParameters, length: int = 10) -> None:
        self.map = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
        self.navigator = Navigator(parameters, self.map)
        self.stamp_ns = 0
        for x in range(length):
            self.arrive(x, 1.0 if x else 0.0)
        for x in reversed(range(length - 1)):
            self.arrive(x, -1.0)

    def arrive(self, x: int, way_m: float, linked: bool = True) -> None:
        """Drive to the experience at x, at 0.5 m/s."""
        self.map.integrate(Motion(2.0 * abs(way_m), way_m, 0.0))
        self.stamp_ns += round(2.0 * abs(way_m) * S)
        kind = 'create' if x == len(self.map) else 'link'
        source = self.map.current_id if linked else -1
        self.map.apply(MapAction(kind, source, x, x, 0.0, NOWHERE))

    def run(self, seconds: float, speed_mps: float = 0.5) -> list[str]:
        """Drive along the route; return the sequence of statuses without repetitions."""
        seen = []
        for _ in range(round(seconds / 0.5)):
            guidance = self.navigator.update(self.stamp_ns)
            seen.append(guidance.status)
            way_m = 0.0
            if guidance.waypoint is not None:
                ahead = guidance.waypoint.x_m > self.map.pose.x_m
                way_m = 0.5 * speed_mps * (1 if ahead else -1)
            self.map.integrate(Motion(0.5, way_m, 0.0))
            self.stamp_ns += S // 2
            x = round(self.map.pose.x_m)
            if way_m and abs(self.map.pose.x_m - x) < 1e-6 and x != self.map.current_id:
                self.arrive(x, 0.0)
        return [status for status, _ in itertools.groupby(seen)]

    def outcomes(self) -> list[tuple[str, str]]:
        return [(task.asked, task.status) for task in self.navigator.outcomes]


def robot(length: int = 10, **parameters: float) -> Robot:
    return Robot(replace(GoalRecallParameters(), **parameters), length)  # type: ignore[arg-type]


def test_one_way_goal_from_new_experience_is_explored_for() -> None:
    made = robot(route_back_factor=0.0)
    made.arrive(10, 10.0)  # new: no link leads from it
    targets = 4, Position(6.1, 0.2)
    made.navigator.go_to(*targets)
    guidance = made.navigator.update(made.stamp_ns)
    assert (guidance.status, guidance.explore) == ('lost', True)
    made.arrive(3, -7.0)
    assert made.run(10.0)[0] == 'following'
    made.navigator.cancel()
    with pytest.raises(UnreachableGoal, match='expected 0 to 10'):
        made.navigator.go_to(11)


def test_goals_are_visited_in_order() -> None:
    made = robot()
    nav = made.navigator
    made.arrive(2, 2.0)
    nav.goals.name_place(made.map, 'kitchen')
    made.arrive(0, -2.0)
    tasks = nav.go_to(4, 'kitchen', Position(6.1, 0.2))
    assert [task.asked for task in tasks] == ['experience 4', 'kitchen', '(6.1, 0.2)']
    assert [task.status for task in nav.queue] == ['queued'] * 3
    assert made.run(1.0) == ['following']
    assert [task.status for task in nav.queue] == ['active', 'queued', 'queued']
    assert made.run(40.0) == [
        'following', 'succeeded', 'following', 'succeeded', 'following', 'succeeded', 'idle'
    ]
    assert made.outcomes() == [
        ('experience 4', 'succeeded'), ('kitchen', 'succeeded'), ('(6.1, 0.2)', 'succeeded')
    ]
    first, second, _ = nav.outcomes
    assert first.expected_s == pytest.approx(8.0)
    assert None not in (first.started_ns, first.ended_ns, second.started_ns)
    assert made.map.pose.x_m == pytest.approx(6.0, abs=0.3)
    assert [task.number for task in nav.outcomes] == [0, 1, 2]


def test_new_goal_replaces_queue_or_is_appended() -> None:
    made = robot()
    nav = made.navigator
    nav.go_to(9, 8)
    made.run(2.0)
    nav.go_to(3, append=True)
    assert [task.asked[-1] for task in nav.queue] == ['9', '8', '3']
    nav.go_to(1)
    assert [task.asked[-1] for task in nav.queue] == ['1']
    assert [status for _, status in made.outcomes()] == ['cancelled'] * 3
    assert {task.reason for task in nav.outcomes} == {'another goal was asked for'}
    assert made.run(5.0)[0] in ('following', 'succeeded')


def test_unreachable_goal_is_rejected_and_changes_nothing() -> None:
    made = robot()
    nav = made.navigator
    nav.go_to(5)
    made.run(1.0)
    for targets, timeout_s in (((3, 99), None), (('nowhere',), None), ((3,), -1.0)):
        with pytest.raises(UnreachableGoal):
            nav.go_to(*targets, timeout_s=timeout_s)
    with pytest.raises(UnreachableGoal, match='expected 0 or more s'):
        nav.go_to(3, timeout_s=float('nan'))
    assert [task.asked for task in nav.queue] == ['experience 5']
    assert not nav.outcomes


def test_cancel_ends_one_goal_or_all() -> None:
    made = robot()
    nav = made.navigator
    nav.go_to(5)
    nav.go_to(6, append=True, request='b')
    nav.go_to(7, append=True)
    made.run(1.0)
    assert nav.cancel(request='b') == 1
    assert nav.cancel(request='b') == 0
    assert [task.asked[-1] for task in nav.queue] == ['5', '7']
    assert nav.cancel() == 2
    assert made.run(1.0) == ['idle']
    assert nav.cancel() == 0
    assert made.outcomes() == [
        ('experience 6', 'cancelled'), ('experience 5', 'cancelled'), ('experience 7', 'cancelled')
    ]


@pytest.mark.parametrize(('goal', 'timeout_s', 'after_s'), [
    (9, 7.0, 7.0), (9, None, 180.0), (5, None, 120.0), (9, 0.0, None)
])
def test_goal_times_out_after_its_limit(
    goal: int, timeout_s: float | None, after_s: float | None
) -> None:
    made = robot()
    made.navigator.go_to(goal, timeout_s=timeout_s)
    start_ns = made.stamp_ns
    statuses = made.run(200.0, speed_mps=0.0)
    before = ['following'] if after_s is not None and after_s < STUCK_S else ['following', 'lost']
    if after_s is None:
        assert statuses == before
        return
    assert statuses == [*before, 'timed_out', 'idle']
    [task] = made.navigator.outcomes
    assert task.ended_ns == start_ns + round(after_s * S)
    assert task.reason == f'not reached within {after_s:g} s'


@pytest.mark.parametrize(('known_s', 'unknown_s', 'end_s'), [(10, 0, 180), (10, 5, 270)])
def test_time_with_unknown_pose_does_not_count(
    known_s: float, unknown_s: float, end_s: float
) -> None:
    """A pose that is lost again and again does not prolong the limit for ever."""
    made = robot()
    made.navigator.go_to(9)
    start_ns = made.stamp_ns
    while not made.navigator.outcomes:
        made.run(known_s, speed_mps=0.0)
        made.map.lose('the robot may have been carried')
        made.run(unknown_s, speed_mps=0.0)
        made.map.confirm()
    [task] = made.navigator.outcomes
    assert task.status == 'timed_out'
    assert task.ended_ns == pytest.approx(start_ns + end_s * S, abs=S)


@pytest.mark.parametrize('is_noticed', [True, False])
def test_longest_route_decides_on_the_limit_of_a_carried_robot(is_noticed: bool) -> None:
    made = robot()
    made.navigator.go_to(5)
    for x, expected_s in ((3, 4.0), (0, 10.0), (4, 10.0)):
        if is_noticed:
            made.map.lose('the robot may have been carried')
            made.run(1.0, speed_mps=0.0)
        made.arrive(x, 0.0, linked=False)
        made.map.confirm()
        made.run(1.0, speed_mps=0.0)
        assert made.navigator.queue[0].expected_s == pytest.approx(expected_s)


def test_next_goal_follows_after_timeout() -> None:
    made = robot()
    made.navigator.go_to(9, timeout_s=3.0)
    made.navigator.go_to(2, append=True)
    assert made.run(20.0) == ['following', 'timed_out', 'following', 'succeeded', 'idle']
    assert [status for _, status in made.outcomes()] == ['timed_out', 'succeeded']


def test_goal_without_route_fails_after_exploring() -> None:
    made = robot()
    made.navigator.go_to(9, 8, timeout_s=0.0)
    made.run(1.0)
    made.arrive(10, 0.0, linked=False)  # without any link
    start_ns = made.stamp_ns
    assert made.run(700.0, speed_mps=0.0) == ['recovering', 'lost', 'failed', 'lost']
    [task] = made.navigator.outcomes
    assert task.reason == 'no route was found within 600 s of exploring'
    assert task.ended_ns is not None
    assert task.ended_ns - start_ns == pytest.approx((STUCK_S + 600.0) * S, abs=2 * S)
    assert made.navigator.guidance.explore is True


def test_queued_goals_survive_removal_of_their_experiences() -> None:
    made = robot(12)
    nav = made.navigator
    made.map.on_pruned.append(nav.remove_pruned)
    nav.go_to(10, 5)
    made.run(1.0)
    for pruned in (10, 5):
        made.map.apply(MapAction('create', made.map.current_id, pruned, 99, 0.0, NOWHERE))
        made.arrive(0, 0.0, linked=False)
    goals = [task.goal.pose_on(made.map).x_m for task in nav.queue]
    assert goals == pytest.approx([10.0, 5.0], abs=1e-6)
    assert made.run(1.0, speed_mps=0.0) == ['following']
    assert nav.guidance.goal is not None
    assert nav.guidance.goal.x_m == pytest.approx(10.0, abs=1e-6)


def test_outcomes_are_limited() -> None:
    made = robot()
    for _ in range(MAX_OUTCOME_COUNT + 5):
        made.navigator.go_to(3)
    made.navigator.cancel()
    numbers = [task.number for task in made.navigator.outcomes]
    assert numbers == list(range(5, MAX_OUTCOME_COUNT + 5))


def test_empty_map_rejects_goals() -> None:
    nav = Navigator(GoalRecallParameters(), ExperienceMap(ExperienceMapParameters()))
    with pytest.raises(UnreachableGoal, match='the map is empty'):
        nav.go_to(Position(0.0, 0.0))
    assert nav.update(0).status == 'idle'


def test_reused_id_may_get_shortcuts_again() -> None:
    nav = robot().navigator
    nav.planner.rejected_shortcuts.update([3, 4])
    for _ in range(2):
        nav.remove_pruned(3, 2, Pose(0.0, 0.0, 0.0))
    assert nav.planner.rejected_shortcuts == {4}
