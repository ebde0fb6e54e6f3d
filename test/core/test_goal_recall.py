# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shortest routes over the experience map."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.experience_map import ExperienceMap
from ratslam_ros.core.goal_recall import GoalRecall, UnreachableGoal
from ratslam_ros.core.odometry import Motion
from ratslam_ros.core.pose_cells import MapAction
from ratslam_ros.core.torus import Place

RECALL = GoalRecall(GoalRecallParameters(goal_tolerance_m=0.5))
NOWHERE = Place(0.0, 0.0, 0.0)


def go(graph: ExperienceMap, target: int, duration_s: float, way_m: float = 1.0) -> None:
    """Drive from the current experience to another, new or known."""
    graph.integrate(Motion(duration_s, way_m, 0.0))
    kind = 'create' if target == len(graph) else 'link'
    graph.apply(MapAction(kind, graph.current_id, target, target, 0.0, NOWHERE))


def line(count: int, seconds: float = 2.0) -> ExperienceMap:
    graph = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    for target in range(count):
        go(graph, target, seconds)
    return graph


def test_a_route_goes_back_over_links_and_says_when_it_is_where() -> None:
    route = RECALL.route_to(line(5), 1)
    assert route.experience_ids == (4, 3, 2, 1)
    assert route.arrival_s == pytest.approx((0.0, 2.0, 4.0, 6.0))


def test_the_quickest_route_wins_not_the_one_of_fewest_links() -> None:
    graph = line(5)
    go(graph, 0, 100.0)  # one link from 4 to 0, but a slow one
    route = RECALL.route_to(graph, 4)
    assert route.experience_ids == (0, 1, 2, 3, 4)
    assert route.arrival_s[-1] == pytest.approx(8.0)


def test_links_either_way_are_not_added_up() -> None:
    graph = line(2, 4.0)
    go(graph, 0, 6.0)  # back, and slower
    assert RECALL.route_to(graph, 1).arrival_s == pytest.approx((0.0, 4.0))


def test_the_goal_may_be_where_the_robot_is() -> None:
    route = RECALL.route_to(line(3), 2)
    assert (route.experience_ids, route.arrival_s) == ((2,), (0.0,))


def test_times_are_those_of_every_way_tried() -> None:
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
    found = RECALL.temporal_map(graph)
    assert found.arrival_s == pytest.approx(times[graph.current_id])
    for goal in range(7):
        route = found.route_to(goal)
        assert route.arrival_s[-1] == pytest.approx(times[graph.current_id, goal])
        for a, b in itertools.pairwise(route.experience_ids):
            assert math.isfinite(times[a, b])


def test_a_place_means_the_nearest_experience_within_the_tolerance() -> None:
    graph = line(5)  # at x = 1, 2, 3, 4 and 5 m
    assert RECALL.route_to_place(graph, 2.3, 0.2).experience_ids[-1] == 1
    assert RECALL.route_to_place(graph, 2.3, 3.0, tolerance_m=4.0).experience_ids[-1] == 1
    with pytest.raises(UnreachableGoal, match=r'2\.12 m away; expected at most 0\.5 m'):
        RECALL.route_to_place(graph, -0.5, 1.5)


def with_an_island() -> ExperienceMap:
    """Return three linked experiences at 1 to 3 m, and fifty at 2 m that no link leads to."""
    graph = line(3)
    for number in range(3, 53):
        graph.integrate(Motion(1.0, -1.0, 0.0))
        graph.apply(MapAction('create', -1, number, number, 0.0, NOWHERE))
        graph.apply(MapAction('set', -1, 2, 2, 0.0, NOWHERE))
    return graph


def test_a_goal_that_no_link_leads_to_is_refused() -> None:
    with pytest.raises(UnreachableGoal, match='no link leads from experience 2 to 20'):
        RECALL.route_to(with_an_island(), 20)
    with pytest.raises(UnreachableGoal, match='there is no experience 99'):
        RECALL.route_to(with_an_island(), 99)
    with pytest.raises(UnreachableGoal, match='the map is empty'):
        RECALL.route_to(ExperienceMap(ExperienceMapParameters()), 0)


def test_a_goal_is_found_however_many_unreachable_experiences_are_nearer() -> None:
    """The original gives up there."""
    graph = with_an_island()
    island = graph.poses[20]
    assert np.hypot(*(island[:2] - [2.0, 0.0])) < 1e-9
    assert RECALL.route_to_place(graph, 2.0, 0.1).experience_ids == (2, 1)
