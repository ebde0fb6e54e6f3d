# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Link learning: failing links are unlearned and learned again; alternating links are kept."""

from __future__ import annotations

import math
import random
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from graphs import arrive, go, new_map, set_current
from helpers import ahead, turning
from hypothesis import given, settings
from hypothesis import strategies as st
from route_maps import remaining_s
from states import filed

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping import link_learning
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.link_learning import (
    DETOUR_RATIO,
    LEAST_AHEAD_M,
    leading_ahead,
    link_confidences,
)
from ratslam_ros.core.navigation.goal_tree import GoalTree
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.errors import UnreachableGoal, UnusableInput
from ratslam_ros.messages.mapping import encode_map

WALL = 'left_wall'


def step(graph: ExperienceMap, target: int, behaviour: str = WALL) -> None:
    """Drive 0.3 m in 1 s, and make a transition."""
    go(graph, target, ahead(0.3, 1.0), behaviour=behaviour)


def confidence(graph: ExperienceMap, source: int, target: int) -> float:
    """Return the confidence of a link; 1 without a behaviour, as no failures count then."""
    links = graph.link_table
    row = links.row(source, target)
    assert row is not None
    return float(link_confidences(links)[row]) if links.behaviour_of(row) else 1.0


def link_pairs(graph: ExperienceMap) -> set[tuple[int, int]]:
    """Return source and target of each link."""
    return {(link.source_id, link.target_id) for link in graph.links()}


def components(graph: ExperienceMap) -> list[int]:
    """Return the lowest id of the connected component of each experience."""
    lowest = list(range(len(graph)))
    for _ in range(len(graph)):
        for i, j in link_pairs(graph):
            lowest[i] = lowest[j] = min(lowest[i], lowest[j])
    return lowest


# Transitions to other experiences


class Reference:
    """Reference implementation with dictionaries.

    Milford, Wyeth and Prasser (2006), section III.D, and the condition of a short detour.
    """

    def __init__(self, p: ExperienceMapParameters) -> None:
        self.p = p
        self.links: dict[tuple[int, int], list[Any]] = {}  # behaviour, count, elsewhere

    def attempts(self, i: int, behaviour: str) -> int:
        return sum(
            count for (a, _), (name, count, _) in self.links.items()
            if a == i and name == behaviour
        )

    def transition(self, i: int, j: int, behaviour: str) -> None:
        name, count, _ = self.links.get((i, j), ['', 0, 0])
        self.links[i, j] = [behaviour or name, count + 1, 0]
        if not behaviour:
            return
        for (a, b), link in self.links.items():
            link[2] += a == i and b != j and link[0] == behaviour
        while True:
            candidates = [
                (link[1] / self.attempts(i, behaviour), order, key)
                for order, (key, link) in enumerate(self.links.items())
                if key[0] == i and link[0] == behaviour and link[2] >= link_learning.MIN_TRIES
                and link[1] / self.attempts(i, behaviour) < self.p.exp_confidence_threshold
                and self.has_detour(*key)
            ]
            if not candidates:
                return
            del self.links[min(candidates)[2]]

    def has_detour(self, i: int, j: int) -> bool:
        """Search breadth-first; all links have the same duration."""
        steps, queue = {i: 0}, deque([i])
        while queue:
            current = queue.popleft()
            for a, b in self.links:
                for near, far in ((a, b), (b, a)):
                    if near == current and (a, b) != (i, j) and far not in steps:
                        steps[far] = steps[current] + 1
                        queue.append(far)
        return steps.get(j, DETOUR_RATIO + 1) <= DETOUR_RATIO


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 10**6), st.integers(2, 6), st.sampled_from([0.0, 0.1, 0.25, 0.6]),
    st.integers(1, 10),
)
def test_least_confident_links_are_unlearned_by_equation_9(
    seed: int, count: int, threshold: float, min_tries: int
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(link_learning, 'MIN_TRIES', min_tries)
        check_equation_9(seed, count, threshold)


def check_equation_9(seed: int, count: int, threshold: float) -> None:
    rng = random.Random(seed)
    graph = new_map(exp_loops=0, exp_confidence_threshold=threshold)
    reference = Reference(ExperienceMapParameters(exp_confidence_threshold=threshold))
    for target in range(count):
        step(graph, target, '')
        if target:
            reference.transition(target - 1, target, '')
    unlearned = 0
    for _ in range(80):
        i, j = graph.current_id, rng.choices(range(count), range(1, count + 1))[0]
        if i == j:
            continue
        behaviour = rng.choice(['', WALL, WALL, 'centreline'])
        before = len(reference.links)
        step(graph, j, behaviour)
        reference.transition(i, j, behaviour)
        unlearned += len(reference.links) < before
        links = graph.links()
        assert {(k.source_id, k.target_id): [k.behaviour, k.count] for k in links} == {
            key: link[:2] for key, link in reference.links.items()
        }
        for k in links:
            attempts = reference.attempts(k.source_id, k.behaviour)
            expected = k.count / attempts if k.behaviour else 1.0
            assert confidence(graph, k.source_id, k.target_id) == expected
    assert threshold > 0.0 or unlearned == 0
    assert set(components(graph)) == {0}


def test_equation_9_as_printed_unlearns_without_further_conditions() -> None:
    """1 of 4 attempts is not below 0.25; 1 of 5 is."""
    graph = new_map(exp_unlearning='equation', exp_confidence_threshold=0.25)
    for target in (0, 1, 0, 2):
        step(graph, target)
    for attempts in (3, 4, 5):
        set_current(graph, 0)
        step(graph, 1)
        assert ((0, 2) in link_pairs(graph)) == (attempts < 5)
        graph.unlearn_blocked(WALL, 0.0)
    assert (0, 1) in link_pairs(graph)


@pytest.mark.parametrize('successors', [2, 7])
def test_alternating_successors_are_all_kept(successors: int) -> None:
    """Several experiences represent one place, and the recognised one varies."""
    graph = new_map()
    for target in range(successors + 2):
        step(graph, target, '')
    for n in range(40 * successors):
        for target in (0, 1 + n % successors, successors + 1):
            step(graph, target)
    assert {(0, 1 + n) for n in range(successors)} <= link_pairs(graph)
    assert graph.link_table.deletion_count == 0


def test_branch_without_detour_is_kept_despite_low_confidence() -> None:
    """A branch that was explored once, beside a corridor that was driven a hundred times."""
    graph = new_map()
    for target in (0, 1, 0, 2, 3):
        step(graph, target)
    set_current(graph, 0)
    for target in (0, 1) * 100:
        step(graph, target)
    assert confidence(graph, 0, 2) < 0.02
    assert (0, 2) in link_pairs(graph)
    set_current(graph, 3)
    step(graph, 1)  # closes a detour
    for target in (0, 1) * 2:
        step(graph, target)
    assert (0, 2) not in link_pairs(graph)


# Time-outs


def corridor(laps: int = 1, **changes: Any) -> ExperienceMap:
    """Drive along x and back with an experience every 0.5 m; end at experience 0.

    Experiences 0 to 10 face along x, and 11 to 21 face back: 10 + n lies where 11 - n does.
    """
    graph = new_map(**changes)
    arrive(graph, 0, behaviour=WALL)
    for _ in range(laps):
        drive_to(graph, 22)
        graph.integrate(turning(math.pi, 1.0))
        arrive(graph, 0, behaviour=WALL)
    return graph


def drive_to(graph: ExperienceMap, end: int) -> None:
    """Drive along the corridor from the current experience up to the one before ``end``."""
    for target in range(graph.current_id + 1, end):
        graph.integrate(turning(math.pi, 1.0) if target == 11 else ahead(0.5, 1.0))
        arrive(graph, target, behaviour=WALL)


def test_blocked_links_are_unlearned_and_learned_again() -> None:
    graph = corridor()
    planner = RoutePlanner(GoalRecallParameters(), graph)
    goal = 8
    set_current(graph, 4)  # at x = 2
    tree = GoalTree(planner, goal)
    assert planner.route_to(goal).experience_ids == (4, 5, 6, 7, 8)
    attempts = [graph.unlearn_blocked(WALL, 0.0) for _ in range(4)]
    assert attempts[:3] == [0, 0, 0]
    # From x = 2 to 2.5, 2.5 to 3 and 3 to 3.5 m, in both directions: they pass within 1 m.
    assert attempts[3] == 6
    blocked = {(4, 5), (5, 6), (6, 7), (15, 16), (16, 17), (14, 15)}
    assert not blocked & link_pairs(graph)
    assert graph.link_count == 22 - 6
    around = planner.temporal_map()
    with pytest.raises(UnreachableGoal):
        around.route_to(goal)
    # There is no other way, so the blocked one is tried again, until that has failed.
    assert planner.route_to(goal).experience_ids == (4, 5, 6, 7, 8)
    assert math.isinf(remaining_s(tree))
    drive_to(graph, 8)  # the obstacle has been removed
    assert {(4, 5), (5, 6), (6, 7)} <= link_pairs(graph)
    set_current(graph, 4)
    assert planner.route_to(goal).experience_ids == (4, 5, 6, 7, 8)
    assert tree.route().experience_ids == (4, 5, 6, 7, 8)


def test_time_outs_needed_are_limited_by_recent_tries() -> None:
    needed = {}
    for laps in (1, 2, 3, 20):
        graph = corridor(laps)
        set_current(graph, 4)
        needed[laps] = next(n for n in range(1, 50) if graph.unlearn_blocked(WALL, 0.0))
    assert needed == {1: 4, 2: 7, 3: 10, 20: 10}


def test_successful_transition_resets_its_time_outs() -> None:
    graph = corridor()
    for made in range(1, 6):  # a person blocks the corridor temporarily
        set_current(graph, 4)
        assert sum(graph.unlearn_blocked(WALL, 0.0) for _ in range(3)) == 0
        assert confidence(graph, 4, 5) == made / (made + 3)
        drive_to(graph, 22)
        assert confidence(graph, 4, 5) == 1.0
    assert graph.link_table.deletion_count == 0


def test_threshold_of_zero_disables_unlearning() -> None:
    graph = corridor(exp_confidence_threshold=0.0)
    set_current(graph, 4)
    assert sum(graph.unlearn_blocked(WALL, 0.0) for _ in range(100)) == 0


def test_time_outs_without_behaviour_or_mapping_are_ignored() -> None:
    assert new_map().unlearn_blocked(WALL, 0.0) == 0
    graph = corridor()
    set_current(graph, 4)
    assert sum(graph.unlearn_blocked('', 0.0) for _ in range(20)) == 0
    graph.mapping = False
    assert sum(graph.unlearn_blocked(WALL, 0.0) for _ in range(20)) == 0
    with pytest.raises(UnusableInput, match='finite'):
        graph.unlearn_blocked(WALL, math.nan)
    assert not graph.state()['failures'].any()


@pytest.mark.parametrize('turn', [0.0, 1.0, -2.5])
@pytest.mark.parametrize(('link', 'counts'), [
    ((0.0, 0.0, 0.5, 0.0), True),
    ((0.5, 0.0, 0.0, 0.0), True),  # in the opposite direction
    ((-2.0, 0.0, 3.0, 0.0), True),  # a long link that passes the robot, as after pruning
    ((0.9, 0.0, 2.0, 0.0), True),
    ((1.1, 0.0, 2.0, 0.0), False),  # too far
    ((-0.5, 0.0, 0.0, 0.0), False),  # behind
    ((0.0, 0.0, LEAST_AHEAD_M - 0.01, 0.0), False),  # the far end was practically reached
    ((0.0, 0.5, 0.4, 0.9), False),  # to the side
    ((0.5, -0.3, 0.6, 0.3), False),  # across
    ((0.5, 0.0, 0.5, 0.0), False),  # a turn in place
    ((0.0, 0.0, 0.5, 0.8), True),
    ((0.0, 0.0, 0.5, 0.9), False),  # 61 degrees
])
def test_leading_ahead_selects_links_by_distance_and_direction(
    link: tuple[float, float, float, float], counts: bool, turn: float
) -> None:
    c, s = math.cos(turn), math.sin(turn)
    poses = np.array([
        (7.0 + c * x - s * y, -3.0 + s * x + c * y, 0.0) for x, y in (link[:2], link[2:])
    ])
    found = leading_ahead(poses, np.array([(0, 1)]), 7.0, -3.0, c, s, 1.0)
    assert found.tolist() == [0] * counts


# The remaining map


def test_inconsistent_component_keeps_its_lowest_experience() -> None:
    graph = new_map()
    arrive(graph, 0, behaviour=WALL)
    for n in range(1, 13):
        graph.integrate(ahead(1.0, 1.0))
        graph.integrate(turning(2 * math.pi / 8 + 0.05 if n > 4 else 0.0, 0.0))
        arrive(graph, n if n < 12 else 4, behaviour=WALL)
    before = graph.poses
    set_current(graph, 2)
    graph.integrate(ahead(0.2))
    while not graph.unlearn_blocked(WALL, 0.0):
        pass
    lowest = components(graph)
    assert lowest[11] == lowest[4] == 4
    graph.settle()
    assert np.abs(graph.poses - before)[[0, 4]].max() < 1e-6
    assert np.abs(graph.poses - before).max() < 0.5


def drive_randomly(graph: ExperienceMap, rng: random.Random, steps: int) -> None:
    """Make random transitions between up to 25 known and some new experiences, and time out."""
    for _ in range(steps):
        graph.integrate(Motion(0.3, rng.uniform(0.2, 1.0), rng.uniform(-1.0, 1.0)))
        if rng.random() < 0.1:
            graph.unlearn_blocked(WALL, rng.uniform(-3.0, 3.0))
            continue
        new = len(graph) < 25 or rng.random() < 0.1
        target = len(graph) if new else rng.randrange(25)
        if target != graph.current_id:
            arrive(graph, target, behaviour=rng.choice([WALL, 'turn', '']))


@pytest.mark.parametrize('seed', range(2))
def test_restored_map_continues_bit_identically(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_learning, 'MIN_TRIES', 2)
    rng = random.Random(seed)
    changes = {'exp_confidence_threshold': 0.4, 'exp_try_radius_m': 2.0}
    graph = new_map(**changes)
    drive_randomly(graph, rng, 400)
    assert graph.link_table.deletion_count > 5
    other = new_map(**changes)
    other.restore(filed({'experience_map': graph.state()}, tmp_path)['experience_map'])
    after = rng.getstate()
    for one in (graph, other):
        rng.setstate(after)
        drive_randomly(one, rng, 200)
    assert encode_map(1, graph) == encode_map(1, other)
    assert np.array_equal(graph.state()['failures'], other.state()['failures'])
