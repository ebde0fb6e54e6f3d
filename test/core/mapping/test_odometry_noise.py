# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of the odometry: what it is measured from, and what has no influence."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import ahead

from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.odometry_noise import PRIOR_STD, PRIOR_STD_RAD, OdometryNoise

LEG_M, SPACING_M = 2.0, 2.0


def driven(
    std: float, std_rad: float = 0.0, view_std: float = 0.0, bias_rad: float = 0.0,
    false: int = 0, legs: int = 2000,
) -> OdometryNoise:
    """Drive straight legs between places of an exact map, with noise of one drive in two.

    Args:
        std, std_rad: of odometry after one view spacing: position in view spacings, and heading.
        view_std: of the position of a recognition, in view spacings.
        bias_rad: error of the heading of each leg.
        false: every such leg ends with a recognition of a place far away; 0: none.
        legs: number of legs.
    """
    noise, random = OdometryNoise(), np.random.default_rng(1)
    here = Pose(0.0, 0.0, 0.0)
    for leg in range(1, legs):
        # The differences are those of two drives, so that one has twice the variance here.
        along, sideways = random.normal(0.0, math.sqrt(2.0) * std * SPACING_M, 2)
        turn_rad = random.normal(bias_rad, math.sqrt(2.0) * std_rad)
        noise.integrate(Motion(0.1, 0.0, math.pi / 2.0))
        noise.integrate(ahead(sideways))
        noise.integrate(Motion(0.1, 0.0, -math.pi / 2.0))
        noise.integrate(Motion(0.1, LEG_M + along, turn_rad))
        here = moved(here, Motion(0.1, LEG_M, 0.0))
        x_m, y_m = random.normal(0.0, math.sqrt(2.0) * view_std * SPACING_M, 2)
        apart_m = 50.0 if false and leg % false == 0 else 0.0
        place = Pose(here.x_m + x_m, here.y_m + y_m + apart_m, here.heading_rad)
        noise.recognise(place, 0.0, SPACING_M)
    return noise


@pytest.mark.parametrize('std', [0.05, 0.4])
def test_std_is_that_of_one_drive(std: float) -> None:
    assert driven(std).std == pytest.approx(std, rel=0.3)


def test_errors_of_recognitions_do_not_count() -> None:
    noise = driven(0.1, 0.03, view_std=0.3)
    assert noise.std == pytest.approx(0.1, rel=0.4)
    assert noise.std_rad == pytest.approx(0.03, rel=0.2)


def test_heading_covers_the_longest_drift() -> None:
    """A bias of 0.02 rad for each spacing is 1.3 rad after 64 of them."""
    assert driven(0.05, 0.01, bias_rad=0.02).std_rad > 0.1


def test_false_recognitions_hardly_change_std() -> None:
    noise = driven(0.1, 0.03, false=10)
    assert noise.std == pytest.approx(0.1, rel=0.4)
    assert noise.std_rad == pytest.approx(0.03, rel=0.2)


def test_covariances_are_definite_if_odometry_is_exact() -> None:
    covariance = driven(0.0).recognition(SPACING_M)
    assert np.linalg.eigvalsh(covariance)[0] > 0.0


def test_few_differences_measure_nothing() -> None:
    noise = driven(0.0, legs=8)
    assert (noise.std, noise.std_rad) == (PRIOR_STD, PRIOR_STD_RAD)


def test_unknown_motion_is_not_measured() -> None:
    noise = OdometryNoise()
    for x_m in range(100):
        noise.restart()
        noise.integrate(ahead(LEG_M))
        noise.recognise(Pose(50.0 * x_m, 0.0, 0.0), 0.0, SPACING_M)
    assert (noise.std, noise.std_rad) == (PRIOR_STD, PRIOR_STD_RAD)
