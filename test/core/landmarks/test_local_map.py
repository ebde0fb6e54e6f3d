# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Local map: association without identifiers, and what the robot forgets on its way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.landmarks.features import Observations
from ratslam_ros.core.landmarks.local_map import LocalMap
from ratslam_ros.core.landmarks.models import MapModel

P = MapModel()
LANDMARKS = np.array([(3.0, 1.0), (2.0, -2.0), (4.0, 3.0), (5.0, -1.0), (1.0, 2.5)])


def look(pose: Pose, rng: np.random.Generator, bars: bool, reach_m: float = 9.0) -> Observations:
    """Observe the landmarks; as bars, they point away from the origin and are 1 m long."""
    offset = LANDMARKS - [pose.x_m, pose.y_m]
    near = np.hypot(offset[:, 0], offset[:, 1]) < reach_m
    offset, known = offset[near], LANDMARKS[near]
    n = len(offset)
    directions = np.arctan2(known[:, 1], known[:, 0]) - pose.heading_rad
    values = [
        np.hypot(offset[:, 0], offset[:, 1]) + rng.normal(0, P.range_sd_m, n),
        np.arctan2(offset[:, 1], offset[:, 0])
        - pose.heading_rad
        + rng.normal(0, P.bearing_sd_rad, n),
    ]
    if bars:
        values.append(directions + rng.normal(0, P.direction_sd_rad, n))
        values.append(1.0 + rng.normal(0, P.length_sd_m, n))
    return Observations(np.stack(values, axis=1))


def driven(local: LocalMap, pose: Pose, rng: np.random.Generator, bars: bool, steps: int) -> Pose:
    for _ in range(steps):
        local.predict(0.1, 0.0, 0.05)
        sd = P.odom_position_sd_m * math.sqrt(0.1)
        turn = 0.05 + rng.normal(0.0, math.hypot(P.odom_drift_sd_rad * 0.3, 0.01))
        pose = composed(pose, Pose(0.1 + rng.normal(0.0, sd), rng.normal(0.0, sd), turn))
        local.observe(look(pose, rng, bars))
    return pose


@pytest.mark.parametrize('bars', [False, True])
def test_landmarks_of_last_metre_are_seen_from_robot(bars: bool) -> None:
    squared, freedom = 0.0, 0
    for seed in range(20):
        rng, local = np.random.default_rng(seed), LocalMap(P)
        pose = driven(local, Pose(0.0, 0.0, 0.0), rng, bars, 10)
        features = local.features()
        assert len(features) == len(LANDMARKS)
        c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
        true = (LANDMARKS - [pose.x_m, pose.y_m]) @ np.array([[c, -s], [s, c]])
        apart = np.linalg.norm(features.positions_m[:, None] - true[None], axis=2)
        names = apart.argmin(axis=1)
        assert sorted(names) == list(range(len(LANDMARKS)))
        errors = (features.positions_m - true[names]).ravel()
        rows = (features.offsets[:-1, None] + [0, 1]).ravel()
        covariance = features.covariance[np.ix_(rows, rows)]
        squared += float(errors @ np.linalg.solve(covariance, errors))
        freedom += len(errors)
    assert 0.75 < squared / freedom < 1.25


def test_one_moment_gives_uncorrelated_landmarks() -> None:
    local, rng = LocalMap(P), np.random.default_rng(0)
    seen = look(Pose(0.0, 0.0, 0.0), rng, True)
    local.observe(seen)
    features = local.features()
    ranges, bearings = seen.values[:, 0], seen.values[:, 1]
    expected = np.stack((ranges * np.cos(bearings), ranges * np.sin(bearings)), 1)
    assert features.positions_m == pytest.approx(expected, abs=1e-12)
    assert not features.covariance[:4, 4:].any()


def test_landmarks_are_dropped_after_the_distance() -> None:
    local = LocalMap(P)
    local.observe(Observations(np.array([[2.0, 0.0]])))
    local.predict(0.6, 0.0, 0.0)
    local.observe(Observations(np.array([[3.0, 1.5]])))
    local.predict(0.3, 0.0, 2.0)
    assert len(local) == 2
    local.predict(0.2, 0.0, 0.0)
    assert len(local) == 1
    local.predict(0.5, 0.5, 0.0)
    assert len(local) == 0


def packed(local: LocalMap) -> dict[str, bytes]:
    return {name: np.asarray(value).tobytes() for name, value in local.state().items()}


def test_uncertainty_is_bounded_on_a_long_way() -> None:
    """The origin follows the robot, so the covariance does not grow with the distance."""
    rng, local = np.random.default_rng(1), LocalMap(P)
    pose, largest = Pose(0.0, 0.0, 0.0), []
    for _ in range(8):
        pose = driven(local, pose, rng, False, 60)
        largest.append(float(np.diag(local.features().covariance).max()))
    assert max(largest[1:]) < 2.0 * largest[0]


def test_identifiers_of_observations_are_not_used() -> None:
    local, other, rng = LocalMap(P), LocalMap(P), np.random.default_rng(2)
    for k in range(5):
        seen = look(Pose(0.1 * k, 0.0, 0.0), rng, False)
        local.observe(seen)
        other.observe(replace(seen, identifiers=rng.permutation(len(seen)).astype(np.int64)))
        for each in (local, other):
            each.predict(0.1, 0.0, 0.0)
    assert packed(local) == packed(other)


def test_neighbours_seen_together_remain_two_landmarks() -> None:
    local = LocalMap(P)
    for _ in range(5):
        local.observe(Observations(np.array([[2.0, 0.0], [2.02, 0.03]])))
        local.predict(0.05, 0.0, 0.0)
    assert len(local) == 2


def test_nothing_seen_leaves_the_local_map_unchanged() -> None:
    local = LocalMap(P)
    local.observe(look(Pose(0.0, 0.0, 0.0), np.random.default_rng(5), True))
    local.observe(Observations(np.zeros((0, 2))))
    assert len(local) == len(LANDMARKS)
