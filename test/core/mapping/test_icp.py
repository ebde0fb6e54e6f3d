# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scan alignment: point-to-line ICP with a prior."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rooms import Line, corridor
from scans import HALL, ORIGIN, ROOM, pose_error, scan_points

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping import icp
from ratslam_ros.core.mapping.scan_match import VIEW_SD_M


def align(reference: np.ndarray, points: np.ndarray, prior: Pose) -> Pose | None:
    alignment = icp.align(reference, points, prior, VIEW_SD_M)
    return None if alignment is None else alignment.pose


@given(
    st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-0.2, 0.2), st.floats(-0.08, 0.08),
    st.integers(0, 2**32 - 1),
)
def test_aligned_scans_of_a_room_give_the_pose(
    x: float, y: float, heading: float, prior_error_rad: float, seed: int
) -> None:
    true = Pose(x, y, heading)
    reference, points = scan_points(ROOM, ORIGIN), scan_points(ROOM, true)
    points = points + np.random.default_rng(seed).normal(0.0, 0.01, points.shape)
    found = align(reference, points, Pose(0.0, 0.0, heading + prior_error_rad))
    error_m, error_rad = pose_error(found, true)
    assert error_m < 0.05
    assert error_rad < 0.03


def test_bare_corridor_keeps_the_prior_along_its_axis() -> None:
    true = Pose(0.3, 0.2, 0.1)
    found = align(scan_points(corridor(1.0), ORIGIN), scan_points(corridor(1.0), true), ORIGIN)
    assert found is not None
    assert found.x_m == pytest.approx(0.0, abs=0.05)
    assert found.y_m == pytest.approx(0.2, abs=0.02)
    assert found.heading_rad == pytest.approx(0.1, abs=0.02)


def test_scans_of_different_places_are_not_aligned() -> None:
    assert align(scan_points(ROOM, ORIGIN), scan_points(HALL, ORIGIN), ORIGIN) is None


def test_person_in_the_room_does_not_disturb_alignment() -> None:
    person: Line = [(1.0, 0.2), (1.2, 0.5), (1.4, 0.2), (1.0, 0.2)]
    true = Pose(0.2, -0.1, 0.05)
    found = align(scan_points(ROOM, ORIGIN), scan_points([*ROOM, person], true), ORIGIN)
    error_m, error_rad = pose_error(found, true)
    assert error_m < 0.05
    assert error_rad < 0.03


def test_scans_with_too_few_points_are_not_aligned() -> None:
    points = scan_points(ROOM, ORIGIN)
    assert align(points[:20], points, ORIGIN) is None
    assert align(points, np.empty((0, 2)), ORIGIN) is None


def test_covariance_agrees_with_the_errors_of_many_scans() -> None:
    """Where the walls say nothing, the covariance is that of the prior, not of its weight."""
    rng, true = np.random.default_rng(1), Pose(0.3, 0.1, 0.1)
    prior_std = np.array([0.02, 0.02, 0.01])
    for walls in (ROOM, corridor(1.0)):
        nees = []
        for _ in range(60):
            scans = [scan_points(walls, pose) for pose in (ORIGIN, true)]
            reference, points = (one + rng.normal(0.0, 0.01, one.shape) for one in scans)
            x_m, y_m, heading_rad = (true + rng.normal(0.0, prior_std)).tolist()
            prior = Pose(x_m, y_m, heading_rad)
            found = icp.align(reference, points, prior, 0.05, np.diag(prior_std**2))
            assert found is not None
            error = np.array(true) - np.array(found.pose)
            nees.append(error @ np.linalg.solve(found.covariance, error))
        assert 1.5 < np.mean(nees) < 6.0
