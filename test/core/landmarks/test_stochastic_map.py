# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stochastic map: covariance, consistency, invariances, removal, invalid input and state."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.landmarks.features import Observations, UnusableObservations
from ratslam_ros.core.landmarks.models import MapModel
from ratslam_ros.core.landmarks.stochastic_map import StochasticMap
from ratslam_ros.errors import UnusableInput
from ratslam_simulator.landmarks import LandmarkSensor, drive, lap, scattered_bars

P = MapModel()
START = Pose(0.0, 0.0, 0.0)
SEEDS = st.integers(0, 2**32 - 1)
quick = settings(max_examples=15, deadline=None)


@dataclass
class World:
    """Bars and points at known places, and a robot with the noise that the map assumes."""

    rng: np.random.Generator
    parameters: MapModel
    pose: Pose = START
    reach_m: float = 6.0

    def __post_init__(self) -> None:
        rng, n = self.rng, 24
        self.bars = np.stack(
            (
                rng.uniform(-8.0, 8.0, n), rng.uniform(-8.0, 8.0, n),
                rng.uniform(-3.1, 3.1, n), rng.uniform(0.5, 2.0, n),
            ),
            axis=1,
        )
        self.is_point = rng.random(n) < 0.3

    def move(self, forward_m: float, turn_rad: float) -> tuple[float, float, float]:
        """Drive, and return the odometry, which has the error."""
        p, noise = self.parameters, self.rng.normal
        parts = 20
        for _ in range(parts):
            d, a = forward_m / parts, turn_rad / parts
            turn_sd = math.sqrt(
                p.odom_drift_sd_rad**2 * abs(d) + p.odom_turn_sd_rad**2 * abs(a)
            )
            sd = p.odom_position_sd_m * math.sqrt(abs(d))
            step = Pose(d + noise(0.0, sd), noise(0.0, sd), a + noise(0.0, turn_sd))
            self.pose = composed(self.pose, step)
        chord = forward_m * (math.sin(0.5 * turn_rad) / (0.5 * turn_rad) if turn_rad else 1.0)
        return chord * math.cos(0.5 * turn_rad), chord * math.sin(0.5 * turn_rad), turn_rad

    def look(self, most: int = 100) -> Observations:
        """Observe the landmarks within reach, with noise."""
        p, rng = self.parameters, self.rng
        offset = self.bars[:, :2] - [self.pose.x_m, self.pose.y_m]
        ranges = np.hypot(offset[:, 0], offset[:, 1])
        names = np.flatnonzero((ranges < self.reach_m) & (ranges > 0.5))[:most]
        n, bars = len(names), self.bars[names]
        bearings = np.arctan2(offset[names, 1], offset[names, 0]) - self.pose.heading_rad
        directions = bars[:, 2] - self.pose.heading_rad + rng.normal(0, p.direction_sd_rad, n)
        lengths = np.abs(bars[:, 3] + rng.normal(0, p.length_sd_m, n))
        values = (
            np.abs(ranges[names] + rng.normal(0, p.range_sd_m, n)),
            bearings + rng.normal(0, p.bearing_sd_rad, n),
            np.where(self.is_point[names], np.nan, directions),
            np.where(self.is_point[names], np.nan, lengths),
        )
        return Observations(np.stack(values, axis=1), names)

    def steps(self, count: int) -> Iterator[tuple[tuple[float, float, float], Observations]]:
        for _ in range(count):
            motion = self.move(0.5, float(self.rng.uniform(-0.4, 0.4)))
            yield motion, self.look()


def mapped(seed: int, count: int = 15) -> tuple[StochasticMap, World]:
    world = World(np.random.default_rng(seed), P)
    built = StochasticMap(P)
    for motion, seen in world.steps(count):
        built.predict(*motion)
        built.observe(seen)
    return built, world


def packed(built: StochasticMap) -> dict[str, bytes]:
    return {name: np.asarray(value).tobytes() for name, value in built.state().items()}


def point(range_m: float, bearing_rad: float, identifier: int) -> Observations:
    return Observations(np.array([[range_m, bearing_rad]]), np.array([identifier]))


@quick
@given(SEEDS)
def test_covariance_remains_symmetric_and_positive(seed: int) -> None:
    built, _ = mapped(seed)
    covariance = built.covariance
    assert (covariance == covariance.T).all()
    eigenvalues = np.linalg.eigvalsh(covariance)
    assert eigenvalues[0] >= -1e-12 * eigenvalues[-1]


def test_covariance_survives_thousands_of_accurate_updates() -> None:
    exact = replace(P, range_sd_m=1e-6, bearing_sd_rad=1e-6, outlier_probability=1e-12)
    built = StochasticMap(exact, START, np.diag([100.0, 100.0, 1.0]))
    for k in range(1000):
        built.predict(0.001, 0.0, 0.001)
        built.observe(point(3.0, 0.1 * (k % 7), k % 7))
    assert np.linalg.eigvalsh(built.covariance)[0] > -1e-12 * 100.0


def test_innovations_and_errors_are_consistent() -> None:
    squared, degrees, nees, freedom = 0.0, 0, 0.0, 0
    within, count = 0, 0
    for seed in range(30):
        world = World(np.random.default_rng(seed), P)
        built = StochasticMap(P)
        for motion, seen in world.steps(15):
            built.predict(*motion)
            observed = built.observe(seen)
            used = ~np.isnan(observed.squared)
            squared += float(observed.squared[used].sum())
            degrees += int(seen.sizes[used].sum())
        features = built.features()
        errors = np.concatenate([
            features.values[start:end] - world.bars[name, : end - start]
            for name, start, end in zip(
                features.identifiers, features.offsets[:-1], features.offsets[1:], strict=True
            )
        ])
        directions = features.offsets[:-1][features.are_bars] + 2
        errors[directions] = [wrap(float(error)) for error in errors[directions]]
        nees += float(errors @ np.linalg.solve(features.covariance, errors))
        freedom += len(errors)
        within += int((np.abs(errors) < 2.0 * np.sqrt(np.diag(features.covariance))).sum())
        count += len(errors)
    assert 0.95 < squared / degrees < 1.05
    assert 0.85 < nees / freedom < 1.15
    assert within / count > 0.93


@quick
@given(SEEDS, st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-3.1, 3.1))
def test_map_moves_with_the_start_pose(seed: int, x: float, y: float, heading: float) -> None:
    """Seen from the robot nothing depends on the frame, apart from rounding."""
    frame = Pose(x, y, heading)
    world = World(np.random.default_rng(seed), P)
    built, moved = StochasticMap(P), StochasticMap(P, frame)
    for motion, seen in world.steps(10):
        for each in (built, moved):
            each.predict(*motion)
            each.observe(seen)
    expected = composed(frame, built.pose)
    assert moved.pose[:2] == pytest.approx(expected[:2], abs=1e-8)
    assert wrap(moved.pose.heading_rad - expected.heading_rad) == pytest.approx(0.0, abs=1e-9)
    a, b = built.seen_from_robot(), moved.seen_from_robot()
    assert b.positions_m == pytest.approx(a.positions_m, abs=1e-8)
    assert b.covariance == pytest.approx(a.covariance, abs=1e-8)


@quick
@given(SEEDS)
def test_order_of_observations_does_not_matter(seed: int) -> None:
    """All are linearised at the state before the first, so the order matters by rounding only."""
    rng = np.random.default_rng(seed)
    built, other = StochasticMap(P), StochasticMap(P)
    for motion, seen in World(rng, P).steps(10):
        for each in (built, other):
            each.predict(*motion)
        result = built.observe(seen)
        again = other.observe(seen.selected(rng.permutation(len(seen))))
        assert set(again.updated) == set(result.updated)
        assert set(again.rejected) == set(result.rejected)
    a, b = built.features(), other.features()
    order = np.array([list(b.identifiers).index(name) for name in a.identifiers])
    assert b.selected(order).values == pytest.approx(a.values, abs=1e-10)
    assert b.selected(order).covariance == pytest.approx(a.covariance, abs=1e-10)


@quick
@given(SEEDS, st.sets(st.integers(0, 23)))
def test_removal_leaves_the_marginal_distribution(seed: int, names: set[int]) -> None:
    built, _ = mapped(seed, 8)
    before = built.features()
    removed = names & set(before.identifiers.tolist())
    kept = np.array([k for k, name in enumerate(before.identifiers) if name not in removed], int)
    pose, covariance = built.pose, built.pose_covariance
    built.remove(removed)
    expected, after = before.selected(kept), built.features()
    assert after.identifiers.tolist() == expected.identifiers.tolist()
    assert after.offsets.tolist() == expected.offsets.tolist()
    assert (after.values == expected.values).all()
    assert (after.covariance == expected.covariance).all()
    assert built.pose == pose
    assert (built.pose_covariance == covariance).all()


def test_removing_an_unknown_landmark_changes_nothing() -> None:
    built, _ = mapped(0, 5)
    before = packed(built)
    with pytest.raises(KeyError):
        built.remove([int(built.identifiers[0]), 999])
    assert packed(built) == before


def test_observations_without_names_leave_the_map_unchanged() -> None:
    built, world = mapped(1)
    before = packed(built)
    with pytest.raises(UnusableObservations, match='identifiers are missing'):
        built.observe(replace(world.look(), identifiers=None))
    assert packed(built) == before


@pytest.mark.parametrize('motion', [(math.nan, 0, 0), (0, math.inf, 0), (0, 0, 1e12)])
def test_invalid_motion_leaves_the_map_unchanged(motion: tuple[float, float, float]) -> None:
    built, _ = mapped(1, 3)
    before = packed(built)
    with pytest.raises(UnusableInput, match='expected finite'):
        built.predict(*motion)
    assert packed(built) == before


@pytest.mark.parametrize(
    ('pose', 'covariance'),
    [
        (Pose(math.nan, 0.0, 0.0), np.eye(3)),
        (START, np.full((3, 3), np.nan)),
        (START, np.diag([1.0, -1.0, 1.0])),
        (START, np.array([[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])),
        (START, np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]])),
        (START, np.array([[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]])),
        (START, np.eye(2)),
    ],
)
def test_invalid_pose_leaves_the_map_unchanged(
    pose: Pose, covariance: NDArray[np.float64]
) -> None:
    built, _ = mapped(1, 3)
    before = packed(built)
    with pytest.raises(UnusableInput):
        built.move_to(pose, covariance)
    assert packed(built) == before


def test_outliers_are_rejected_counted_and_reported() -> None:
    built, _ = mapped(2)
    name = int(built.identifiers[0])
    features = built.seen_from_robot()
    x, y = features.positions_m[0].tolist()
    before = built.features()
    observed = built.observe(point(math.hypot(x, y) + 3.0, math.atan2(y, x), name))
    assert observed.rejected.tolist() == [name] and built.outlier_count == 1
    assert observed.squared[0] > 13.8
    assert (built.features().values == before.values).all()
    observed = built.observe(point(math.hypot(x, y), math.atan2(y, x), name))
    assert observed.updated.tolist() == [name] and built.outlier_count == 1


def test_landmark_at_the_robot_is_rejected() -> None:
    built = StochasticMap(P)
    assert built.observe(point(0.0, 0.0, 1)).rejected.tolist() == [1]
    built.observe(point(1.0, 0.0, 1))
    built.predict(1.0, 0.0, 0.0)
    assert built.observe(point(0.0, 0.0, 1)).rejected.tolist() == [1]


def test_prediction_is_independent_of_step_length() -> None:
    covariance = np.array([[0.1, 0.02, 0.0], [0.02, 0.2, 0.01], [0.0, 0.01, 0.05]])
    once, often = (StochasticMap(P, Pose(1.0, 2.0, 0.7), covariance) for _ in range(2))
    once.predict(3.0, 0.0, 0.0)
    for _ in range(30):
        often.predict(0.1, 0.0, 0.0)
    assert once.pose == pytest.approx(often.pose, abs=1e-12)
    assert once.pose_covariance == pytest.approx(often.pose_covariance, abs=1e-12)


def test_new_landmark_is_correlated_with_the_rest() -> None:
    """The covariance of a new landmark agrees with random samples of pose and observation."""
    covariance = np.array([[0.01, 0.002, 0.001], [0.002, 0.02, 0.001], [0.001, 0.001, 0.0004]])
    built = StochasticMap(P, Pose(1.0, 2.0, 0.5), covariance)
    built.observe(
        Observations(np.array([[3.0, 0.4, 1.0, 1.5]]), np.array([7]))
    )
    rng, n = np.random.default_rng(0), 400_000
    pose = rng.multivariate_normal([1.0, 2.0, 0.5], covariance, n)
    ranges = rng.normal(3.0, P.range_sd_m, n)
    angles = pose[:, 2] + rng.normal(0.4, P.bearing_sd_rad, n)
    sample = np.column_stack((
        pose, pose[:, 0] + ranges * np.cos(angles), pose[:, 1] + ranges * np.sin(angles),
        pose[:, 2] + rng.normal(1.0, P.direction_sd_rad, n),
        rng.normal(1.5, P.length_sd_m, n),
    ))
    assert built.covariance == pytest.approx(np.cov(sample.T), abs=2e-4)
    assert built.features().values == pytest.approx(sample.mean(axis=0)[3:], abs=3e-3)


def test_repeated_observations_from_one_place_count_once() -> None:
    built = StochasticMap(replace(P, repeat_m=0.5))
    built.observe(point(3.0, 0.2, 1))
    before = built.features()
    built.predict(0.2, 0.0, 0.1)
    observed = built.observe(point(2.8, 0.1, 1))
    assert observed.repeated.tolist() == [1] and len(observed.updated) == 0
    assert (built.features().covariance == before.covariance).all()
    built.predict(0.2, 0.0, 0.1)
    assert built.observe(point(2.6, 0.0, 1)).updated.tolist() == [1]


def test_points_and_bars_share_what_they_have() -> None:
    built = StochasticMap(P)
    built.observe(point(3.0, 0.2, 1))
    bars = np.array([[3.0, 0.2, 1.0, 1.0], [4.0, -0.4, 2.0, 0.1]])
    observed = built.observe(Observations(bars, np.array([1, 2])))
    assert (observed.updated.tolist(), observed.added.tolist()) == ([1], [2])
    assert built.features().are_bars.tolist() == [False, True]
    assert built.observe(point(4.0, -0.4, 2)).updated.tolist() == [2]


def test_seen_features_have_the_covariance_of_their_errors() -> None:
    """The Jacobian agrees with differences of the transform, where both are linearised."""
    built, _ = mapped(5, 6)
    state = built.state()
    state['first_values'] = state['values']
    built.restore(state)
    x = np.concatenate((built.pose, built.features().values))
    offsets = built.features().offsets

    def seen(x: NDArray[np.float64]) -> NDArray[np.float64]:
        values = x[3:].copy()
        c, s = math.cos(x[2]), math.sin(x[2])
        for start, end in pairwise(offsets):
            d_x, d_y = x[3 + start] - x[0], x[4 + start] - x[1]
            values[start : start + 2] = c * d_x + s * d_y, -s * d_x + c * d_y
            if end - start == 4:
                values[start + 2] -= x[2]
        return values

    step = 1e-6
    jacobian = np.column_stack([
        (seen(x + step * unit) - seen(x - step * unit)) / (2.0 * step) for unit in np.eye(len(x))
    ])
    expected = jacobian @ built.covariance @ jacobian.T
    assert built.seen_from_robot().covariance == pytest.approx(expected, abs=1e-9)


def test_observations_give_no_absolute_position_or_heading() -> None:
    """With Jacobians at the latest estimates, the deviation of the heading falls to 0.02 rad."""
    rng = np.random.Generator(np.random.PCG64(1))
    world = scattered_bars(rng)
    start, steps = drive(world, lap(world, 12.5), LandmarkSensor(), rng)
    sd = np.array([0.5, 0.5, 0.2])
    built = StochasticMap(MapModel(), start, np.diag(sd**2))
    for step in steps:
        built.predict(*step.motion)
        built.observe(step.observations)
    assert (np.sqrt(np.diag(built.pose_covariance)) > 0.999 * sd).all()
