# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shortest routes over the experience map."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation import route_planner
from ratslam_ros.core.navigation.route_planner import (
    SHORTEST_S,
    GoalTree,
    Route,
    RoutePlanner,
    TemporalMap,
    durations,
)
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnreachableGoal

RECALL = RoutePlanner(GoalRecallParameters(goal_tolerance_m=0.5))
BACK = 2.5
ONE_WAY = RoutePlanner(GoalRecallParameters(goal_tolerance_m=0.5, route_back_factor=BACK))
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


# What is kept between calls


def wander(graph: ExperienceMap, rng: np.random.Generator, islands: bool = False) -> None:
    """Do any one action; some durations are below the least one, some links lead to themselves."""
    new = len(graph) == 0 or rng.uniform() < 0.3
    target = len(graph) if new else int(rng.integers(0, len(graph)))
    if islands and rng.uniform() < 0.3:
        graph.integrate(Motion(1.0, 1.0, 0.0))
        graph.apply(MapAction('create' if new else 'set', -1, target, target, 0.0, NOWHERE))
        return
    go(graph, target, float(rng.choice([0.0, rng.uniform(0.5, 9.0)], p=[0.1, 0.9])))


def link_times(graph: ExperienceMap, back: float = 1.0) -> dict[tuple[int, int], float]:
    """Return the least time of a link from each experience to each that it has one with."""
    times: dict[tuple[int, int], float] = {}
    for link in graph.links():
        a, b, seconds = link.source_id, link.target_id, max(link.duration_s, SHORTEST_S)
        for ends, duration_s in (((a, b), seconds), ((b, a), back * seconds)):
            times[ends] = min(duration_s, times.get(ends, math.inf))
    return times


def times_to(graph: ExperienceMap, goal: int, back: float = 1.0) -> list[float]:
    """Return the least times to a goal, by trying all links until nothing gets quicker."""
    best = [math.inf] * len(graph)
    best[goal] = 0.0
    links = link_times(graph, back)
    for _ in range(len(graph)):
        for (a, b), seconds in links.items():
            best[a] = min(best[a], best[b] + seconds)
    return best


def assert_leads(graph: ExperienceMap, route: Route, start: int, goal: int) -> None:
    assert (route.experience_ids[0], route.experience_ids[-1]) == (start, goal)
    assert set(itertools.pairwise(route.experience_ids)) <= set(link_times(graph))


class Counting(RoutePlanner):
    """Counts how often all is computed."""

    def __init__(self, back: float = 1.0) -> None:
        super().__init__(GoalRecallParameters(route_back_factor=back))
        self.computed = 0

    def temporal_map(
        self, graph: ExperienceMap, start_id: int | None = None, to_start: bool = False
    ) -> TemporalMap:
        self.computed += 1
        return super().temporal_map(graph, start_id, to_start)


@pytest.mark.parametrize('back', [1.0, BACK])
@pytest.mark.parametrize('seed', range(5))
def test_durations_are_those_of_the_quickest_link_either_way(seed: int, back: float) -> None:
    rng = np.random.default_rng(seed)
    graph = ExperienceMap(ExperienceMapParameters())
    for _ in range(60):
        wander(graph, rng, islands=True)
        times = link_times(graph, back)
        matrix = durations(graph, 1.0, back)
        assert dict(zip(zip(*matrix.nonzero(), strict=True), matrix.data, strict=True)) == times
        assert (durations(graph, back, 1.0) != matrix.T).nnz == 0
    types = (matrix.data.dtype, matrix.indices.dtype, matrix.indptr.dtype)
    assert types == (np.float64, np.int32, np.int32)
    assert matrix.has_canonical_format


def test_an_experience_without_links_is_a_goal_for_itself_only() -> None:
    graph = line(1)
    assert durations(graph).nnz == 0
    assert RECALL.route_to(graph, 0).experience_ids == (0,)
    assert GoalTree(RECALL, graph, 0).route().experience_ids == (0,)


def test_changes_of_the_map_are_seen() -> None:
    graph, other = line(4), line(2)
    assert RECALL.route_to(graph, 0).arrival_s[-1] == pytest.approx(6.0)
    assert RECALL.route_to(other, 0).arrival_s[-1] == pytest.approx(2.0)
    go(graph, 0, 4.0)
    assert RECALL.route_to(graph, 3).arrival_s == pytest.approx((0.0, 4.0))
    graph.current_id = 3
    go(graph, 0, 2.0)  # averaged
    assert RECALL.route_to(graph, 3).arrival_s == pytest.approx((0.0, 3.0))
    graph.apply(MapAction('create', -1, 4, 4, 0.0, NOWHERE))  # changes no link
    with pytest.raises(UnreachableGoal, match='no link leads from experience 4 to 0'):
        RECALL.route_to(graph, 0)


def test_a_long_route_is_read_back() -> None:
    graph = line(12000)
    ids = tuple(range(11999, -1, -1))
    route = RECALL.route_to(graph, 0)
    assert route.experience_ids == ids
    assert type(route.experience_ids[0]) is int
    assert type(route.arrival_s[0]) is float
    assert GoalTree(RECALL, graph, 0).route().experience_ids == ids


def test_a_way_back_costs_as_many_times_more_as_the_parameter_says() -> None:
    graph = line(5)
    assert ONE_WAY.route_to(graph, 3).arrival_s == pytest.approx((0.0, 2.0 * BACK))
    go(graph, 0, 9.0)
    graph.current_id = 3  # on by 4 and the slow link to 0 takes 11 s, back three links 15 s
    assert RECALL.route_to(graph, 0).experience_ids == (3, 2, 1, 0)
    for route in (ONE_WAY.route_to(graph, 0), GoalTree(ONE_WAY, graph, 0).route()):
        assert route.experience_ids == (3, 4, 0)
        assert route.arrival_s == pytest.approx((0.0, 2.0, 11.0))


@pytest.mark.parametrize('seed', range(6))
def test_times_from_a_place_and_to_it_are_those_over_directed_links(seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph = line(2)
    for _ in range(40):
        wander(graph, rng, islands=True)
        count = len(graph)
        start = int(rng.integers(0, count))
        there = ONE_WAY.temporal_map(graph, start, to_start=True)
        assert there.arrival_s == pytest.approx(times_to(graph, start, BACK))
        onwards = ONE_WAY.temporal_map(graph, start).arrival_s
        goal = int(rng.integers(0, count))
        assert onwards[goal] == pytest.approx(times_to(graph, goal, BACK)[start])


def test_a_tree_follows_a_factor_that_is_replaced() -> None:
    graph, recall = line(5), RoutePlanner(GoalRecallParameters())
    tree = GoalTree(recall, graph, 0)
    for back in (1.0, 2.0, 5.0, 1.0):
        recall.parameters = GoalRecallParameters(route_back_factor=back)
        assert tree.remaining_s() == pytest.approx(8.0 * back)
        assert recall.temporal_map(graph, 0).arrival_s[4] == pytest.approx(8.0)
        assert recall.route_to(graph, 2).arrival_s[-1] == pytest.approx(4.0 * back)


@pytest.mark.parametrize('recall', [RECALL, ONE_WAY])
@pytest.mark.parametrize('islands', [False, True])
@pytest.mark.parametrize('seed', range(6))
@pytest.mark.parametrize('per_change', [0, 5, 2000])
def test_a_tree_that_says_so_is_exact_and_any_leads_to_its_goal(
    monkeypatch: pytest.MonkeyPatch, seed: int, islands: bool, per_change: int,
    recall: RoutePlanner,
) -> None:
    monkeypatch.setattr(route_planner, 'EXPERIENCES_PER_CHANGE', per_change)
    rng = np.random.default_rng(seed)
    graph = line(3)
    tree = GoalTree(recall, graph, 1)
    back = recall.parameters.route_back_factor
    exact = []
    for _ in range(50):
        for _ in range(rng.integers(1, 4)):
            wander(graph, rng, islands)
        times = times_to(graph, 1, back)
        exact.append(tree.exact())
        assert tree.reachable().tolist() == [math.isfinite(time) for time in times]
        for start, time in enumerate(times):
            if exact[-1]:
                assert tree.remaining_s(start) == pytest.approx(time)
            if math.isfinite(time):
                route = tree.route(start)
                assert_leads(graph, route, start, 1)
                assert route.arrival_s[-1] == pytest.approx(tree.remaining_s(start))
                assert tree.route(start, 2).experience_ids == route.experience_ids[:2]
            else:
                with pytest.raises(UnreachableGoal, match=f'from experience {start} to 1'):
                    tree.route(start)
    assert all(exact) == (per_change == 2000)


def test_new_experiences_and_links_that_are_no_short_cut_leave_a_tree_exact() -> None:
    graph, recall = line(3), Counting()
    tree = GoalTree(recall, graph, 0)
    for target in range(3, 40):
        go(graph, target, 2.0)
        assert tree.remaining_s() == pytest.approx(2.0 * target)
    go(graph, 20, 50.0)
    assert tree.remaining_s() == pytest.approx(40.0)
    assert (tree.exact(), recall.computed) == (True, 1)
    go(graph, 10, 3.0)
    go(graph, 40, 1.0)
    assert tree.remaining_s(20) == pytest.approx(23.0)
    assert tree.remaining_s() == pytest.approx(21.0)
    assert (tree.exact(), recall.computed) == (True, 2)


def test_a_new_link_counts_for_the_direction_in_which_it_is_quicker() -> None:
    graph, recall = line(5), Counting(BACK)
    tree = GoalTree(recall, graph, 2)
    go(graph, 0, 5.9)  # 0 is 4 s before the goal; 4 was 10 s past it and is now 9.9 s
    assert tree.remaining_s(4) == pytest.approx(9.9)
    assert tree.remaining_s(0) == pytest.approx(4.0)
    assert (tree.exact(), recall.computed) == (True, 2)
    graph.current_id = 1
    go(graph, 3, 2.9)  # forwards it shortens nothing, and back neither: 2.9 * 2.5 + 2 > 5
    assert (tree.exact(), recall.computed) == (True, 2)
    assert [tree.remaining_s(n) for n in range(5)] == pytest.approx(times_to(graph, 2, BACK))


def test_a_large_stale_tree_is_computed_anew_after_a_number_of_changes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(route_planner, 'EXPERIENCES_PER_CHANGE', 2)
    graph, recall = line(20), Counting()
    tree = GoalTree(recall, graph, 0)
    computed, times = [], []
    for change in range(20):
        go(graph, (0, 19)[change % 2], 1.0)  # at once a short cut, and again and again
        times.append(tree.remaining_s(19))
        computed.append(recall.computed)
    assert computed == [1] * 9 + [2] * 10 + [3]
    assert times == pytest.approx([38.0] * 9 + [1.0] * 11)


@pytest.mark.parametrize('recall', [RECALL, ONE_WAY])
@pytest.mark.parametrize('seed', range(4))
def test_no_way_leads_over_a_link_that_is_no_more(
    monkeypatch: pytest.MonkeyPatch, seed: int, recall: RoutePlanner
) -> None:
    monkeypatch.setattr(route_planner, 'EXPERIENCES_PER_CHANGE', 0)
    rng = np.random.default_rng(seed)
    graph = line(8)
    for _ in range(20):
        wander(graph, rng)
    tree = GoalTree(recall, graph, 0)
    unlearned = 0
    for _ in range(60):
        if rng.uniform() < 0.5:
            wander(graph, rng)
        unlearned += graph.report_blocked('centreline', float(rng.uniform(-math.pi, math.pi)))
        if rng.uniform() < 0.1:  # the number of another one is used anew
            again = int(rng.integers(1, len(graph)))
            graph.integrate(Motion(1.0, 1.0, 0.0))
            graph.apply(MapAction('create', graph.current_id, again, 99, 0.0, NOWHERE))
        for start, time in enumerate(times_to(graph, 0)):
            assert math.isfinite(tree.remaining_s(start)) == math.isfinite(time)
            if math.isfinite(time):
                assert_leads(graph, tree.route(start), start, 0)
    assert unlearned > 0


def test_a_joined_part_of_the_map_is_on_the_tree_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(route_planner, 'EXPERIENCES_PER_CHANGE', 0)
    graph, recall = line(3), Counting()
    tree = GoalTree(recall, graph, 0)
    graph.apply(MapAction('create', -1, 3, 3, 0.0, NOWHERE))
    for target in (4, 5, 4, 5):
        go(graph, target, 1.0)
        assert tree.remaining_s() == math.inf
    assert recall.computed == 1
    go(graph, 2, 1.0)
    assert tree.remaining_s(3) == pytest.approx(7.0)
    assert recall.computed == 2


def test_a_tree_knows_no_goal_and_no_start_that_is_not_on_the_map() -> None:
    graph = line(3)
    with pytest.raises(UnreachableGoal, match='there is no experience 3; expected 0 to 2'):
        GoalTree(RECALL, graph, 3)
    with pytest.raises(UnreachableGoal, match='there is no experience -1'):
        GoalTree(RECALL, graph, 2).route(-1)


@pytest.mark.parametrize('seed', range(4))
def test_following_gives_the_routes_that_asking_anew_gives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    recall = RoutePlanner(GoalRecallParameters(goal_tolerance_m=2.0))
    for graph in (line(5), line(6)):
        for _ in range(60):
            wander(graph, rng, islands=True)
            try:
                asked = RECALL.route_to_place(graph, 2.1, 0.0, 2.0)
            except UnreachableGoal as error:
                with pytest.raises(UnreachableGoal) as caught:
                    recall.follow(graph, 2.1, 0.0)
                assert str(caught.value) == str(error)
                continue
            route = recall.follow(graph, 2.1, 0.0)
            assert route.arrival_s[-1] == pytest.approx(asked.arrival_s[-1])
            assert_leads(graph, route, graph.current_id, asked.experience_ids[-1])


def test_following_computes_only_where_it_must() -> None:
    recall = Counting()
    with pytest.raises(UnreachableGoal, match='the map is empty'):
        recall.follow(ExperienceMap(ExperienceMapParameters()), 1.0, 0.0)
    graph, recall = line(5), Counting()
    assert recall.follow(graph, 1.0, 0.0).experience_ids == (4, 3, 2, 1, 0)
    computed = recall.computed
    for target in range(5, 30):
        go(graph, target, 2.0)
        assert recall.follow(graph, 1.0, 0.0).arrival_s[-1] == pytest.approx(2.0 * target)
    assert recall.computed == computed
    with pytest.raises(UnreachableGoal, match=r'1\.00 m away'):
        recall.follow(graph, 1.0, 1.0)
    recall.parameters = GoalRecallParameters(goal_tolerance_m=1.5)
    assert recall.follow(graph, 1.0, 1.0).experience_ids[-1] == 0


def test_a_number_that_means_another_experience_may_be_joined_again() -> None:
    recall, graph = RoutePlanner(GoalRecallParameters()), ExperienceMap(ExperienceMapParameters())
    recall.part(graph, [3, 4])
    recall.forgotten(graph, 3)
    assert recall.rejected_shortcuts(graph) == 1
    recall.forgotten(graph, 3)
    assert recall.rejected_shortcuts(graph) == 1
