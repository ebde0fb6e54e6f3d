# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Named places and targets."""

from __future__ import annotations

import json
import math

import pytest
from route_maps import NOWHERE, go, line, planner_of

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Goal, Goals, Position
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.errors import UnreachableGoal

PARAMETERS = GoalRecallParameters(goal_tolerance_m=0.6)


def test_named_place_has_pose_of_robot() -> None:
    graph, goals = line(5), Goals()
    graph.integrate(Motion(1.0, 0.3, math.pi / 2))
    pose = graph.pose
    kitchen = goals.name_place(graph, 'kitchen')
    go(graph, 0, linked=False)
    assert kitchen.pose_on(graph) == pytest.approx(pose)
    assert kitchen == Goal(4, kitchen.offset, 'kitchen')
    assert goals.find('kitchen', planner_of(graph, PARAMETERS)) == kitchen
    assert (str(kitchen), str(Goal(3)), str(Position(1.0, 2.5))) == (
        'kitchen', 'experience 3', '(1, 2.5)'
    )


def test_named_place_moves_with_map() -> None:
    graph, goals = line(5), Goals()
    graph.integrate(Motion(1.0, 0.25, 0.0))
    goals.name_place(graph, 'kitchen')
    before = goals.named('kitchen').pose_on(graph)
    go(graph, 0, way_m=-2.0)  # inconsistent odometry deforms the map
    after = goals.named('kitchen').pose_on(graph)
    assert math.hypot(after.x_m - before.x_m, after.y_m - before.y_m) > 0.2
    at = graph.pose_of(4)
    assert math.hypot(after.x_m - at.x_m, after.y_m - at.y_m) == pytest.approx(0.25)


def test_places_are_named_renamed_and_removed() -> None:
    graph, goals = line(5), Goals()
    assert [goals.name_place(graph).name for _ in range(2)] == ['place_1', 'place_2']
    goals.remove('place_1')
    assert goals.name_place(graph).name == 'place_1'
    goals.rename('place_2', 'Küche')
    assert [goal.name for goal in goals] == ['Küche', 'place_1']
    go(graph, 1)
    assert goals.name_place(graph, 'Küche').experience_id == 1
    assert [goal.name for goal in goals] == ['Küche', 'place_1']
    goals.rename('place_1', 'Küche')
    assert [(goal.name, goal.experience_id) for goal in goals] == [('Küche', 4)]
    goals.rename('Küche', 'Küche')
    assert len(goals) == 1


@pytest.mark.parametrize('name', [' ', 'a\nb', ' a', 'x' * 101])
def test_invalid_name_is_rejected(name: str) -> None:
    graph, goals = line(5), Goals()
    goals.name_place(graph, 'kitchen')
    with pytest.raises(UnreachableGoal, match='cannot be a name'):
        goals.name_place(graph, name)
    with pytest.raises(UnreachableGoal, match='cannot be a name'):
        goals.rename('kitchen', name)
    assert [goal.name for goal in goals] == ['kitchen']


def test_unknown_name_is_rejected() -> None:
    graph, goals = line(5), Goals()
    for act in (goals.named, goals.remove, lambda name: goals.rename(name, 'b')):
        with pytest.raises(UnreachableGoal, match=r"no place is called 'a'; .* none yet"):
            act('a')
    goals.name_place(graph, 'kitchen')
    with pytest.raises(UnreachableGoal, match='those that have a name: kitchen'):
        goals.find('a', planner_of(graph, PARAMETERS))
    with pytest.raises(UnreachableGoal, match='the map is empty'):
        goals.name_place(ExperienceMap(ExperienceMapParameters()), 'a')


def test_position_selects_nearest_reachable_experience() -> None:
    graph, goals = line(5), Goals()
    planner = planner_of(graph, PARAMETERS)
    graph.integrate(Motion(1.0, -2.6, 0.0))
    go(graph, 5, way_m=0.0, linked=False)  # at x = 2.4
    go(graph, 4, way_m=0.0, linked=False)
    assert goals.find(Position(2.4, 0.0), planner) == Goal(1)
    assert goals.find(Position(2.45, 0.5), planner, tolerance_m=1.0) == Goal(1)
    with pytest.raises(UnreachableGoal, match='no link leads'):
        goals.find(Position(2.45, 0.0), planner, tolerance_m=0.2)
    with pytest.raises(UnreachableGoal, match=r'away; expected at most 0\.6 m'):
        goals.find(Position(2.4, 0.7), planner)
    with pytest.raises(UnreachableGoal, match='not finite'):
        goals.find(Position(2.4, math.nan), planner)


def test_unreachable_target_is_rejected() -> None:
    graph, goals = line(5), Goals()
    go(graph, 5, linked=False)
    goals.name_place(graph, 'island')
    go(graph, 4, way_m=0.0, linked=False)
    for target in (5, 'island'):
        with pytest.raises(UnreachableGoal, match='no link leads from experience 4 to 5'):
            goals.find(target, planner_of(graph, PARAMETERS))
    with pytest.raises(UnreachableGoal, match='there is no experience 6'):
        goals.find(6, planner_of(graph, PARAMETERS))
    with pytest.raises(UnreachableGoal, match='the map is empty'):
        Goals().find(0, planner_of(line(0), PARAMETERS))


def test_place_keeps_pose_if_experience_is_removed() -> None:
    graph, goals = line(5), Goals()
    planner = planner_of(graph, PARAMETERS)
    graph.on_pruned.append(goals.remove_pruned)
    goals.name_place(graph, 'last')
    go(graph, 2, way_m=-2.0)
    graph.integrate(Motion(1.0, 0.2, 0.0))
    goals.name_place(graph, 'middle')
    before = {goal.name: goal.pose_on(graph) for goal in goals}
    for pruned in (2, 4):
        graph.apply(MapAction('create', graph.current_id, pruned, 9, 0.0, NOWHERE))
    assert not {goal.experience_id for goal in goals} & {2, 4}
    for goal in goals:
        assert goal.pose_on(graph) == pytest.approx(before[goal.name], abs=1e-6)
        found = goals.find(goal.name, planner)
        assert found.name == goal.name
        assert found.pose_on(graph) == pytest.approx(before[goal.name], abs=1e-6)


@pytest.mark.parametrize(('x_m', 'anchor_id'), [(3.2, 2), (2.1, 1), (1.9, 4), (7.0, 4)])
def test_distant_place_is_anchored_at_nearest_experience(x_m: float, anchor_id: int) -> None:
    """As after pruning the experience of a place and its stand-ins."""
    graph, goals = line(5), Goals()
    graph.integrate(Motion(1.0, x_m - graph.pose.x_m, 0.0))
    goals.name_place(graph, 'far')
    go(graph, 4, way_m=x_m - 5.0)
    if anchor_id == 4 and x_m < 5.0:  # no experience is near
        for pruned in (0, 1, 2):
            graph.apply(MapAction('create', graph.current_id, pruned, 9, 0.0, NOWHERE))
    goal = goals.find('far', planner_of(graph, PARAMETERS))
    assert goal.name == 'far'
    assert goal.experience_id == anchor_id
    assert goal.pose_on(graph) == pytest.approx(goals.named('far').pose_on(graph), abs=1e-9)
    assert goals.named('far').experience_id == 4  # unchanged


def test_place_without_links_is_anchored_at_nearest_reachable_experience() -> None:
    """As after failed tries to reach it, and exploration beside it."""
    graph, goals = line(5), Goals()
    go(graph, 5, linked=False)
    goals.name_place(graph, 'kitchen')
    go(graph, 6, way_m=0.5, linked=False)
    go(graph, 4, way_m=-1.5)
    goal = goals.find('kitchen', planner_of(graph, PARAMETERS))
    assert (goal.name, goal.experience_id) == ('kitchen', 6)
    assert goal.pose_on(graph) == pytest.approx(goals.named('kitchen').pose_on(graph), abs=1e-9)


def test_place_behind_an_unlearned_link_keeps_its_experience() -> None:
    graph, goals = line(6), Goals()
    graph.integrate(Motion(1.0, -0.6, 0.0))  # nearer to experience 4
    kitchen = goals.name_place(graph, 'kitchen')
    go(graph, 0, linked=False)
    row = graph.link_table.row(2, 3)
    assert row is not None
    graph._unlearn([row])
    assert goals.find('kitchen', planner_of(graph, PARAMETERS)) == kitchen


def test_place_without_stand_in_is_found_by_position() -> None:
    graph, goals = line(5), Goals()
    graph.on_pruned.append(goals.remove_pruned)
    go(graph, 5, linked=False)
    graph.integrate(Motion(1.0, -1.3, 0.0))
    goals.name_place(graph, 'island')
    go(graph, 0, linked=False)
    graph.apply(MapAction('create', 0, 5, 9, 0.0, NOWHERE))
    assert goals.named('island').experience_id == -1
    assert goals.named('island').pose_on(graph) == pytest.approx((4.7, 0.0, 0.0))
    assert goals.find('island', planner_of(graph, PARAMETERS)) == Goal(4)


def test_names_survive_save_and_restore() -> None:
    graph, goals, others = line(5), Goals(), Goals()
    graph.integrate(Motion(1.0, 0.3, 0.1))
    goals.name_place(graph, 'kitchen')
    goals.name_place(graph, 'hall')
    others.name_place(graph, 'gone')
    others.restore(json.loads(json.dumps(goals.state())))
    assert list(others) == list(goals)
    assert others.named('kitchen').offset == Pose(*goals.named('kitchen').offset)
