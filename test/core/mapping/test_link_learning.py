# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Links are unlearned when they fail and learned again, and variation strips no map."""

from __future__ import annotations

import json
import math
import random
from collections import deque
from typing import Any

import numpy as np
import pytest
from helpers import ahead, turning
from hypothesis import given, settings
from hypothesis import strategies as st

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap, NotLinked
from ratslam_ros.core.mapping.link_learning import (
    DETOUR_RATIO,
    LEAST_AHEAD_M,
    confidences,
    leading_ahead,
)
from ratslam_ros.core.navigation.goal_tree import GoalTree
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnreachableGoal, UnusableInput
from ratslam_ros.messages.mapping import MapText, encode_map

WALL = 'left_wall'


def new_map(**changes: Any) -> ExperienceMap:
    return ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0, **changes))


def go(graph: ExperienceMap, target: int, behaviour: str = WALL) -> None:
    """Make a transition; its motion is whatever was integrated."""
    kind = 'create' if target == len(graph) else 'link'
    place = Place(float(target), 0.0, 0.0)
    graph.apply(MapAction(kind, graph.current_id, target, target, 0.0, place), behaviour)  # type: ignore[arg-type]


def step(graph: ExperienceMap, target: int, behaviour: str = WALL) -> None:
    """Make a transition that takes 1 s."""
    graph.integrate(ahead(0.3, 1.0))
    go(graph, target, behaviour)


def confidence(graph: ExperienceMap, source: int, target: int) -> float:
    """Return the confidence of a link; 1 for one without a behaviour, which is never tried."""
    links, failures = graph.links(), graph.state()['failures']
    (behaviour,) = (k.behaviour for k in links if (k.source_id, k.target_id) == (source, target))
    if not behaviour:
        return 1.0
    rows = [n for n, k in enumerate(links) if (k.source_id, k.behaviour) == (source, behaviour)]
    found = confidences([links[row].count for row in rows], failures[rows])
    return found[[links[row].target_id for row in rows].index(target)]


def pairs(graph: ExperienceMap) -> set[tuple[int, int]]:
    return {(link.source_id, link.target_id) for link in graph.links()}


def parts(links: set[tuple[int, int]], count: int) -> list[int]:
    """Return the lowest id that each experience is joined with, over links in any direction."""
    part = list(range(count))
    for _ in range(count):
        for i, j in links:
            part[i] = part[j] = min(part[i], part[j])
    return part


# Variation


class Reference:
    """The rule of the class, in dictionaries: seed 000, section III.D, and the detour."""

    def __init__(self, p: ExperienceMapParameters) -> None:
        self.p = p
        self.links: dict[tuple[int, int], list[Any]] = {}  # behaviour, count, elsewhere

    def tried(self, i: int, behaviour: str) -> int:
        return sum(
            count for (a, _), (name, count, _) in self.links.items()
            if a == i and name == behaviour
        )  # fmt: skip

    def make(self, i: int, j: int, behaviour: str) -> None:
        name, count, _ = self.links.get((i, j), ['', 0, 0])
        self.links[i, j] = [behaviour or name, count + 1, 0]
        if not behaviour:
            return
        for (a, b), link in self.links.items():
            link[2] += a == i and b != j and link[0] == behaviour
        while True:
            worst = [
                (link[1] / self.tried(i, behaviour), order, key)
                for order, (key, link) in enumerate(self.links.items())
                if key[0] == i and link[0] == behaviour and link[2] >= self.p.exp_min_tries
                and link[1] / self.tried(i, behaviour) < self.p.exp_confidence_threshold
                and self.detour(*key)
            ]  # fmt: skip
            if not worst:
                return
            del self.links[min(worst)[2]]

    def detour(self, i: int, j: int) -> bool:
        steps, todo = {i: 0}, deque([i])
        while todo:
            here = todo.popleft()
            for a, b in self.links:
                for near, far in ((a, b), (b, a)):
                    if near == here and (a, b) != (i, j) and far not in steps:
                        steps[far] = steps[here] + 1
                        todo.append(far)
        return steps.get(j, DETOUR_RATIO + 1) <= DETOUR_RATIO


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 10**6), st.integers(2, 6), st.sampled_from([0.0, 0.1, 0.25, 0.6]),
    st.integers(1, 10),
)  # fmt: skip
def test_confidence_is_equation_9_and_the_least_confident_goes(
    seed: int, count: int, threshold: float, min_tries: int
) -> None:
    rng = random.Random(seed)
    graph = new_map(exp_loops=0, exp_confidence_threshold=threshold, exp_min_tries=min_tries)
    reference = Reference(graph._p)
    for target in range(count):
        step(graph, target, '')
        if target:
            reference.make(target - 1, target, '')
    unlearned = 0
    for _ in range(80):
        i, j = graph.current_id, rng.choices(range(count), range(1, count + 1))[0]
        if i == j:
            continue
        behaviour = rng.choice(['', WALL, WALL, 'centreline'])
        before = len(reference.links)
        step(graph, j, behaviour)
        reference.make(i, j, behaviour)
        unlearned += len(reference.links) < before
        links = graph.links()
        assert {(k.source_id, k.target_id): [k.behaviour, k.count] for k in links} == {
            key: link[:2] for key, link in reference.links.items()
        }
        for k in links:
            expected = k.count / reference.tried(k.source_id, k.behaviour) if k.behaviour else 1.0
            assert confidence(graph, k.source_id, k.target_id) == expected
    assert threshold > 0.0 or unlearned == 0
    assert len(set(parts(pairs(graph), count))) == 1


def test_a_wrong_link_is_unlearned_after_the_least_number_of_tries() -> None:
    graph = new_map(exp_min_tries=8)
    for target in (0, 1, 2, 0, 2, 0, 1):  # 0 -> 2 once, past 1
        step(graph, target)
    for tries in range(2, 9):
        step(graph, 0)
        assert (0, 2) in pairs(graph)
        assert confidence(graph, 0, 2) == 1 / (1 + tries)
        step(graph, 1)
    assert (0, 2) not in pairs(graph)
    assert graph.rebuilt == 1


@pytest.mark.parametrize('successors', [2, 3, 5, 7])
def test_successors_that_take_turns_are_all_kept(successors: int) -> None:
    """Several views of one place: whichever is seen first, it is the same way."""
    graph = new_map()
    for target in range(successors + 2):
        step(graph, target, '')
    for n in range(40 * successors):
        for target in (0, 1 + n % successors, successors + 1):
            step(graph, target)
    assert {(0, 1 + n) for n in range(successors)} <= pairs(graph)
    assert graph.rebuilt == 0


def test_a_way_of_its_own_is_kept_however_seldom_it_is_taken() -> None:
    """A branch that was explored once, beside a corridor of a hundred drives."""
    graph = new_map()
    for target in (0, 1, 0, 2, 3):
        step(graph, target)
    stand_before(graph, 0)
    for target in (0, 1) * 100:
        step(graph, target)
    assert confidence(graph, 0, 2) < 0.02
    assert (0, 2) in pairs(graph)
    stand_before(graph, 3)
    step(graph, 1)  # now it is a second way to 1
    for target in (0, 1) * 2:
        step(graph, target)
    assert (0, 2) not in pairs(graph)


def test_a_recording_without_behaviours_teaches_and_unlearns_nothing() -> None:
    graph, plain = (new_map(exp_confidence_threshold=share) for share in (0.9, 0.0))
    rng = random.Random(3)
    for n in range(400):
        target = n if n < 20 else rng.randrange(20)
        for one in (graph, plain):
            one.integrate(Motion(0.1, 1.0 + 0.01 * n, 0.3))
            go(one, target, '')
    assert encode_map(1, graph) == encode_map(1, plain)
    assert not graph.state()['failures'].any()


# Time-outs


def corridor(laps: int = 1, **changes: Any) -> ExperienceMap:
    """Drive along x, an experience every 0.5 m, there and back, to 0 at the end.

    Experiences 0 to 10 face the way there, 11 to 21 the way back: 10 + n lies where 11 - n does.
    """
    graph = new_map(**changes)
    go(graph, 0)
    for _ in range(laps):
        go_on(graph, 22)
        graph.integrate(turning(math.pi, 1.0))
        go(graph, 0)
    return graph


def go_on(graph: ExperienceMap, end: int) -> None:
    """Drive along the corridor, from the current experience on."""
    for target in range(graph.current_id + 1, end):
        graph.integrate(turning(math.pi, 1.0) if target == 11 else ahead(0.5, 1.0))
        go(graph, target)


def stand_before(graph: ExperienceMap, target: int) -> None:
    """Go there from 0 by the links there are."""
    graph.apply(
        MapAction('set', -1, target, target, 0.0, Place(float(target), 0.0, 0.0))
    )


def test_a_blocked_way_is_unlearned_after_a_few_attempts_and_learned_again() -> None:
    graph = corridor()
    planner = RoutePlanner(GoalRecallParameters(), graph)
    goal = 8
    stand_before(graph, 4)  # at x = 2
    tree = GoalTree(planner, goal)
    assert planner.route_to(goal).experience_ids == (4, 5, 6, 7, 8)
    attempts = [graph.report_blocked(WALL, 0.0) for _ in range(4)]
    assert attempts[:3] == [0, 0, 0]
    # x = 2 to 2.5, 2.5 to 3, 3 to 3.5: their near ends are at most 1 m away; both directions.
    assert attempts[3] == 6
    gone = {(4, 5), (5, 6), (6, 7), (15, 16), (16, 17), (14, 15)}
    assert not gone & pairs(graph)
    assert graph.link_count == 22 - 6
    with pytest.raises(UnreachableGoal):
        planner.route_to(goal)
    assert math.isinf(tree.remaining_s())
    go_on(graph, 8)  # the obstacle is gone
    assert {(4, 5), (5, 6), (6, 7)} <= pairs(graph)
    stand_before(graph, 4)
    assert planner.route_to(goal).experience_ids == (4, 5, 6, 7, 8)
    assert tree.route().experience_ids == (4, 5, 6, 7, 8)


def test_a_way_made_often_takes_more_attempts_but_not_more_than_recent_ones_tell() -> None:
    needed = {}
    for laps in (1, 2, 3, 20):
        graph = corridor(laps)
        stand_before(graph, 4)
        needed[laps] = next(n for n in range(1, 50) if graph.report_blocked(WALL, 0.0))
    assert needed == {1: 4, 2: 7, 3: 10, 20: 10}


def test_a_transition_that_is_made_takes_its_time_outs_back() -> None:
    graph = corridor()
    for made in range(1, 6):  # somebody stands there for a while, now and then
        stand_before(graph, 4)
        assert sum(graph.report_blocked(WALL, 0.0) for _ in range(3)) == 0
        assert confidence(graph, 4, 5) == made / (made + 3)
        go_on(graph, 22)
        assert confidence(graph, 4, 5) == 1.0
    assert graph.rebuilt == 0


def test_no_threshold_no_unlearning() -> None:
    graph = corridor(exp_confidence_threshold=0.0)
    stand_before(graph, 4)
    assert sum(graph.report_blocked(WALL, 0.0) for _ in range(100)) == 0


def test_without_a_name_or_a_place_or_mapping_nothing_is_counted() -> None:
    assert new_map().report_blocked(WALL, 0.0) == 0
    graph = corridor()
    stand_before(graph, 4)
    assert sum(graph.report_blocked('', 0.0) for _ in range(20)) == 0
    graph.mapping = False
    assert sum(graph.report_blocked(WALL, 0.0) for _ in range(20)) == 0
    with pytest.raises(UnusableInput, match='finite'):
        graph.report_blocked(WALL, math.nan)
    assert not graph.state()['failures'].any()


@pytest.mark.parametrize('turn', [0.0, 1.0, -2.5])
@pytest.mark.parametrize(('link', 'counts'), [
    ((0.0, 0.0, 0.5, 0.0), True),
    ((0.5, 0.0, 0.0, 0.0), True),  # whichever way it points
    ((-2.0, 0.0, 3.0, 0.0), True),  # a long one that passes by, as pruning leaves them
    ((0.9, 0.0, 2.0, 0.0), True),
    ((1.1, 0.0, 2.0, 0.0), False),  # too far
    ((-0.5, 0.0, 0.0, 0.0), False),  # behind
    ((0.0, 0.0, LEAST_AHEAD_M - 0.01, 0.0), False),  # too near for having been kept from it
    ((0.0, 0.5, 0.4, 0.9), False),  # to the side
    ((0.5, -0.3, 0.6, 0.3), False),  # across
    ((0.5, 0.0, 0.5, 0.0), False),  # a turn
    ((0.0, 0.0, 0.5, 0.8), True),
    ((0.0, 0.0, 0.5, 0.9), False),  # 61 degrees
])  # fmt: skip
def test_which_links_lead_ahead(
    link: tuple[float, float, float, float], counts: bool, turn: float
) -> None:
    c, s = math.cos(turn), math.sin(turn)
    poses = np.array([
        (7.0 + c * x - s * y, -3.0 + s * x + c * y, 0.0) for x, y in (link[:2], link[2:])
    ])  # fmt: skip
    found = leading_ahead(poses, np.array([(0, 1)]), 7.0, -3.0, c, s, 1.0)
    assert found.tolist() == [0] * counts


# What is left


def test_parts_of_a_map_that_fell_apart_stay_where_they_are() -> None:
    graph = corridor()
    before = graph.poses
    stand_before(graph, 4)
    for _ in range(4):
        graph.report_blocked(WALL, 0.0)
    assert len(set(parts(pairs(graph), len(graph)))) > 1
    for _ in range(3):
        graph.settle()
        graph.apply(MapAction('none', 4, 4, 4, 0.0, Place(4.0, 0.0, 0.0)))
    assert np.abs(graph.poses - before).max() < 1e-9


def test_a_part_with_a_loop_that_does_not_fit_keeps_its_lowest_experience() -> None:
    graph = new_map()
    go(graph, 0)
    for n in range(1, 13):
        graph.integrate(ahead(1.0, 1.0))
        graph.integrate(turning(2 * math.pi / 8 + 0.05 if n > 4 else 0.0, 0.0))
        go(graph, n if n < 12 else 4)
    before = graph.poses
    stand_before(graph, 2)
    graph.integrate(ahead(0.2))
    while not graph.report_blocked(WALL, 0.0):
        pass
    part = parts(pairs(graph), len(graph))
    assert part[11] == part[4] == 4
    graph.settle()
    assert graph.poses[[0, 4]].tolist() == before[[0, 4]].tolist()
    assert np.abs(graph.poses - before).max() < 0.5


def exercised(graph: ExperienceMap, rng: random.Random, steps: int) -> None:
    for _ in range(steps):
        graph.integrate(Motion(0.3, rng.uniform(0.2, 1.0), rng.uniform(-1.0, 1.0)))
        if rng.random() < 0.1:
            graph.report_blocked(WALL, rng.uniform(-3.0, 3.0))
            continue
        new = len(graph) < 25 or rng.random() < 0.1
        target = len(graph) if new else rng.randrange(25)
        if target != graph.current_id:
            go(graph, target, rng.choice([WALL, 'turn', '']))


@pytest.mark.parametrize('seed', range(4))
def test_who_is_restored_goes_on_to_the_last_bit(seed: int) -> None:
    rng = random.Random(seed)
    changes = {'exp_min_tries': 2, 'exp_confidence_threshold': 0.4, 'exp_try_radius_m': 2.0}
    graph = new_map(**changes)
    exercised(graph, rng, 400)
    assert graph.rebuilt > 5
    state = graph.state()
    arrays = {key: value for key, value in state.items() if isinstance(value, np.ndarray)}
    rest = {key: value for key, value in state.items() if key not in arrays}
    other = new_map(**changes)
    other.restore({**json.loads(json.dumps(rest)), **arrays})
    after = rng.getstate()
    for one in (graph, other):
        rng.setstate(after)
        exercised(one, rng, 200)
    assert encode_map(1, graph) == encode_map(1, other)
    assert np.array_equal(graph.state()['failures'], other.state()['failures'])


@pytest.mark.parametrize('seed', range(3))
def test_rows_texts_and_routes_follow_links_that_vanish(seed: int) -> None:
    rng = random.Random(seed)
    graph = new_map(exp_min_tries=2, exp_confidence_threshold=0.4, exp_try_radius_m=2.0)
    exercised(graph, rng, 60)
    kept, planner = MapText(), RoutePlanner(GoalRecallParameters(), graph)
    tree = GoalTree(planner, 3)
    for _ in range(60):
        exercised(graph, rng, 5)
        assert encode_map(1, graph, kept) == encode_map(1, graph)
        for row, link in enumerate(graph.links()):
            assert graph._links.row(link.source_id, link.target_id) == row
        fresh = planner.temporal_map(3).arrival_s
        for start in range(len(graph)):
            assert math.isfinite(tree.remaining_s(start)) == math.isfinite(fresh[start])
        if tree.exact():
            assert tree.remaining_s(7) == pytest.approx(float(fresh[7]))
    assert graph.rebuilt > 5


# Neighbours


def test_neighbours_are_one_link_away_in_either_direction() -> None:
    graph = corridor()
    assert graph.neighbours(4) == [3, 5]
    assert graph.neighbours(0) == [1, 21]
    with pytest.raises(NotLinked, match='no experience 22; expected 0 to 21'):
        graph.neighbours(22)


def test_distance_and_direction_count_from_where_the_robot_is() -> None:
    graph = new_map()
    go(graph, 0)
    graph.integrate(ahead(2.0))
    graph.integrate(turning(math.pi / 2))
    go(graph, 1)
    graph.integrate(ahead(1.0))
    distance, direction = graph.distance_and_direction(0)  # behind to the left
    assert distance == pytest.approx(math.sqrt(5.0))
    assert direction == pytest.approx(math.pi - math.atan2(2.0, 1.0))
    graph.integrate(turning(math.pi / 2))
    assert graph.distance_and_direction(0).direction_rad == pytest.approx(math.atan2(1.0, 2.0))
    # The way back is told otherwise, by a longer link: the shorter one counts.
    graph.integrate(ahead(9.0))
    go(graph, 0)
    graph.integrate(ahead(0.5))
    there = graph.distance_and_direction(1)
    assert there.distance_m == pytest.approx(1.5)
    assert there.direction_rad == pytest.approx(0.0)
    go(graph, 2)
    with pytest.raises(NotLinked, match=r'experience 1 and the current one, 2; .* are 0'):
        graph.distance_and_direction(1)
    with pytest.raises(NotLinked, match='neighbours are none'):
        new_map().distance_and_direction(0)
