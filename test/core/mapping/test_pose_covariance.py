# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Covariance of the pose: propagation, measurements and the chi-square bound."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.mapping.pose_covariance import (
    CHI_SQUARE_3,
    UNKNOWN,
    UNKNOWN_M2,
    OdometryVariance,
    PoseCovariance,
    isotropic,
    squared_distance,
)

NOISE = OdometryVariance(m2_per_m=4e-4, rad2_per_m=1e-3, rad2_per_rad=2e-4)
PATH = [Motion(1.0, 0.25, turn) for turn in (0.0, 0.2, 0.2, 0.0, -0.4, 0.0, 0.3, 0.3)]


def driven(path: list[Motion], start: Any = None) -> PoseCovariance:
    covariance = PoseCovariance()
    if start is not None:
        covariance.replace(start)
    for motion in path:
        covariance.integrate(motion, NOISE)
    return covariance


def test_propagation_agrees_with_the_errors_of_many_drives() -> None:
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(4000):
        truth = estimate = Pose(0.0, 0.0, 0.0)
        for motion in PATH:
            d = abs(motion.distance_m)
            x, y = rng.normal(0.0, math.sqrt(NOISE.m2_per_m * d), 2).tolist()
            turn_rad2 = NOISE.rad2_per_m * d + NOISE.rad2_per_rad * abs(motion.turn_rad)
            error = Pose(x, y, float(rng.normal(0.0, math.sqrt(turn_rad2))))
            estimate, truth = moved(estimate, motion), composed(moved(truth, motion), error)
        errors.append(composed(inverse(estimate), truth))
    expected = np.cov(np.array(errors).T)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((driven(PATH).matrix - expected) / scale).max() < 0.08


def test_covariance_on_the_map_turns_with_the_robot() -> None:
    covariance = driven([Motion(1.0, 0.25, 0.0)] * 40)
    along_m2, across_m2, _ = np.diag(covariance.matrix)
    assert along_m2 < across_m2
    on_map = covariance.on_map(math.pi / 2)
    assert np.diag(on_map)[:2] == pytest.approx([across_m2, along_m2])
    assert covariance.position_std_m == pytest.approx(math.sqrt(across_m2))


def test_fused_measurements_add_their_information() -> None:
    start, measured = driven(PATH, isotropic(0.3, 0.2)), isotropic(0.2, 0.1)
    expected = np.linalg.inv(np.linalg.inv(start.matrix) + np.linalg.inv(measured))
    start.fuse(measured)
    assert start.matrix == pytest.approx(expected)
    exact = PoseCovariance()
    exact.fuse(measured)
    assert not exact.matrix.any()


def test_limit_takes_the_better_of_two() -> None:
    covariance = PoseCovariance()
    covariance.replace(isotropic(0.3, 0.2))
    covariance.limit(isotropic(0.4, 0.1))
    assert covariance.position_std_m == pytest.approx(0.3)
    covariance.limit(isotropic(0.1, 0.1))
    assert covariance.position_std_m == pytest.approx(0.1)


def test_pose_within_the_bound_agrees() -> None:
    covariance, here = PoseCovariance(), Pose(5.0, -2.0, 2.0)
    covariance.replace(np.diag([0.04, 0.0, 0.0]))
    measured = np.diag([0.05, 0.01, 0.01])
    edge_m = math.sqrt(0.09 * CHI_SQUARE_3)
    for share, expected in ((0.99, True), (1.01, False)):
        ahead = composed(here, Pose(share * edge_m, 0.0, 0.0))
        assert covariance.agrees(here, ahead, measured) is expected
    assert squared_distance(here, composed(here, Pose(0.0, 0.0, 0.2)), measured) == (
        pytest.approx(4.0)
    )


def test_unknown_pose_stays_unknown_while_driving() -> None:
    covariance = PoseCovariance()
    covariance.lose('the robot may have been moved')
    covariance.integrate(Motion(1.0, 5.0, 0.0), NOISE)
    assert covariance.localisation == 'unknown'
    assert np.array_equal(covariance.matrix, UNKNOWN)
    covariance.limit(isotropic(0.1, 0.1))
    assert covariance.localisation == 'localised'


def test_covariance_is_bounded_on_long_drives() -> None:
    covariance = driven([Motion(1.0, 1000.0, 0.5)] * 100)
    assert covariance.localisation == 'uncertain'
    assert covariance.matrix[0, 0] <= 1.1 * UNKNOWN_M2
    assert covariance.agrees(Pose(0.0, 0.0, 0.0), Pose(900.0, 0.0, 3.0), isotropic(0.1, 0.1))


def test_alignment_replaces_the_noise_since_the_current_place() -> None:
    covariance, place = driven(PATH, isotropic(0.1, 0.05)), driven([])
    start = covariance.matrix.copy()
    covariance.relative = np.zeros((3, 3))
    for motion in PATH:
        covariance.integrate(motion, NOISE)
    place.replace(start)
    for motion in PATH:
        place.integrate(motion, OdometryVariance(0.0))
    covariance.align(isotropic(0.01, 0.002))
    assert covariance.matrix == pytest.approx(place.matrix + isotropic(0.01, 0.002))
    covariance.fuse(isotropic(0.3, 0.1))
    assert covariance.relative is None
