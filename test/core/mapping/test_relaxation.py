# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relaxation: the fixed point of equation (7) of Milford et al. (2006), by dense least squares."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.sparse.linalg
from graphs import Indices, Reals, dense_fixed_point, incidence, max_difference, residuals
from hypothesis import given, settings
from hypothesis import strategies as st

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.mapping import relaxation
from ratslam_ros.core.mapping.relaxation import Relaxation


def random_graph(seed: int, count: int, extra: int) -> tuple[Reals, Indices, Reals]:
    """Return disturbed poses, and noisy links: a chain with gaps, crossings, opposite links."""
    rng = np.random.default_rng(seed)
    true = np.c_[rng.normal(size=(count, 2)).cumsum(0), rng.uniform(-math.pi, math.pi, count)]
    chain = [(i, i + 1) for i in range(count - 1) if rng.random() < 0.95]
    crossings = [
        tuple(pair) for pair in rng.integers(0, count, (extra, 2)) if pair[0] != pair[1]
    ]
    opposite = [(j, i) for i, j in chain[::7]]
    ends = np.array([*chain, *crossings, *opposite], np.int64).reshape(-1, 2)
    i, j = ends.T
    d = true[j, :2] - true[i, :2] + rng.normal(scale=0.05, size=(len(ends), 2))
    heading = np.arctan2(d[:, 1], d[:, 0]) - true[i, 2]
    facing = true[j, 2] - true[i, 2] + rng.normal(scale=0.05, size=len(ends))
    shapes = np.stack([np.hypot(*d.T), heading, facing], 1)
    poses = true + rng.normal(scale=0.2, size=true.shape)
    poses[:, 2] = [wrap(float(a)) for a in poses[:, 2]]
    return poses, ends, shapes


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 10**6), st.integers(1, 30), st.integers(0, 60), st.sampled_from([0, 2, 8])
)
def test_relaxed_poses_match_dense_least_squares(
    seed: int, count: int, extra: int, max_degree: int
) -> None:
    """Several components, opposite and parallel links; from no mesh to nothing but a mesh."""
    poses, ends, shapes = random_graph(seed, count, extra)
    expected = dense_fixed_point(poses, ends, shapes)
    before, relaxation.MAX_DEGREE = relaxation.MAX_DEGREE, max_degree
    try:
        plan = Relaxation(ends, count)
    finally:
        relaxation.MAX_DEGREE = before
    plan.relax(poses, ends, shapes)
    assert max_difference(poses, expected) < 1e-9
    assert (np.abs(poses[:, 2]) <= math.pi).all()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 25), st.integers(0, 40), st.sampled_from([0, 2, 8]))
def test_weighted_links_match_repeated_links(
    seed: int, count: int, extra: int, max_degree: int
) -> None:
    """A link of weight 3 has the effect of three equal links; also if its target is a leaf."""
    poses, ends, shapes = random_graph(seed, count, extra)
    ends = np.concatenate([ends, [(0, count)]])
    shapes = np.concatenate([shapes, np.ones((1, 3))])
    poses = np.concatenate([poses, np.zeros((1, 3))])
    weights = np.random.default_rng(seed).integers(1, 4, len(ends))
    expected = dense_fixed_point(poses, ends.repeat(weights, 0), shapes.repeat(weights, 0))
    before, relaxation.MAX_DEGREE = relaxation.MAX_DEGREE, max_degree
    try:
        plan = Relaxation(ends[:-1], count, weights[:-1].astype(float))
    finally:
        relaxation.MAX_DEGREE = before
    plan.relax(poses, ends, shapes, weights.astype(float))
    assert max_difference(poses, expected) < 1e-8


@pytest.mark.parametrize('count', [500, 2000])
def test_relaxed_residuals_balance_at_each_experience(count: int) -> None:
    """Equation (7), within rounding errors relative to the size of the map."""
    poses, ends, shapes = random_graph(3, count, count // 5)
    ends, shapes = ends[ends[:, 0] != ends[:, 1]], shapes[ends[:, 0] != ends[:, 1]]
    Relaxation(ends, count).relax(poses, ends, shapes)
    balance = incidence(ends, count).T @ residuals(poses, ends, shapes)
    size = np.ptp(poses[:, :2])
    assert np.abs(balance).max() < 1e-9 * size
    again = poses.copy()
    Relaxation(ends, count).relax(again, ends, shapes)
    assert max_difference(again, poses) < 1e-6 * size


def test_grid_is_relaxed_by_sparse_factorisation(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh_sizes = []
    splu = scipy.sparse.linalg.splu

    def counting_splu(matrix, **options):  # type: ignore[no-untyped-def]
        mesh_sizes.append(matrix.shape[0])
        return splu(matrix, **options)

    monkeypatch.setattr(scipy.sparse.linalg, 'splu', counting_splu)
    side = 25
    number = np.arange(side * side).reshape(side, side)
    ends = np.concatenate([
        np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], 1),
        np.stack([number[:-1].ravel(), number[1:].ravel()], 1),
    ])
    rng = np.random.default_rng(1)
    shapes = np.c_[rng.uniform(0.5, 1.5, len(ends)), rng.normal(size=(len(ends), 2))]
    poses = rng.normal(size=(side * side, 3))
    first = poses[0].copy()
    plan = Relaxation(ends, len(poses))
    assert len(mesh_sizes) == 1
    assert mesh_sizes[0] > 50
    for _ in range(3):  # large heading residuals are wrapped again at the relaxed headings
        plan.relax(poses, ends, shapes)
    balance = incidence(ends, len(poses)).T @ residuals(poses, ends, shapes)
    assert np.abs(balance[1:]).max() < 1e-9
    assert np.array_equal(poses[0], first)


def test_experiences_newer_than_the_plan_are_relaxed() -> None:
    poses, ends, shapes = random_graph(5, 30, 10)
    leaves = np.array([(3, 30), (30, 31), (31, 32), (7, 33)])
    all_ends = np.concatenate([ends, leaves])
    all_shapes = np.concatenate([shapes, np.ones((4, 3))])
    all_poses = np.concatenate([poses, np.zeros((4, 3))])
    expected = dense_fixed_point(all_poses, all_ends, all_shapes)
    Relaxation(ends, 30).relax(all_poses, all_ends, all_shapes)
    assert max_difference(all_poses, expected) < 1e-9
