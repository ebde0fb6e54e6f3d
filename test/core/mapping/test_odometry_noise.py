# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of the odometry: what it is measured from, and what has no influence."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import ahead

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.odometry_noise import PRIOR_STD, OdometryNoise

LEG_M, SPACING_M = 6.0, 2.0


def driven(std: float, false: int = 0, legs: int = 400) -> OdometryNoise:
    """Drive straight legs between places; map and odometry both have errors.

    Args:
        std: of the position after one view spacing, in view spacings.
        false: every such leg ends with a recognition of a place far away; 0: none.
        legs: number of legs.
    """
    noise, random = OdometryNoise(), np.random.default_rng(1)
    std_m = std * SPACING_M * math.sqrt(LEG_M / SPACING_M)
    x_m = y_m = 0.0
    noise.recognise(Pose(0.0, 0.0, 0.0), 0.0, SPACING_M)
    for leg in range(1, legs):
        mapped, measured = random.normal(0.0, std_m, (2, 2))
        noise.integrate(ahead(LEG_M))
        x_m += LEG_M + mapped[0] - measured[0]
        y_m += mapped[1] - measured[1]
        apart_m = 50.0 if false and leg % false == 0 else 0.0
        noise.recognise(Pose(x_m, y_m + apart_m, 0.0), 0.0, SPACING_M)
    return noise


@pytest.mark.parametrize('std', [0.05, 0.6])
def test_std_is_that_of_one_drive(std: float) -> None:
    assert driven(std).std == pytest.approx(std, rel=0.15)


def test_false_recognitions_hardly_change_std() -> None:
    assert driven(0.1, false=10).std == pytest.approx(0.1, rel=0.3)


def test_covariances_are_definite_if_odometry_is_exact() -> None:
    covariance = driven(0.0).recognition(SPACING_M)
    assert np.linalg.eigvalsh(covariance)[0] > 0.0


def test_first_measurements_count_less_than_prior() -> None:
    assert driven(0.0, legs=8).std == pytest.approx(PRIOR_STD)


def test_unknown_motion_is_not_measured() -> None:
    noise = OdometryNoise()
    for x_m in range(100):
        noise.restart()
        noise.integrate(ahead(LEG_M))
        noise.recognise(Pose(50.0 * x_m, 0.0, 0.0), 0.0, SPACING_M)
    assert noise.std == pytest.approx(PRIOR_STD)


def test_restored_noise_continues_alike() -> None:
    noise, other = driven(0.3), OdometryNoise()
    other.restore(noise.state())
    for one in (noise, other):
        one.integrate(ahead(LEG_M))
        one.recognise(Pose(0.0, 0.0, 0.0), 0.2, SPACING_M)
    assert other.state() == noise.state()
