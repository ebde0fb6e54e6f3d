# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose graph optimiser: relaxation of an experience map, by direct solution and by sweeps."""

from __future__ import annotations

import math
from pathlib import Path

import batch_rates
import numpy as np
import pytest
from graphs import (
    NONE,
    arrive,
    dense_step,
    drive,
    go,
    max_difference,
    new_map,
    pose_is_near,
    residuals_of,
)
from helpers import ahead, restored, turning
from hypothesis import given, settings
from hypothesis import strategies as st
from states import filed

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.relaxation import batch


def sweeping(loops: int, correction: float = 0.5) -> ExperienceMapParameters:
    """Return the parameters of relaxation by sweeps."""
    return ExperienceMapParameters(
        exp_relaxation='sweep', exp_loops=loops, exp_correction=correction
    )


# Equation (7)


@pytest.mark.parametrize('rate', [0.1, 0.5])
def test_batch_corrects_all_experiences_at_once(rate: float) -> None:
    """Once, with the sign of the second sum corrected; 1 / links where the rate is too large."""
    random = np.random.default_rng(3)
    poses = random.uniform(-3.0, 3.0, (20, 3))
    ends = np.array([pair for pair in random.integers(0, 20, (45, 2)) if pair[0] != pair[1]])
    shapes = random.uniform(-1.0, 1.0, (len(ends), 3))
    sums = np.zeros_like(poses)
    for (i, j), (length, direction, turn) in zip(ends, shapes, strict=True):
        angle = poses[i, 2] + direction
        way = np.array([length * math.cos(angle), length * math.sin(angle), turn])
        residual = poses[j] - poses[i] - way
        residual[2] = wrap(residual[2])
        sums[i] += residual
        sums[j] -= residual
    links = np.bincount(ends.ravel(), minlength=20)
    assert links.max() > 5 and links.min() <= 2
    expected = poses + np.minimum(rate, 1.0 / np.maximum(links, 1))[:, None] * sums
    expected[0] = poses[0]
    expected[:, 2] = [wrap(angle) for angle in expected[:, 2]]
    batch(poses, ends, shapes, rate, 1)
    assert max_difference(poses, expected) < 1e-12


def test_printed_rate_converges_below_two_over_the_largest_eigenvalue() -> None:
    """A path has eigenvalues below 4, so that 0.5 converges; four links at a place need less."""
    path = batch_rates.laplacian(np.array([(n, n + 1) for n in range(30)]), 31)
    assert path.diagonal().tolist() == [2.0] * 29 + [1.0]
    assert batch_rates.sweeps_until_divergence(path, 0.5) == 0
    assert batch_rates.sweeps_until_divergence(path, 0.51) > 0
    cross = batch_rates.laplacian(np.array([(0, 1), (1, 2), (1, 3), (4, 1), (3, 2)]), 5)
    assert cross.diagonal().tolist() == [4.0, 2.0, 2.0, 1.0]
    largest = np.linalg.eigvalsh(cross.toarray())[-1]
    assert batch_rates.sweeps_until_divergence(cross, 0.5) > 0
    assert batch_rates.sweeps_until_divergence(cross, 1.95 / largest) == 0
    assert batch_rates.sweeps_until_divergence(cross, 2.05 / largest) > 0


def test_batch_converges_to_the_fixed_point_at_the_published_rate() -> None:
    graph = driven_circle(12, 2 * math.pi / 11, exp_relaxation='batch', exp_loops=2000)
    for target in (0, 4, 8, 0, 4):  # up to six links at a place
        close_loop(graph, target, 0.1)
    e, ends = residuals_of(graph), graph.link_ends
    pull = np.zeros_like(graph.poses)
    np.add.at(pull, ends[:, 0], e)
    np.subtract.at(pull, ends[:, 1], e)
    assert np.abs(pull[1:]).max() < 1e-9


# Direct solution


def driven_circle(count: int, turn_rad: float, **parameters: float) -> ExperienceMap:
    """Drive ``count`` metres along a circle, with an experience every metre."""
    graph = new_map(**{'exp_initial_em_deg': 90.0, **parameters})
    arrive(graph, 0)
    for target in range(1, count):
        graph.integrate(Motion(1.0, 1.0, turn_rad))
        arrive(graph, target)
    return graph


def close_loop(graph: ExperienceMap, target: int = 0, turn_rad: float = 0.0) -> None:
    graph.integrate(Motion(1.0, 1.0, turn_rad))
    arrive(graph, target)


def still_to_move(graph: ExperienceMap) -> float:
    """Return the largest displacement of the next step, in m or rad."""
    table = graph.link_table
    weights = graph.optimiser.weights(table)
    return float(np.abs(dense_step(graph.poses, table.ends, table.shapes, weights)).max())


def settle(graph: ExperienceMap) -> int:
    """Apply actions until the map has converged; return their number."""
    actions = 0
    while not graph.optimiser.is_settled:
        graph.apply(NONE)
        actions += 1
    return actions


def test_loop_closure_is_relaxed_within_a_few_actions() -> None:
    graph = driven_circle(200, 2 * math.pi / 190)
    before = graph.poses
    close_loop(graph)
    assert max_difference(graph.poses, before) > 0.3
    assert settle(graph) < 6
    assert still_to_move(graph) < 0.01
    for target in (1, 2, 3):
        close_loop(graph, target, 0.05)
    assert settle(graph) < 4
    assert still_to_move(graph) < 0.01


@pytest.mark.parametrize('disabling', [{'exp_loops': 0}, {'exp_correction': 0.0}])
def test_disabled_relaxation_moves_nothing(disabling: dict[str, float]) -> None:
    graph = driven_circle(20, 0.3, **disabling)
    before = graph.poses
    close_loop(graph)
    assert np.array_equal(graph.poses, before)


def test_new_experiences_do_not_move_old_ones() -> None:
    graph = driven_circle(50, 0.1)
    close_loop(graph, 10)
    settle(graph)
    before = graph.poses
    for target in range(50, 80):
        graph.integrate(Motion(1.0, 1.0, 0.2))
        arrive(graph, target)
    assert np.array_equal(graph.poses[:50], before)
    close_loop(graph, 20)  # the new experiences become part of a loop
    settle(graph)
    assert not np.array_equal(graph.poses[21:50], before[21:])
    assert still_to_move(graph) < 0.02


def test_large_map_is_relaxed_after_several_actions() -> None:
    """The cost per action is bounded; changes are relaxed when enough budget has been saved."""
    graph = driven_circle(4000, 2 * math.pi / 3900)
    before = graph.poses
    close_loop(graph)  # at once, with the budget that was saved before
    first = graph.poses
    assert max_difference(first, before) > 1.0
    close_loop(graph, 1, 0.1)
    assert np.array_equal(graph.poses, first)
    actions = 1
    while np.array_equal(graph.poses, first):
        graph.apply(NONE)
        actions += 1
        assert actions < 40
    assert max_difference(graph.poses, first) > 1e-3
    settle(graph)
    relaxed = graph.poses
    graph.settle()
    assert max_difference(graph.poses, relaxed) < 0.01


def test_restored_map_relaxes_bit_identically(tmp_path: Path) -> None:
    """Saved with an incomplete budget, and with experiences that the plan does not contain."""
    graph = driven_circle(1500, 2 * math.pi / 1400)
    close_loop(graph)
    for target in range(1500, 1520):
        graph.integrate(Motion(1.0, 1.0, 0.2))
        arrive(graph, target)
    close_loop(graph, 700)
    close_loop(graph, 701, 0.1)
    close_loop(graph, 1, 0.1)
    state = filed({'experience_map': graph.state()}, tmp_path)['experience_map']
    other = ExperienceMap(ExperienceMapParameters())
    other.restore(state)
    for target in [*range(2, 12), 2, 3, 4, 5]:
        for one in (graph, other):
            close_loop(one, target, 0.01)
        assert np.array_equal(graph.poses, other.poses)
    assert not np.array_equal(graph.poses, state['poses'])


# Sweeps


def driven_polygon(
    sides: int, turn_rad: float, loops: int, correction: float = 0.5, laps: int = 1
) -> ExperienceMap:
    """Drive along a polygon with a turn at each corner, and close it at experience 0."""
    graph = new_map(exp_loops=loops, exp_correction=correction)
    arrive(graph, 0)
    for side in range(1, laps * sides + 1):
        go(graph, side % sides, ahead(1.0), turning(turn_rad))
    return graph


@pytest.mark.parametrize(('sides', 'sense', 'correction'), [(3, 1.0, 0.5), (12, -1.0, 0.1)])
def test_consistent_loop_is_not_moved(sides: int, sense: float, correction: float) -> None:
    turn_rad = sense * 2.0 * math.pi / sides
    unrelaxed, relaxed = (
        driven_polygon(sides, turn_rad, loops, correction) for loops in (0, 50)
    )
    assert max_difference(unrelaxed.poses, relaxed.poses) < 1e-9
    assert np.hypot(*np.diff(relaxed.poses[:, :2], axis=0).T) == pytest.approx(1.0)


def test_first_experience_is_never_moved() -> None:
    graph = driven_polygon(6, 2.0 * math.pi / 6 + 0.1, 40, laps=3)
    assert graph.poses[0].tolist() == [0.0, 0.0, 0.0]
    graph = new_map(exp_loops=5, exp_initial_em_deg=90.0)
    go(graph, 0, ahead(3.0))
    for target in (1, 2, 0, 2, 1, 0):
        go(graph, target, ahead(1.0), turning(0.7))
    assert pose_is_near(graph.pose_of(0), 0.0, 3.0, math.pi / 2)


def test_small_sweeps_converge_to_the_direct_solution() -> None:
    """Without a view spacing, both are the fixed point of equation (7)."""
    graph = driven_circle(12, 2 * math.pi / 12 + 0.02, exp_loops=0)
    close_loop(graph)
    direct = restored(graph, ExperienceMapParameters())
    for _ in range(3):
        direct.settle()
    graph = restored(graph, sweeping(10_000, 0.002))
    for _ in range(40):
        graph.apply(NONE)
    assert max_difference(graph.poses, direct.poses) < 5e-3


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.integers(3, 25))
def test_sweeps_restore_a_disturbed_consistent_map(seed: int, count: int) -> None:
    """Headings across half a turn, and crossing links; no pose becomes NaN."""
    rng = np.random.default_rng(seed)
    graph = new_map(exp_loops=0)
    for target in range(count):
        arrive(graph, target)
        drive(graph, Motion(0.1, float(rng.uniform(0.2, 2.0)), float(rng.uniform(-3, 3))))
    arrive(graph, count)
    expected = graph.poses
    disturbed = expected.copy()
    disturbed[1:] += rng.normal(scale=0.3, size=(count, 3))
    graph = restored(graph, sweeping(10_000), poses=disturbed)
    graph.apply(NONE)
    assert np.isfinite(graph.poses).all()
    assert (np.abs(graph.poses[:, 2]) <= math.pi).all()
    assert np.hypot(*(graph.poses - expected)[:, :2].T).max() < 0.02 * count
    assert max(abs(wrap(d)) for d in (graph.poses - expected)[:, 2]) < 0.01


def test_action_none_is_followed_by_sweeps() -> None:
    graph = restored(driven_polygon(5, 1.0, 0), sweeping(1))
    before = graph.poses
    graph.apply(NONE)
    assert not np.array_equal(graph.poses, before)
