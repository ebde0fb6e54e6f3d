# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pruning at the maximum map size: the map stays connected and goals keep their places."""

from __future__ import annotations

import math
import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import ahead, extended, seen, turning
from hypothesis import given, settings
from hypothesis import strategies as st
from route_maps import is_exact, remaining_s
from states import filed

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters, MemoryParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.late_join import LateJoin
from ratslam_ros.core.navigation.goal_tree import GoalTree
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.pruning import (
    MAX_GAP_M,
    RECENT_VISITS_COUNT,
    DistanceGraph,
    VisitHistory,
)
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.messages.json_schema import decode, encode
from ratslam_ros.messages.mapping import ActionPayload, encode_map

# Selection


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.integers(RECENT_VISITS_COUNT + 2, 90), st.floats(0.0, 1.0))
def test_prune_candidate_is_least_visited_then_oldest(
    seed: int, count: int, revisits: float
) -> None:
    rng = random.Random(seed)
    visits, log = VisitHistory(), [(i, True) for i in range(count)]
    for i in range(count):
        visits.create(i)
    for _ in range(60):
        if rng.random() < revisits:
            i = rng.randrange(count)
            visits.visit(i)
            log.append((i, False))
            continue
        last = {i: n for n, (i, _) in enumerate(log)}
        times = {
            i: sum(j == i for j, _ in log[max(n for n, it in enumerate(log) if it == (i, True)):])
            for i in last
        }
        may_go = [i for i in last if i != 0 and last[i] < len(log) - RECENT_VISITS_COUNT]
        expected = min(may_go, key=lambda i: (times[i], last[i]))
        assert visits.prune_candidate(visits.may_go(DistanceGraph())) == expected
        visits.create(expected)
        log.append((expected, True))
    other = VisitHistory()
    other.restore(visits.state())
    for one in (visits, other):
        one.create(count)
    candidates = [one.prune_candidate(one.may_go(DistanceGraph())) for one in (other, visits)]
    assert candidates[0] == candidates[1]


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.integers(3, 40))
def test_gaps_equal_distances_of_reconnected_neighbours(seed: int, count: int) -> None:
    rng = random.Random(seed)
    distances, expected = DistanceGraph(), dict[frozenset[int], float]()

    def around(middle: int) -> dict[int, float]:
        return {
            next(iter(ends - {middle})): distance_m
            for ends, distance_m in expected.items()
            if middle in ends
        }

    for _ in range(4 * count):
        a, b = rng.randrange(count), rng.randrange(-1, count)
        if rng.random() < 0.8:
            distance_m = rng.uniform(0.1, 2.0)
            distances.connect(a, b, distance_m)
            if a != b and b >= 0:
                ends = frozenset((a, b))
                expected[ends] = min(distance_m, expected.get(ends, distance_m))
        else:
            distances.remove(a)
            others = sorted(around(a).items(), key=lambda it: it[1])
            for ends in [ends for ends in expected if a in ends]:
                del expected[ends]
            for other, distance_m in others[1:]:
                ends = frozenset((others[0][0], other))
                expected[ends] = min(others[0][1] + distance_m, expected.get(ends, math.inf))
    lengths = [sorted(around(i).values()) for i in range(count)]
    gaps_m = [sum(length[:1]) + sum(length[-1:]) for length in lengths]
    restored = DistanceGraph()
    restored.restore(distances.state())
    for one in (distances, restored):
        assert one.gaps_after_removal_m(count).tolist() == pytest.approx(gaps_m)


def test_experience_leaving_long_gap_is_pruned_last() -> None:
    visits, distances = VisitHistory(), DistanceGraph()
    for i in range(40):
        visits.create(i)
        distances.connect(i - 1, i, 0.4 * MAX_GAP_M if i < 30 else 3.0 * MAX_GAP_M)
    gone = []
    for _ in range(14):
        gone.append(visits.prune_candidate(visits.may_go(distances)))
        distances.remove(gone[-1])
        visits.create(gone[-1])
        distances.connect(gone[-1], 39, 3.0 * MAX_GAP_M)
    assert gone == list(range(1, 29, 2))
    # Every candidate exceeds MAX_GAP_M: 28 leaves 1.2 and 2 leaves 1.6 times MAX_GAP_M, which is
    # within GAP_RATIO of the smallest.
    assert visits.prune_candidate(visits.may_go(distances)) == 2


@pytest.mark.parametrize('spacing_m', [0.4, 1.4])
def test_dead_end_driven_both_ways_is_not_shortened(spacing_m: float) -> None:
    visits, distances = VisitHistory(), DistanceGraph()
    route = [*range(30), *range(28, 19, -1), *range(30, 70)]  # into a room, out, and on
    for before, i in zip([-1, *route], route, strict=False):
        if i < len(visits.state()['counts']):
            visits.visit(i)
        else:
            visits.create(i)
        distances.connect(before, i, spacing_m)
    gone = []
    for new in range(70, 90):
        gone.append(visits.prune_candidate(visits.may_go(distances)))
        distances.remove(gone[-1])
        visits.create(gone[-1])
        distances.connect(new - 1 if new == 70 else gone[-2], gone[-1], spacing_m)
    # Experiences in the room were visited twice, except at its end.
    assert not set(gone) & set(range(20, 29))


def test_often_visited_experiences_stay_on_sparse_map() -> None:
    visits, distances = VisitHistory(), DistanceGraph()
    for i in range(12):
        visits.create(i)
    for _ in range(50):
        for i in range(12):
            distances.connect((i - 1) % 12, i, 4.9)
            visits.visit(i)
    for i in range(12, 60):
        visits.create(i)
        distances.connect(i - 1, i, 5.0)
    for _ in range(15):
        gone = visits.prune_candidate(visits.may_go(distances))
        assert gone >= 12
        distances.remove(gone)
        visits.create(gone)
        distances.connect(59, gone, 5.0)


def test_too_small_limit_is_rejected() -> None:
    extended('pose_cells', exp_max=20)
    with pytest.raises(UnusableParameter, match='exp_max is 19; expected 0'):
        extended('pose_cells', exp_max=19)


# Pose cells

LIMIT = 30
Done = tuple[Motion, MapAction]


def limited(policy: str = 'visits') -> PoseCells:
    return PoseCells(
        extended(
            'pose_cells', exp_max=LIMIT, exp_delta_pc_threshold=1.0, exp_forget=policy,
        ),
        memory=MemoryParameters(forget_after_s=5.0),
    )


def wander(
    pose_cells: PoseCells, rng: random.Random, steps: int, first_ns: int = 0
) -> list[Done]:
    """Drive at random in a world of few views, in which most places are new nevertheless."""
    done = []
    for step in range(steps):
        motion = Motion(0.5, rng.uniform(0.2, 1.5), rng.uniform(-0.6, 0.6))
        pose_cells.integrate(motion)
        match = seen(rng.randrange(25))
        done.append((motion, pose_cells.view(match, stamp_ns=first_ns + step * 500_000_000)))
    return done


def apply(graph: ExperienceMap, done: list[Done]) -> None:
    for motion, action in done:
        graph.integrate(motion)
        graph.apply(action)


def new_map(**changes: Any) -> ExperienceMap:
    return ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0, **changes))


@pytest.mark.parametrize('policy', ['visits', 'freshness'])
def test_long_drive_never_exceeds_limit(policy: str) -> None:
    rng = random.Random(1)
    pose_cells, graph = limited(policy), new_map()
    replaced = 0
    for motion, action in wander(pose_cells, rng, 300):
        known, before = len(graph), graph.labels[:]
        graph.integrate(motion)
        graph.apply(action)
        assert action.source_id < LIMIT
        assert 0 <= action.target_id < LIMIT
        if action.action == 'create' and known == LIMIT:
            replaced += 1
            assert action.target_id not in (0, action.source_id)
        elif action.action == 'create':
            assert action.target_id == known
        else:  # pose cells and map must agree on the meaning of an id
            assert before[action.target_id] == (
                action.template_id if action.action != 'none' else before[action.target_id][0],
                action.place,
            )
        assert graph.labels[action.target_id][1] == action.place
    assert replaced > 60
    assert len(graph) == len(pose_cells) == LIMIT
    assert connected(graph)
    # A pruned experience is removed from every index.
    state = pose_cells.state()
    known = {i for pair in state['transitions'] for i in pair}
    assert known <= {-1, *range(LIMIT)}
    of_template = pose_cells._experiences._of_template
    assert sorted(i for ids in of_template.values() for i in ids) == [*range(LIMIT)]
    assert all(of_template.values())


def test_route_driven_once_is_pruned_evenly() -> None:
    """Drive a spiral of new views, 132 m long; no part of it may be removed completely."""
    limit, longest_m = 75, 2.4
    pose_cells, graph = PoseCells(extended('pose_cells', exp_max=limit)), new_map(exp_loops=0)
    for view in range(330):
        for one in (pose_cells, graph):
            one.integrate(turning(0.02))
            one.integrate(ahead(0.4))
        graph.apply(pose_cells.view(seen(view)))
    assert len(graph) == limit
    assert max(link.distance_m for link in graph.links()) <= longest_m
    places = graph.poses[:, :2]
    at = Pose(0.0, 0.0, 0.0)
    for _ in range(330):
        at = moved(moved(at, turning(0.02)), ahead(0.4))
        assert np.hypot(*(places - at[:2]).T).min() < longest_m / 2 + 0.2


def test_memory_saved_without_limit_is_pruned_evenly(tmp_path: Path) -> None:
    free, graph = PoseCells(extended('pose_cells')), new_map(exp_loops=0)
    pose_cells = PoseCells(extended('pose_cells', exp_max=150))
    for view in range(330):
        one = free if view < 150 else pose_cells
        if view == 150:
            assert len(free) == 150
            one.restore(filed({'pose_cells': free.state()}, tmp_path)['pose_cells'])
        for part in (one, graph):
            part.integrate(turning(0.02))
            part.integrate(ahead(0.4))
        graph.apply(one.view(seen(view)))
    assert len(graph) == 150
    assert max(link.distance_m for link in graph.links()) <= MAX_GAP_M + 0.1


@pytest.mark.parametrize('policy', ['visits', 'freshness'])
def test_restored_pose_cells_prune_identically(policy: str, tmp_path: Path) -> None:
    rng = random.Random(3)
    pose_cells = limited(policy)
    wander(pose_cells, rng, 150)
    other = limited(policy)
    other.restore(filed({'pose_cells': pose_cells.state()}, tmp_path)['pose_cells'])
    after = rng.getstate()
    actions = []
    for one in (pose_cells, other):
        rng.setstate(after)
        actions.append([action for _, action in wander(one, rng, 150, 75 * 10**9)])
    assert sum(a.action == 'create' for a in actions[1]) > 50
    assert {a.target_id for a in actions[1]} <= set(range(LIMIT))
    assert actions[0] == actions[1]


def test_visited_once_prunes_oldest_of_a_route_as_published() -> None:
    """Milford (2008): of those visited once, the one with the oldest time stamp, at any gap."""
    pose_cells = PoseCells(extended(
        'pose_cells', exp_max=30, exp_forget='visited_once', pc_vt_agree_views=0.0,
    ))
    for view in [*range(30), *range(100, 105)]:
        pose_cells.integrate(ahead(4.0))
        action = pose_cells.view(seen(view))
        if view >= 100:
            assert action.target_id == view - 99  # all but the first one, in the order of time
    templates = [template for template, *_ in pose_cells.state()['experiences']]
    assert sorted(templates) == [0, *range(6, 30), *range(100, 105)]


def test_freshness_keeps_recent_experiences_and_thins_old_ones() -> None:
    """Drive a spiral of new views, 264 m long, of which half can be kept."""
    p = extended('pose_cells', exp_max=330, exp_forget='freshness')
    pose_cells = PoseCells(p, memory=MemoryParameters(forget_after_s=100.0))
    for view in range(660):
        pose_cells.integrate(turning(0.01))
        pose_cells.integrate(ahead(0.4))
        pose_cells.view(seen(view), stamp_ns=view * 10**9)
    kept = np.array([template_id for template_id, *_ in pose_cells.state()['experiences']])
    assert len(kept) == 330
    assert np.isin(np.arange(560, 660), kept).all()
    for first in range(0, 540, 60):
        assert 20 <= np.count_nonzero((kept >= first) & (kept < first + 60)) < 40


def test_freshness_starts_with_a_memory_saved_by_visits() -> None:
    rng = random.Random(4)
    by_visits, by_freshness = limited(), limited('freshness')
    wander(by_visits, rng, 100)
    by_freshness.restore(by_visits.state())
    assert len(by_freshness) == LIMIT
    actions = [action for _, action in wander(by_freshness, rng, 100)]
    assert sum(action.action == 'create' for action in actions) > 20
    assert len(by_freshness) == LIMIT
    limited().restore(by_freshness.state())  # and back


# Experience map


def connected(graph: ExperienceMap) -> bool:
    """Return whether all experiences are connected by links of any direction."""
    reached, todo = {0}, [0]
    around: dict[int, set[int]] = {}
    for i, j in graph.link_ends.tolist():
        around.setdefault(i, set()).add(j)
        around.setdefault(j, set()).add(i)
    while todo:
        for other in around.get(todo.pop(), set()) - reached:
            reached.add(other)
            todo.append(other)
    return len(reached) == len(graph)


def prune_and_create(graph: ExperienceMap, pruned: int, serial: int) -> None:
    place = Place(float(serial), 0.0, 0.0)
    graph.apply(MapAction('create', graph.current_id, pruned, serial, 0.0, place))


def test_map_stays_connected_and_goals_stay_while_pruning() -> None:
    """Without relaxation, a goal keeps its position up to rounding errors."""
    rng = random.Random(0)
    graph = new_map(exp_loops=0)
    goals: dict[str, tuple[int, Pose]] = {}

    def on_forgotten(experience_id: int, stand_in_id: int, pose: Pose) -> None:
        assert stand_in_id in graph.neighbours(experience_id)
        for name, (at, offset) in goals.items():
            if at == experience_id:
                goals[name] = stand_in_id, composed(pose, offset)

    graph.on_pruned.append(on_forgotten)
    count = 60
    expected_poses: dict[str, Pose] = {}
    for serial in range(800):
        graph.integrate(Motion(0.5, rng.uniform(0.3, 1.0), rng.uniform(-0.8, 0.8)))
        current_id = graph.current_id
        if len(graph) < count:
            prune_and_create(graph, len(graph), serial)
        elif rng.random() < 0.6:
            gone = rng.choice([i for i in range(1, count) if i != current_id])
            before = len({frozenset(pair) for pair in graph.link_ends.tolist()})
            around = len(graph.neighbours(gone))
            prune_and_create(graph, gone, serial)
            after = len({frozenset(pair) for pair in graph.link_ends.tolist()})
            assert after <= before + 1 - (around > 0)  # one link per neighbour except the nearest
            assert graph.neighbours(gone) == [current_id] or current_id == gone
        else:
            target = rng.randrange(count)
            if target != current_id:
                label = graph.labels[target]
                graph.apply(MapAction('link', current_id, target, label[0], 0.0, label[1]))
        if serial % 100 == 70:
            name = f'goal {serial}'
            goals[name] = graph.current_id, Pose(0.3, -0.2, 0.1)
            expected_poses[name] = composed(graph.pose_of(graph.current_id), goals[name][1])
        if serial % 20 == 0:
            assert connected(graph)
    assert len(graph) == count
    for name, (at, offset) in goals.items():
        now = composed(graph.pose_of(at), offset)
        expected = expected_poses[name]
        assert math.hypot(now.x_m - expected.x_m, now.y_m - expected.y_m) < 1e-9
        assert abs(wrap(now.heading_rad - expected.heading_rad)) < 1e-9


def driven(steps: int, limit: int, rng: random.Random, **changes: Any) -> tuple[
    ExperienceMap, list[Pose]
]:
    """Drive at random with exact odometry, to new and known places; return the true poses too."""
    graph = new_map(**changes)
    truth, true = Pose(0.0, 0.0, 0.0), []
    for serial in range(steps):
        motion = Motion(0.5, rng.uniform(0.3, 1.0), rng.uniform(-1.5, 1.5))
        graph.integrate(motion)
        truth = moved(truth, motion)
        current_id, known = graph.current_id, len(graph)
        if known > 5 and rng.random() < 0.3:  # move to a known place with exact odometry
            target = rng.choice([i for i in range(known) if i != current_id])
            graph.offset = composed(
                Pose(*_inverse(true[current_id])), true[target]
            )
            label = graph.labels[target]
            graph.apply(MapAction('link', current_id, target, label[0], 0.0, label[1]))
            truth = true[target]
            continue
        if known < limit:
            gone = known
            true.append(truth)
        else:
            gone = rng.choice([i for i in range(1, known) if i != current_id])
            true[gone] = truth
        prune_and_create(graph, gone, serial)
    return graph, true


def _inverse(pose: Pose) -> tuple[float, float, float]:
    c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    return -c * pose.x_m - s * pose.y_m, s * pose.x_m - c * pose.y_m, -pose.heading_rad


def test_composed_links_agree_with_true_poses() -> None:
    """With exact odometry every link agrees with the true poses, even if composed repeatedly."""
    graph, true = driven(500, 40, random.Random(4))
    assert graph.link_count > 40
    for link in graph.links():
        end = composed(true[link.source_id], link.relative_pose)
        target = true[link.target_id]
        assert math.hypot(end.x_m - target.x_m, end.y_m - target.y_m) < 1e-8
        assert abs(wrap(end.heading_rad - target.heading_rad)) < 1e-8
        assert link.duration_s >= 0.5 - 1e-9
        assert link.count >= 1
    places = np.array(true)
    assert np.abs(graph.poses[:, :2] - places[:, :2]).max() < 1e-6


def test_pruning_connects_neighbours_through_nearest_and_keeps_links() -> None:
    graph = new_map()
    place = Place(0.0, 0.0, 0.0)
    graph.apply(MapAction('create', -1, 0, 0, 0.0, place))
    for target, distance in ((1, 3.0), (2, 1.0), (3, 2.0), (4, 4.0)):
        graph.apply(MapAction('set', -1, 0, 0, 0.0, place))
        graph.integrate(turning(0.7 * target))
        graph.integrate(ahead(distance, distance))
        graph.apply(MapAction('create', 0, target, target, 0.0, place))
    graph.apply(MapAction('set', -1, 2, 2, 0.0, place))
    graph.integrate(ahead(7.0, 0.5))
    graph.apply(MapAction('link', 2, 3, 3, 0.0, place))
    old = next(k for k in graph.links() if (k.source_id, k.target_id) == (2, 3))
    graph.integrate(ahead(1.0, 1.0))
    notified = []
    graph.on_pruned.append(lambda *arguments: notified.append(arguments))
    pruned = graph.apply(MapAction('create', 3, 0, 8, 0.0, place)).pruned
    links = {(k.source_id, k.target_id): k for k in graph.links()}
    assert set(links) == {(2, 1), (2, 3), (2, 4), (3, 0)}
    assert links[2, 3] == old
    assert links[2, 1].duration_s == pytest.approx(4.2)  # including 0.1 s per turn
    assert notified == [pruned]
    assert pruned is not None
    assert (pruned.experience_id, pruned.stand_in_id) == (0, 2)


def test_pruning_current_experience_continues_from_neighbour() -> None:
    """This occurs only after lost messages: the pose cells never prune the current experience."""
    graph = new_map()
    place = Place(0.0, 0.0, 0.0)
    for target in range(3):
        graph.integrate(ahead(1.0, 1.0))
        graph.apply(MapAction('create', target - 1, target, target, 0.0, place))
    graph.integrate(ahead(0.5, 0.5))
    graph.apply(MapAction('create', 2, 2, 7, 0.0, place))
    assert [(k.source_id, k.target_id) for k in graph.links()] == [(0, 1), (1, 2)]
    link = graph.links()[1]
    assert (link.distance_m, link.duration_s) == pytest.approx((1.5, 1.5))
    assert graph.pose_of(2).x_m == pytest.approx(3.5)
    alone = new_map()
    alone.apply(MapAction('create', -1, 0, 0, 0.0, place))
    alone.integrate(ahead(1.0))
    pruned = alone.apply(MapAction('create', 0, 0, 1, 0.0, place)).pruned
    assert pruned == (0, -1, Pose(0.0, 0.0, 0.0))
    assert (alone.link_count, alone.pose_of(0).x_m) == (0, 1.0)


def test_routes_and_memories_follow_pruning(tmp_path: Path) -> None:
    rng = random.Random(0)
    pose_cells, graph = limited(), new_map()
    planner = RoutePlanner(GoalRecallParameters(), graph)
    apply(graph, wander(pose_cells, rng, 60))
    tree = GoalTree(planner, 0)
    for _ in range(60):
        apply(graph, wander(pose_cells, rng, 4))
        times = planner.temporal_map(0).arrival_s
        assert np.isfinite(times).all()
        if is_exact(tree):
            assert [remaining_s(tree, i) for i in range(len(graph))] == pytest.approx(
                times.tolist()
            )
    other = new_map()
    other.restore(filed({'experience_map': graph.state()}, tmp_path)['experience_map'])
    more = wander(pose_cells, rng, 200)
    for one in (graph, other):
        apply(one, more)
    assert encode_map(1, other) == encode_map(1, graph)


# Messages

MEMORY_NS = 7


def deliver(
    graph: ExperienceMap, joining: LateJoin, action: MapAction, sequence: int,
    memory_ns: int = MEMORY_NS,
) -> None:
    translated = joining.translate(action, sequence, memory_ns)
    if translated is not None:
        graph.apply(translated)


def through_messages(
    graph: ExperienceMap, done: list[Done], lost: frozenset[int] = frozenset()
) -> LateJoin:
    joining = LateJoin(graph)
    for sequence, (motion, action) in enumerate(done):
        graph.integrate(motion)
        if sequence not in lost:
            payload = ActionPayload.of(sequence, sequence, action, MEMORY_NS)
            sent = decode(ActionPayload, encode(payload))
            deliver(graph, joining, sent.change, sent.sequence, sent.memory)
    return joining


def test_map_built_from_messages_is_identical() -> None:
    done = wander(limited(), random.Random(5), 300)
    direct, from_messages = new_map(), new_map()
    apply(direct, done)
    joining = through_messages(from_messages, done)
    assert encode_map(1, direct) == encode_map(1, from_messages)
    assert (joining.missed, joining.restarts) == (0, 0)


def test_lost_messages_never_mix_two_places_under_one_id() -> None:
    """The map detects an unnoticed replacement by template and place of the action."""
    rng = random.Random(0)
    done = wander(limited(), rng, 300)
    lost = frozenset(n for n in range(300) if rng.random() < 0.2)
    graph = new_map()
    through_messages(graph, done, lost)
    assert LIMIT - 3 <= len(graph) <= LIMIT  # an id may be missing if its create action was lost
    own = LateJoin(checked := new_map())
    for sequence, (motion, action) in enumerate(done):
        checked.integrate(motion)
        if sequence in lost:
            continue
        deliver(checked, own, action, sequence)
        if action.action != 'none':
            assert checked.labels[checked.current_id] == (action.template_id, action.place)


def test_localisation_only_does_not_replace_pruned_experience() -> None:
    done = wander(limited(), random.Random(6), 200)
    graph = new_map()
    joining = through_messages(graph, done)
    graph.mapping = False
    before = encode_map(1, graph), graph.current_id
    _, action = done[-1]
    other = replace(action, action='link', target_id=5, template_id=99, place=Place(1.0, 1.0, 1.0))
    deliver(graph, joining, other, 200)
    assert (encode_map(1, graph), graph.current_id) == before
