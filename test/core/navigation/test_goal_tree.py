# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The goal tree against searches over all links."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from route_maps import (
    BACK,
    NEVER_BACK,
    NOWHERE,
    ONE_WAY,
    PARAMETERS,
    go,
    is_exact,
    line,
    link_times,
    planner_of,
    remaining_s,
    times_to,
    wander,
)

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation import goal_tree
from ratslam_ros.core.navigation.goal_tree import GoalTree
from ratslam_ros.core.navigation.route_planner import Route, RoutePlanner, TemporalMap
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.errors import UnreachableGoal


def assert_leads(graph: ExperienceMap, route: Route, start: int, goal: int) -> None:
    assert (route.experience_ids[0], route.experience_ids[-1]) == (start, goal)
    assert set(itertools.pairwise(route.experience_ids)) <= set(link_times(graph))


class Counting(RoutePlanner):
    """Counts the computations of temporal maps."""

    def __init__(self, graph: ExperienceMap, back: float = 1.0) -> None:
        super().__init__(GoalRecallParameters(route_back_factor=back), graph)
        self.computed = 0

    def temporal_map(
        self, start_id: int | None = None, to_start: bool = False, blocked: bool = False
    ) -> TemporalMap:
        self.computed += 1
        return super().temporal_map(start_id, to_start, blocked)


def test_replaced_back_factor_updates_tree() -> None:
    graph = line(5)
    planner = RoutePlanner(GoalRecallParameters(), graph)
    tree = GoalTree(planner, 0)
    for back in (1.0, 2.0, 5.0, 1.0):
        planner.parameters = GoalRecallParameters(route_back_factor=back)
        assert remaining_s(tree) == pytest.approx(8.0 * back)
        assert planner.temporal_map(0).arrival_s[4] == pytest.approx(8.0)
        assert planner.route_to(2).arrival_s[-1] == pytest.approx(4.0 * back)


@pytest.mark.parametrize('parameters', [PARAMETERS, ONE_WAY, NEVER_BACK])
@pytest.mark.parametrize('per_change', [0, 2000])
def test_tree_is_exact_or_leads_to_goal(
    monkeypatch: pytest.MonkeyPatch, per_change: int, parameters: GoalRecallParameters
) -> None:
    monkeypatch.setattr(goal_tree, 'EXPERIENCES_PER_CHANGE', per_change)
    rng = np.random.default_rng(0)
    graph = line(3)
    tree = GoalTree(RoutePlanner(parameters, graph), 1)
    back = parameters.route_back_factor or math.inf
    exact = []
    for _ in range(30):
        for _ in range(rng.integers(1, 4)):
            wander(graph, rng, islands=True)
        times = times_to(graph, 1, back)
        exact.append(is_exact(tree))
        for start, time in enumerate(times):
            assert math.isfinite(remaining_s(tree, start)) == math.isfinite(time)
            if exact[-1]:
                assert remaining_s(tree, start) == pytest.approx(time)
            if math.isfinite(time):
                route = tree.route(start)
                assert_leads(graph, route, start, 1)
            else:
                with pytest.raises(UnreachableGoal, match=f'from experience {start} to 1'):
                    tree.route(start)
    assert all(exact) == (per_change == 2000)


def test_new_links_without_faster_route_keep_tree_exact() -> None:
    graph = line(3)
    planner = Counting(graph)
    tree = GoalTree(planner, 0)
    for target in range(3, 40):
        go(graph, target, 2.0)
        assert remaining_s(tree) == pytest.approx(2.0 * target)
    go(graph, 20, 50.0)
    assert remaining_s(tree) == pytest.approx(40.0)
    assert (is_exact(tree), planner.computed) == (True, 1)
    go(graph, 10, 3.0)
    go(graph, 40, 1.0)
    assert remaining_s(tree, 20) == pytest.approx(23.0)
    assert remaining_s(tree) == pytest.approx(21.0)
    assert (is_exact(tree), planner.computed) == (True, 2)


def test_new_link_is_weighted_by_direction() -> None:
    graph = line(5)
    planner = Counting(graph, BACK)
    tree = GoalTree(planner, 2)
    go(graph, 0, 5.9)  # 0 has 4 s to go; 4 had 10 s and now has 9.9 s
    assert remaining_s(tree, 4) == pytest.approx(9.9)
    assert remaining_s(tree, 0) == pytest.approx(4.0)
    assert (is_exact(tree), planner.computed) == (True, 2)
    graph.current_id = 1
    go(graph, 3, 2.9)  # no faster forwards, nor back: 2.9 * 2.5 + 2 > 5
    assert (is_exact(tree), planner.computed) == (True, 2)
    assert [remaining_s(tree, n) for n in range(5)] == pytest.approx(times_to(graph, 2, BACK))


def test_large_stale_tree_is_recomputed_after_several_changes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(goal_tree, 'EXPERIENCES_PER_CHANGE', 2)
    graph = line(20)
    planner = Counting(graph)
    tree = GoalTree(planner, 0)
    computed, times = [], []
    for change in range(20):
        go(graph, (0, 19)[change % 2], 1.0)  # the first change already shortens the route
        times.append(remaining_s(tree, 19))
        computed.append(planner.computed)
    assert computed == [1] * 9 + [2] * 10 + [3]
    assert times == pytest.approx([38.0] * 9 + [1.0] * 11)


@pytest.mark.parametrize('parameters', [PARAMETERS, ONE_WAY])
def test_routes_avoid_removed_links(
    monkeypatch: pytest.MonkeyPatch, parameters: GoalRecallParameters
) -> None:
    monkeypatch.setattr(goal_tree, 'EXPERIENCES_PER_CHANGE', 0)
    rng = np.random.default_rng(0)
    graph = line(8)
    for _ in range(20):
        wander(graph, rng)
    tree = GoalTree(RoutePlanner(parameters, graph), 0)
    unlearned = 0
    for _ in range(60):
        if rng.uniform() < 0.5:
            wander(graph, rng)
        unlearned += graph.unlearn_blocked('centreline', float(rng.uniform(-math.pi, math.pi)))
        if rng.uniform() < 0.1:  # reuse an id
            again = int(rng.integers(1, len(graph)))
            graph.integrate(Motion(1.0, 1.0, 0.0))
            graph.apply(MapAction('create', graph.current_id, again, 99, 0.0, NOWHERE))
        for start, time in enumerate(times_to(graph, 0)):
            assert math.isfinite(remaining_s(tree, start)) == math.isfinite(time)
            if math.isfinite(time):
                assert_leads(graph, tree.route(start), start, 0)
    assert unlearned > 0


def test_connected_component_is_added_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(goal_tree, 'EXPERIENCES_PER_CHANGE', 0)
    graph = line(3)
    planner = Counting(graph)
    tree = GoalTree(planner, 0)
    graph.apply(MapAction('create', -1, 3, 3, 0.0, NOWHERE))
    for target in (4, 5, 4, 5):
        go(graph, target, 1.0)
        assert remaining_s(tree) == math.inf
    assert planner.computed == 1
    go(graph, 2, 1.0)
    assert remaining_s(tree, 3) == pytest.approx(7.0)
    assert planner.computed == 2


def test_tree_rejects_unknown_goal_and_start() -> None:
    graph = line(3)
    with pytest.raises(UnreachableGoal, match='there is no experience 3; expected 0 to 2'):
        GoalTree(planner_of(graph), 3)
    with pytest.raises(UnreachableGoal, match='there is no experience -1'):
        GoalTree(planner_of(graph), 2).route(-1)


def unlearn(graph: ExperienceMap, *ends: tuple[int, int]) -> None:
    for source, target in ends:
        row = graph.link_table.row(source, target)
        assert row is not None
        graph._unlearn([row])


def ring_with_spur() -> ExperienceMap:
    """Return 8 experiences in a ring and a spur at 4 that leads to 8, without 0-1 and 4-8."""
    graph = line(8)
    go(graph, 0)
    go(graph, 4, linked=False)
    go(graph, 8)
    unlearn(graph, (0, 1), (4, 8))
    return graph


def test_unlearned_links_are_used_only_where_no_others_lead_to_the_goal() -> None:
    planner = planner_of(ring_with_spur())
    tree = GoalTree(planner, 0)
    around = 1, 2, 3, 4, 5, 6, 7, 0
    for _ in range(2):  # the map does not change
        assert planner.route_to(0, 1).experience_ids == tree.route(1).experience_ids == around
        assert planner.route_to(0, 8).experience_ids[:2] == (8, 4)
        with pytest.raises(UnreachableGoal):
            tree.route(8)
