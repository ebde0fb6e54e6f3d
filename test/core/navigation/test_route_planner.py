# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shortest routes over the experience map."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from route_maps import BACK, NOWHERE, ONE_WAY, go, line, planner_of, times_to, wander

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goal_tree import GoalTree
from ratslam_ros.core.navigation.route_graph import route_graph
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.errors import UnreachableGoal


def test_route_over_reversed_links_has_arrival_times() -> None:
    route = planner_of(line(5)).route_to(1)
    assert route.experience_ids == (4, 3, 2, 1)
    assert route.arrival_s == pytest.approx((0.0, 2.0, 4.0, 6.0))


def test_route_to_current_experience_has_one_element() -> None:
    route = planner_of(line(3)).route_to(2)
    assert (route.experience_ids, route.arrival_s) == ((2,), (0.0,))


def test_travel_times_match_floyd_warshall() -> None:
    rng = np.random.default_rng(0)
    graph = line(7)
    for _ in range(12):
        target = int(rng.integers(0, 7))
        if target != graph.current_id:
            go(graph, target, float(rng.uniform(0.5, 9.0)))
    times = np.full((7, 7), math.inf)
    for link in graph.links():
        for a, b in ((link.source_id, link.target_id), (link.target_id, link.source_id)):
            times[a, b] = min(times[a, b], link.duration_s)
    np.fill_diagonal(times, 0.0)
    for k, a, b in itertools.product(range(7), repeat=3):
        times[a, b] = min(times[a, b], times[a, k] + times[k, b])
    found = planner_of(graph).temporal_map()
    assert found.arrival_s == pytest.approx(times[graph.current_id])
    for goal in range(7):
        route = found.route_to(goal)
        assert route.arrival_s[-1] == pytest.approx(times[graph.current_id, goal])
        for a, b in itertools.pairwise(route.experience_ids):
            assert math.isfinite(times[a, b])


def test_position_selects_nearest_experience_within_tolerance() -> None:
    graph = line(5)  # at x = 1, 2, 3, 4 and 5 m
    assert planner_of(graph).route_to_place(2.3, 0.2).experience_ids[-1] == 1
    assert planner_of(graph).route_to_place(2.3, 3.0, tolerance_m=4.0).experience_ids[-1] == 1
    with pytest.raises(UnreachableGoal, match=r'2\.12 m away; expected at most 0\.5 m'):
        planner_of(graph).route_to_place(-0.5, 1.5)


def with_an_island() -> ExperienceMap:
    """Return a map with three linked experiences at 1 to 3 m and fifty unlinked ones at 2 m."""
    graph = line(3)
    for number in range(3, 53):
        graph.integrate(Motion(1.0, -1.0, 0.0))
        graph.apply(MapAction('create', -1, number, number, 0.0, NOWHERE))
        graph.apply(MapAction('set', -1, 2, 2, 0.0, NOWHERE))
    return graph


def test_unreachable_goal_is_rejected() -> None:
    with pytest.raises(UnreachableGoal, match='no link leads from experience 2 to 20'):
        planner_of(with_an_island()).route_to(20)
    with pytest.raises(UnreachableGoal, match='there is no experience 99'):
        planner_of(with_an_island()).route_to(99)
    with pytest.raises(UnreachableGoal, match='the map is empty'):
        planner_of(ExperienceMap(ExperienceMapParameters())).route_to(0)


def test_position_ignores_nearer_unreachable_experiences() -> None:
    """Unlike the original implementation."""
    graph = with_an_island()
    island = graph.poses[20]
    assert np.hypot(*(island[:2] - [2.0, 0.0])) < 1e-9
    assert planner_of(graph).route_to_place(2.0, 0.1).experience_ids == (2, 1)


# Changes of the map


def test_experience_without_links_reaches_only_itself() -> None:
    graph = line(1)
    assert route_graph(graph).nnz == 0
    assert planner_of(graph).route_to(0).experience_ids == (0,)
    assert GoalTree(planner_of(graph), 0).route().experience_ids == (0,)


def test_planner_notices_changes_of_map() -> None:
    graph, other = line(4), line(2)
    planner = planner_of(graph)
    assert planner.route_to(0).arrival_s[-1] == pytest.approx(6.0)
    assert planner_of(other).route_to(0).arrival_s[-1] == pytest.approx(2.0)
    go(graph, 0, 4.0)
    assert planner.route_to(3).arrival_s == pytest.approx((0.0, 4.0))
    graph.current_id = 3
    go(graph, 0, 2.0)  # averaged
    assert planner.route_to(3).arrival_s == pytest.approx((0.0, 3.0))
    graph.apply(MapAction('create', -1, 4, 4, 0.0, NOWHERE))  # changes no link
    with pytest.raises(UnreachableGoal, match='no link leads from experience 4 to 0'):
        planner.route_to(0)


def test_route_over_12000_experiences_is_complete() -> None:
    graph = line(12000)
    ids = tuple(range(11999, -1, -1))
    route = planner_of(graph).route_to(0)
    assert route.experience_ids == ids
    assert type(route.experience_ids[0]) is int
    assert type(route.arrival_s[0]) is float
    assert GoalTree(planner_of(graph), 0).route().experience_ids == ids


def test_back_factor_weights_reversed_links() -> None:
    graph = line(5)
    planner = planner_of(graph, ONE_WAY)
    assert planner.route_to(3).arrival_s == pytest.approx((0.0, 2.0 * BACK))
    go(graph, 0, 9.0)
    graph.current_id = 3  # over 4 and the slow link to 0: 11 s; back over three links: 15 s
    assert planner_of(graph).route_to(0).experience_ids == (3, 2, 1, 0)
    for route in (planner.route_to(0), GoalTree(planner, 0).route()):
        assert route.experience_ids == (3, 4, 0)
        assert route.arrival_s == pytest.approx((0.0, 2.0, 11.0))


@pytest.mark.parametrize('seed', range(2))
def test_times_from_and_to_start_respect_direction(seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph = line(2)
    planner = planner_of(graph, ONE_WAY)
    for _ in range(40):
        wander(graph, rng, islands=True)
        count = len(graph)
        start = int(rng.integers(0, count))
        to_start = planner.temporal_map(start, to_start=True)
        assert to_start.arrival_s == pytest.approx(times_to(graph, start, BACK))
        from_start = planner.temporal_map(start).arrival_s
        goal = int(rng.integers(0, count))
        assert from_start[goal] == pytest.approx(times_to(graph, goal, BACK)[start])
