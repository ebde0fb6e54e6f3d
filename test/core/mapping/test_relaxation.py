# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relaxation ends where equation (7) of seed 000 is zero: the least squares of dense NumPy."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import restored
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping import relaxation
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.relaxation import Relaxation
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place

Reals = NDArray[np.float64]
HERE = Place(0.0, 0.0, 0.0)


def errors(poses: Reals, ends: NDArray[np.int64], shapes: Reals) -> Reals:
    """Return (links, 3) how far each target is from where its link says."""
    i, j = ends.T
    direction = poses[i, 2] + shapes[:, 1]
    x = poses[j, 0] - poses[i, 0] - shapes[:, 0] * np.cos(direction)
    y = poses[j, 1] - poses[i, 1] - shapes[:, 0] * np.sin(direction)
    turn = [wrap(float(a)) for a in poses[j, 2] - poses[i, 2] - shapes[:, 2]]
    return np.stack([x, y, turn], 1)


def incidence(ends: NDArray[np.int64], count: int) -> Reals:
    out = np.zeros((len(ends), count))
    for row, (i, j) in enumerate(ends):
        out[row, j] += 1.0
        out[row, i] -= 1.0
    return out


def dense_fixed_point(poses: Reals, ends: NDArray[np.int64], shapes: Reals) -> Reals:
    """Headings first, unwrapped as the poses have them, then positions: least squares by SVD.

    Of each connected part the lowest id is held: in a part's least squares only that is free.
    """
    poses = poses.copy()
    count = len(poses)
    part = np.arange(count)
    for _ in range(count):
        for i, j in ends:
            part[i] = part[j] = min(part[i], part[j])
    free = part != np.arange(count)
    a = incidence(ends, count)[:, free]
    for columns in ([2], [0, 1]):
        e = errors(poses, ends, shapes)[:, columns]
        poses[np.ix_(free, columns)] -= np.linalg.lstsq(a, e, rcond=None)[0]
    return poses


def random_graph(seed: int, count: int, extra: int) -> tuple[Reals, NDArray[np.int64], Reals]:
    """Return poses off their places, and noisy links: a chain, some crossings, some twice."""
    rng = np.random.default_rng(seed)
    true = np.c_[rng.normal(size=(count, 2)).cumsum(0), rng.uniform(-math.pi, math.pi, count)]
    chain = [(i, i + 1) for i in range(count - 1) if rng.random() < 0.95]
    more = [tuple(pair) for pair in rng.integers(0, count, (extra, 2)) if pair[0] != pair[1]]
    back = [(j, i) for i, j in chain[::7]]
    ends = np.array([*chain, *more, *back], np.int64).reshape(-1, 2)
    i, j = ends.T
    d = true[j, :2] - true[i, :2] + rng.normal(scale=0.05, size=(len(ends), 2))
    heading = np.arctan2(d[:, 1], d[:, 0]) - true[i, 2]
    facing = true[j, 2] - true[i, 2] + rng.normal(scale=0.05, size=len(ends))
    shapes = np.stack([np.hypot(*d.T), heading, facing], 1)
    poses = true + rng.normal(scale=0.2, size=true.shape)
    poses[:, 2] = [wrap(float(a)) for a in poses[:, 2]]
    return poses, ends, shapes


def apart(a: Reals, b: Reals) -> float:
    turn = np.array([wrap(float(t)) for t in (a - b)[:, 2]])
    return float(max(np.abs((a - b)[:, :2]).max(), np.abs(turn).max()))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 30), st.integers(0, 60), st.sampled_from([0, 2, 8]))
def test_the_fixed_point_is_that_of_dense_least_squares(
    seed: int, count: int, extra: int, mesh: int
) -> None:
    """Several parts, links in both directions and in parallel; meshes from none to all."""
    poses, ends, shapes = random_graph(seed, count, extra)
    expected = dense_fixed_point(poses, ends, shapes)
    before, relaxation.MAX_DEGREE = relaxation.MAX_DEGREE, mesh
    try:
        plan = Relaxation(ends, count)
    finally:
        relaxation.MAX_DEGREE = before
    plan.relax(poses, ends, shapes)
    assert apart(poses, expected) < 1e-9
    assert (np.abs(poses[:, 2]) <= math.pi).all()


@pytest.mark.parametrize('count', [500, 2000])
def test_what_pulls_at_each_experience_is_zero(count: int) -> None:
    """Equation (7), at all but the first; and the map's size is the scale of what is left."""
    poses, ends, shapes = random_graph(3, count, count // 5)
    ends, shapes = ends[ends[:, 0] != ends[:, 1]], shapes[ends[:, 0] != ends[:, 1]]
    Relaxation(ends, count).relax(poses, ends, shapes)
    pull = incidence(ends, count).T @ errors(poses, ends, shapes)
    size = np.ptp(poses[:, :2])
    assert np.abs(pull).max() < 1e-9 * size
    again = poses.copy()
    Relaxation(ends, count).relax(again, ends, shapes)
    assert apart(again, poses) < 1e-6 * size


def test_a_mesh_of_every_neighbour_is_solved_too() -> None:
    side = 25
    number = np.arange(side * side).reshape(side, side)
    ends = np.concatenate([
        np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], 1),
        np.stack([number[:-1].ravel(), number[1:].ravel()], 1),
    ])  # fmt: skip
    rng = np.random.default_rng(1)
    shapes = np.c_[rng.uniform(0.5, 1.5, len(ends)), rng.normal(size=(len(ends), 2))]
    poses = rng.normal(size=(side * side, 3))
    first = poses[0].copy()
    plan = Relaxation(ends, len(poses))
    assert len(plan._mesh) > 50
    plan.relax(poses, ends, shapes)
    plan.relax(poses, ends, shapes)  # headings far off are unwrapped anew by the better ones
    plan.relax(poses, ends, shapes)
    pull = incidence(ends, len(poses)).T @ errors(poses, ends, shapes)
    assert np.abs(pull[1:]).max() < 1e-9
    assert np.array_equal(poses[0], first)


def test_experiences_created_since_hang_on_and_follow() -> None:
    poses, ends, shapes = random_graph(5, 30, 10)
    leaves = np.array([(3, 30), (30, 31), (31, 32), (7, 33)])
    all_ends = np.concatenate([ends, leaves])
    all_shapes = np.concatenate([shapes, np.ones((4, 3))])
    all_poses = np.concatenate([poses, np.zeros((4, 3))])
    expected = dense_fixed_point(all_poses, all_ends, all_shapes)
    Relaxation(ends, 30).relax(all_poses, all_ends, all_shapes)
    assert apart(all_poses, expected) < 1e-9


# In the map


def action(kind: str, source: int, target: int) -> MapAction:
    return MapAction(kind, source, target, target, 0.0, HERE)  # type: ignore[arg-type]


def driven(count: int, turn: float, parameters: ExperienceMapParameters) -> ExperienceMap:
    """Drive ``count`` metres in a circle, an experience a metre."""
    graph = ExperienceMap(parameters)
    graph.apply(action('create', -1, 0))
    for target in range(1, count):
        graph.integrate(Motion(1.0, 1.0, turn))
        graph.apply(action('create', target - 1, target))
    return graph


def close(graph: ExperienceMap, target: int = 0, turn: float = 0.0) -> None:
    graph.integrate(Motion(1.0, 1.0, turn))
    graph.apply(action('link', graph.current_id, target))


def fixed_point(graph: ExperienceMap) -> Reals:
    return dense_fixed_point(graph.poses, graph.link_ends, graph.link_shapes)


PARAMETERS = ExperienceMapParameters()


def test_a_closed_loop_is_at_its_fixed_point_with_the_action_that_closes_it() -> None:
    graph = driven(200, 2 * math.pi / 190, PARAMETERS)
    before = graph.poses
    close(graph)
    assert apart(graph.poses, before) > 0.3
    assert apart(graph.poses, fixed_point(graph)) < 1e-9
    for target in (1, 2, 3):  # and so it stays, with every action
        close(graph, target, 0.05)
        assert apart(graph.poses, fixed_point(graph)) < 1e-9


@pytest.mark.parametrize('nothing', [{'exp_loops': 0}, {'exp_correction': 0.0}])
def test_a_map_that_shall_not_be_relaxed_is_not(nothing: dict[str, float]) -> None:
    graph = driven(20, 0.3, replace(PARAMETERS, **nothing))
    before = graph.poses
    close(graph)
    assert np.array_equal(graph.poses, before)


def test_new_experiences_move_nothing() -> None:
    graph = driven(50, 0.1, PARAMETERS)
    close(graph, 10)
    before = graph.poses
    for target in range(50, 80):
        graph.integrate(Motion(1.0, 1.0, 0.2))
        graph.apply(action('create', graph.current_id, target))
    assert np.array_equal(graph.poses[:50], before)
    close(graph, 20)  # now they are part of a loop
    assert apart(graph.poses, fixed_point(graph)) < 1e-9


def test_a_large_map_saves_up_for_its_relaxation() -> None:
    """What one action costs stays the same: later changes wait, and are not forgotten."""
    graph = driven(4000, 2 * math.pi / 3900, PARAMETERS)
    at_first = graph.poses
    close(graph)  # saved up while nothing was to be done: at once
    first = graph.poses
    assert apart(first, at_first) > 1.0
    close(graph, 1, 0.1)
    assert np.array_equal(graph.poses, first)
    actions = 1
    while np.array_equal(graph.poses, first):
        graph.apply(action('none', 1, 1))
        actions += 1
        assert actions < 40
    settled = graph.poses
    graph.settle()
    assert apart(graph.poses, settled) < 1e-9


def test_a_restored_map_goes_on_to_the_last_bit() -> None:
    """Also in the middle of saving up, with experiences that the plan does not know."""
    graph = driven(1500, 2 * math.pi / 1400, PARAMETERS)
    close(graph)
    for target in range(1500, 1520):
        graph.integrate(Motion(1.0, 1.0, 0.2))
        graph.apply(action('create', graph.current_id, target))
    close(graph, 700)
    close(graph, 701, 0.1)
    close(graph, 1, 0.1)
    state = graph.state()
    state = {**state, **json.loads(json.dumps({
        key: value for key, value in state.items() if not isinstance(value, np.ndarray)
    }))}  # fmt: skip
    other = ExperienceMap(PARAMETERS)
    other.restore(state)
    for target in [*range(2, 12), 2, 3, 4, 5]:
        for one in (graph, other):
            close(one, target, 0.01)
        assert np.array_equal(graph.poses, other.poses)
    assert not np.array_equal(graph.poses, state['poses'])


def test_many_small_sweeps_end_at_the_same_fixed_point() -> None:
    graph = driven(12, 2 * math.pi / 12 + 0.02, replace(PARAMETERS, exp_loops=0))
    close(graph)
    slow = replace(PARAMETERS, exp_relaxation='sweep', exp_loops=10_000, exp_correction=0.002)
    expected = fixed_point(graph)
    graph = restored(graph, slow)
    for _ in range(40):
        graph.apply(action('none', 0, 0))
    assert apart(graph.poses, expected) < 5e-3
