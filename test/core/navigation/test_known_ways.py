# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What keeps a robot on ways that it knows: joins, walls, shifts of views, being unsure."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import (
    ExperienceMapParameters,
    GoalRecallParameters,
    LocalViewParameters,
)
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.navigator import MOST_TRIES, MOST_UNSURE, Navigator
from ratslam_ros.core.navigation.route_planner import TILE_M, RoutePlanner
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.errors import UnreachableGoal
from ratslam_ros.files.memory import load, save

NOWHERE = Place(0.0, 0.0, 0.0)


def step(graph: ExperienceMap, turn_rad: float = 0.0, behaviour: str = '') -> None:
    """Turn on the spot, drive 0.5 m in a second, and make an experience."""
    graph.integrate(Motion(0.0, 0.0, turn_rad))
    graph.integrate(Motion(1.0, 0.5, 0.0))
    new = len(graph)
    graph.apply(MapAction('create', graph.current_id, new, new, 0.0, NOWHERE), behaviour)


def in_and_out(length: int) -> ExperienceMap:
    """Drive so many steps along, turn, and the same way back."""
    graph = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    for _ in range(length):
        step(graph)
    step(graph, math.pi)
    for _ in range(length - 2):
        step(graph)
    return graph


def test_a_route_need_not_go_into_a_room_and_out_again() -> None:
    graph = in_and_out(7)
    by_links = RoutePlanner(GoalRecallParameters()).route_to(graph, 0)
    joined = RoutePlanner(GoalRecallParameters(route_join_m=0.35)).route_to(graph, 0)
    assert len(by_links.experience_ids) == len(graph)
    # It is there already, and only looks the other way.
    assert joined.arrival_s[-1] == pytest.approx(math.pi, abs=0.2)


def round_the_block(side: int) -> ExperienceMap:
    """Drive so many steps along each side of a square, and stop 0.3 m before the start."""
    graph = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    for corner in range(4):
        for n in range(side):
            step(graph, math.pi / 2 if n == 0 and corner else 0.0)
    graph.integrate(Motion(0.0, 0.0, math.pi / 2))
    graph.integrate(Motion(0.4, 0.2, 0.0))
    graph.apply(MapAction('create', graph.current_id, len(graph), len(graph), 0.0, NOWHERE))
    return graph


@pytest.mark.parametrize(('side', 'is_joined'), [(3, True), (9, False), (20, False)])
def test_only_places_that_a_short_way_connects_are_joined(side: int, is_joined: bool) -> None:
    # The map may be bent on a long way round, and a wall be between its ends.
    assert (0.5 * side < TILE_M) == is_joined
    graph = round_the_block(side)
    assert np.hypot(*(graph.poses[-1, :2] - graph.poses[0, :2])) == pytest.approx(0.3)
    ids = RoutePlanner(GoalRecallParameters(route_join_m=0.35)).route_to(graph, 0).experience_ids
    assert ids == ((len(graph) - 1, 0) if is_joined else tuple(reversed(range(len(graph)))))


def test_places_stay_joined_where_the_way_that_connects_them_is_unlearned(
    tmp_path: Path,
) -> None:
    """To and fro along a corridor, which is closed before the robot's turning point later."""
    graph = in_and_out(7)
    last = len(graph) - 1
    while graph.report_blocked('centreline', 0.0, Pose(2.9, 0.0, 0.0)) == 0:
        pass
    with pytest.raises(UnreachableGoal, match='no link leads'):
        RoutePlanner(GoalRecallParameters()).route_to(graph, 0)
    save(tmp_path / 'map', 'experience_map', graph.state())
    loaded = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    loaded.restore(load(tmp_path / 'map', 'experience_map'))
    for one in (graph, loaded):
        recall = RoutePlanner(GoalRecallParameters(route_join_m=0.35))
        assert recall.route_to(one, 0).experience_ids == (last, 0)
    # What is forgotten says nothing any more, and its number means another place.
    turning_point = int(graph.poses[:, 0].argmax())
    assert turning_point in graph.unlearned_ends
    there = MapAction('create', last, turning_point, last + 1, 0.0, NOWHERE)
    graph.integrate(Motion(1.0, 0.5, 0.0))
    graph.apply(there)
    assert turning_point not in graph.unlearned_ends


def test_a_join_that_was_given_up_is_not_used_again() -> None:
    graph = in_and_out(7)
    recall = RoutePlanner(GoalRecallParameters(route_join_m=0.35))
    last = len(graph) - 1
    assert recall.route_to(graph, 0).experience_ids == (last, 0)
    recall.part(graph, [last])
    assert recall.rejected_shortcuts(graph) == 1
    assert len(recall.route_to(graph, 0).experience_ids) == len(graph)
    step(graph)  # nor where the map grows
    assert len(recall.route_to(graph, 0).experience_ids) == len(graph)
    assert RoutePlanner(recall.parameters).route_to(graph, 0).experience_ids == (last + 1, last, 0)


def test_a_robot_that_fails_where_ways_are_joined_gives_up_the_join() -> None:
    graph = in_and_out(7)
    for _ in range(2):
        step(graph)
    navigator = Navigator(GoalRecallParameters(route_join_m=0.35), graph)
    navigator.go_to(0)
    before = navigator.update(0)
    assert len(before.positions_m) < 5
    assert navigator.report_blocked()  # the way may be closed all the same
    assert navigator.recall.rejected_shortcuts(graph) > 0
    after = navigator.update(1)
    assert after.status == 'following'
    assert len(after.positions_m) == len(graph)
    assert after.replanned == 2


def test_against_a_link_the_wall_is_on_the_other_side() -> None:
    graph = ExperienceMap(ExperienceMapParameters())
    step(graph)
    step(graph, behaviour='left_wall')
    step(graph, behaviour='turn')
    assert graph.behaviour_between(0, 1) == 'left_wall'
    assert graph.behaviour_between(1, 0) == 'right_wall'
    assert graph.behaviour_between(2, 1) == ''
    assert graph.behaviour_between(0, 2) == ''


@pytest.mark.parametrize('columns', [-2, -1, 0, 1, 2])
def test_the_shift_of_a_view_tells_how_the_robot_is_turned(columns: int) -> None:
    parameters = LocalViewParameters(
        template_x_size=20, template_y_size=10, vt_shift_match=3, vt_shift_fov_deg=50.0
    )
    rng = np.random.default_rng(1)
    wide = rng.integers(0, 256, (10, 40)).astype(np.uint8)
    view = LocalView(parameters)
    view.match(wide[:, 10:30])
    # Turned to the left the camera sees more of what is on the left: all moves to the right.
    match = view.match(wide[:, 10 - columns : 30 - columns])
    assert not match.is_new
    assert match.relative_rad == pytest.approx(math.radians(columns * 50.0 / 20))


def test_without_the_angle_shifts_are_no_turns() -> None:
    view = LocalView(LocalViewParameters(template_x_size=20, template_y_size=10, vt_shift_match=3))
    wide = np.random.default_rng(1).integers(0, 256, (10, 40)).astype(np.uint8)
    view.match(wide[:, 10:30])
    assert view.match(wide[:, 11:31]).relative_rad == 0.0


def straight(length: int) -> ExperienceMap:
    graph = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    for _ in range(length):
        step(graph)
    return graph


def on_the_way(graph: ExperienceMap) -> Navigator:
    navigator = Navigator(GoalRecallParameters(try_unknown_m=2.0, goal_radius_m=0.1), graph)
    navigator.go_to(0)
    navigator.update(0)
    return navigator


def test_a_robot_that_knows_where_it_is_counts_its_failures() -> None:
    navigator = on_the_way(straight(10))
    assert all(navigator.report_blocked() for _ in range(MOST_TRIES))
    assert not navigator.update(1).explore
    navigator.report_blocked()
    assert navigator.update(2).explore  # that many have changed nothing: it is not there


def test_a_robot_that_may_be_wrong_looks_for_itself() -> None:
    graph = straight(10)
    navigator = on_the_way(graph)
    for stamp_ns in range(1, 4):
        step(graph)  # further away, where it has never been
        for _ in range(3):
            guidance = navigator.update(stamp_ns)
    assert guidance.unknown_m == pytest.approx(0.6)  # a leap counts as little: the map moved
    assert navigator.report_blocked()
    for stamp_ns in range(4, 20):
        step(graph)
        guidance = navigator.update(stamp_ns)
    assert guidance.unknown_m > 2.0
    for _ in range(MOST_UNSURE + 1):
        assert not navigator.report_blocked()
    assert navigator.update(20).explore


def test_where_a_scan_fits_it_counts_from_there() -> None:
    graph = straight(10)
    navigator = on_the_way(graph)
    for stamp_ns in range(1, 12):
        step(graph)
        guidance = navigator.update(stamp_ns)
    assert guidance.unknown_m > 2.0
    graph.scan_confirmed_m = 1.0
    assert navigator.update(12).unknown_m < 0.3
    for stamp_ns in range(13, 24):
        step(graph)
        guidance = navigator.update(stamp_ns)
    assert guidance.unknown_m > 2.0  # it fitted once


def test_at_a_limit_new_places_are_unknown_too() -> None:
    """They take the numbers of old ones."""
    graph = straight(10)
    navigator = on_the_way(graph)
    for stamp_ns in range(1, 12):
        graph.integrate(Motion(1.0, 0.5, 0.0))
        number = 1 + stamp_ns % 5
        graph.apply(MapAction('create', graph.current_id, number, 20, 0.0, NOWHERE))
        guidance = navigator.update(stamp_ns)
    assert guidance.unknown_m > 2.0
