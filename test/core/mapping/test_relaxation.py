# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relaxation: Gauss-Newton steps, compared with dense least squares."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.sparse.linalg
from graphs import Indices, Reals, dense_step, max_difference, residuals
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.turn_correction import UNCORRECTED, TurnCorrection
from ratslam_ros.core.mapping import block_elimination
from ratslam_ros.core.mapping.relaxation import STEP_SHARES, cost, relax, relax_with_turns


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


def random_weights(ends: Indices, seed: int = 1) -> Reals:
    return np.random.default_rng(seed).uniform(0.1, 10.0, (len(ends), 2))


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 10**6), st.integers(1, 30), st.integers(0, 60), st.sampled_from([0, 2, 60])
)
def test_step_matches_dense_least_squares(
    seed: int, count: int, extra: int, max_degree: int
) -> None:
    """Several components, opposite and parallel links; from no mesh to nothing but a mesh."""
    poses, ends, shapes = random_graph(seed, count, extra)
    weights = random_weights(ends, seed)
    step, start = dense_step(poses, ends, shapes, weights), poses.copy()
    before, block_elimination.MAX_DEGREE = block_elimination.MAX_DEGREE, max_degree
    try:
        _, worse, better = relax(poses, ends, shapes, weights)
    finally:
        block_elimination.MAX_DEGREE = before
    lower = [
        share for share in STEP_SHARES
        if cost(start + share * step, ends, shapes, weights) <= cost(start, ends, shapes, weights)
    ]
    expected = start + (lower[0] if lower else 0.0) * step
    assert better <= worse
    assert worse - better < 1e-9 or max_difference(poses, expected) < 1e-8
    assert (np.abs(poses[:, 2]) <= math.pi).all()


def test_steps_converge_to_balanced_residuals() -> None:
    count = 500
    poses, ends, shapes = random_graph(3, count, count // 5)
    weights = random_weights(ends)
    worse, better = 1.0, 0.0
    while worse - better > 1e-9:
        _, worse, better = relax(poses, ends, shapes, weights)
    e = residuals(poses, ends, shapes)
    i, j = ends.T
    pull = np.zeros((count, 2))
    np.add.at(pull, i, -weights[:, :1] * e[:, :2])
    np.add.at(pull, j, weights[:, :1] * e[:, :2])
    assert np.abs(pull).max() < 1e-3 * np.abs(weights[:, :1] * e[:, :2]).max()


def test_position_of_a_closure_corrects_headings() -> None:
    """A straight corridor whose odometry turns; its end is recognised, its heading is not."""
    count, turn_rad = 41, 0.01
    ends = np.array([(i, i + 1) for i in range(count - 1)] + [(0, count - 1)])
    shapes = np.array([(1.0, 0.0, turn_rad)] * (count - 1) + [(count - 1.0, 0.0, 0.0)])
    weights = np.ones((len(ends), 2))
    weights[-1] = 100.0, 1e-9
    headings_rad = turn_rad * np.arange(count)
    poses = np.zeros((count, 3))
    poses[:, 2] = headings_rad
    poses[1:, 0] = np.cos(headings_rad[:-1]).cumsum()
    poses[1:, 1] = np.sin(headings_rad[:-1]).cumsum()
    before_rad = np.abs(poses[:, 2]).mean()
    for _ in range(10):
        relax(poses, ends, shapes, weights)
    assert np.hypot(poses[-1, 0] - 40.0, poses[-1, 1]) < 0.5
    assert np.abs(poses[:, 2]).mean() < 0.6 * before_rad


def figure_eights(
    error: TurnCorrection, seed: int
) -> tuple[Reals, Reals, Indices, Reals, Reals, NDArray[np.bool_]]:
    """Return three drives along a circle to the left and one to the right, all recognised.

    Returns:
        True poses, poses by odometry, ends, shapes and weights of the links, and whether each is
        by odometry.
    """
    random, step_m = np.random.default_rng(seed), 0.5
    turns_rad = np.tile(np.repeat([math.tau / 40, -math.tau / 40], 40), 3)
    measured_rad = np.array([error.measured(turn, step_m) for turn in turns_rad.tolist()])
    measured_rad += random.normal(scale=0.002, size=len(measured_rad))
    shapes = np.c_[np.full(len(measured_rad), step_m), 0.5 * measured_rad, measured_rad]
    ends = [(n, n + 1) for n in range(len(measured_rad))]
    again = [(n % 40 if n % 80 < 40 else n % 80, n) for n in range(40, len(ends), 5)]
    again = [(i, n) for i, n in again if i != n]
    recognised = np.c_[
        np.abs(random.normal(scale=0.1, size=len(again))),
        random.uniform(-math.pi, math.pi, len(again)), random.normal(scale=0.05, size=len(again)),
    ]
    driven = np.arange(len(ends) + len(again)) < len(ends)
    return (
        chained(turns_rad, step_m), chained(measured_rad, step_m), np.array([*ends, *again]),
        np.concatenate([shapes, recognised]), np.where(driven[:, None], (1e4, 1e5), (1e2, 4e2)),
        driven,
    )


def chained(turns_rad: Reals, step_m: float) -> Reals:
    """Return the poses along arcs of one length."""
    headings_rad = np.r_[0.0, turns_rad.cumsum()]
    directions_rad = headings_rad[:-1] + 0.5 * turns_rad
    way = step_m * np.c_[np.cos(directions_rad), np.sin(directions_rad)]
    return np.c_[np.r_[np.zeros((1, 2)), way.cumsum(0)], headings_rad]


def off_m(poses: Reals, true: Reals) -> float:
    """Return the mean distance of poses from the true ones; both begin at the same pose."""
    return float(np.hypot(*(poses - true)[:, :2].T).mean())


@pytest.mark.parametrize('seed', range(2))
@pytest.mark.parametrize('error', [
    UNCORRECTED, TurnCorrection(1.03, 0.0), TurnCorrection(0.96, 0.004), TurnCorrection(1.0, -0.01)
])
def test_systematic_errors_of_turns_are_found_with_the_poses(
    error: TurnCorrection, seed: int
) -> None:
    true, poses, ends, shapes, weights, driven = figure_eights(error, seed)
    turns, bent = UNCORRECTED, poses.copy()
    for _ in range(15):
        *_, turns = relax_with_turns(poses, ends, shapes, weights, driven, turns, 1.0)
        relax(bent, ends, shapes, weights)
    assert tuple(turns) == pytest.approx(tuple(error), abs=0.003)
    assert off_m(poses, true) < 0.1
    assert error == UNCORRECTED or off_m(poses, true) < 0.5 * off_m(bent, true)


def test_turns_without_loops_are_not_corrected() -> None:
    _, poses, ends, shapes, weights, driven = figure_eights(TurnCorrection(1.05, 0.01), 0)
    before = poses.copy()
    *_, turns = relax_with_turns(
        poses, ends[driven], shapes[driven], weights[driven], driven[driven], UNCORRECTED, 1.0
    )
    assert tuple(turns) == pytest.approx(tuple(UNCORRECTED), abs=1e-9)
    assert max_difference(poses, before) < 1e-6


def test_grid_is_relaxed_by_sparse_factorisation(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh_sizes = []
    splu = scipy.sparse.linalg.splu

    def counting_splu(matrix, **options):  # type: ignore[no-untyped-def]
        mesh_sizes.append(matrix.shape[0] // 3)
        return splu(matrix, **options)

    monkeypatch.setattr(scipy.sparse.linalg, 'splu', counting_splu)
    side = 60
    number = np.arange(side * side).reshape(side, side)
    ends = np.concatenate([
        np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], 1),
        np.stack([number[:-1].ravel(), number[1:].ravel()], 1),
    ])
    true = np.c_[np.argwhere(number >= 0), np.zeros(side * side)].astype(float)
    way = (true[ends[:, 1]] - true[ends[:, 0]])[:, :2]
    shapes = np.c_[np.hypot(*way.T), np.arctan2(way[:, 1], way[:, 0]), np.zeros(len(ends))]
    poses = true + np.random.default_rng(1).normal(scale=0.05, size=true.shape)
    poses[0] = true[0]
    for _ in range(4):
        relax(poses, ends, shapes, np.ones((len(ends), 2)))
    assert len(mesh_sizes) == 4
    assert mesh_sizes[0] > 50
    assert max_difference(poses, true) < 1e-6
