# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
from itertools import pairwise

import numpy as np
import pytest
from floor_clearance import clearance_m

from ratslam_simulator.camera import CameraOptions
from ratslam_simulator.drive import rounded_path
from ratslam_simulator.floor_plan import office
from ratslam_simulator.office_tour import OfficeTour
from ratslam_simulator.samples import ImageSample, OdometrySample
from ratslam_simulator.simulation import START_STAMP_NS, SimulationOptions

# Tiny images at a low rate: these tests check the motion only.
BLIND = SimulationOptions(camera=CameraOptions(width=4, height=2, rate_hz=1))


@pytest.fixture(scope='module')
def tour():
    return [s for s in OfficeTour(5, options=BLIND) if isinstance(s, OdometrySample)]


def poses(samples):
    return np.array([(s.truth.x_m, s.truth.y_m, s.truth.heading_rad) for s in samples])


def test_rounded_path_has_radius_and_equal_spacing():
    path = rounded_path([(0.0, 0.0), (5.0, 0.0), (5.0, 5.0)], corner_radius_m=1.0)
    steps_m = np.hypot(*np.diff(path, axis=0).T)
    assert np.allclose(steps_m, 0.05, atol=1e-3)
    centre_m = np.hypot(path[:, 0] - 4.0, path[:, 1] - 1.0)
    assert centre_m.min() == pytest.approx(1.0, abs=2e-3)


def test_tour_yields_odometry_at_20_hz_images_at_8():
    samples = list(OfficeTour(0, duration_s=3.0))
    odometry = [s.stamp_ns for s in samples if isinstance(s, OdometrySample)]
    images = [s.stamp_ns for s in samples if isinstance(s, ImageSample)]
    assert odometry == list(range(START_STAMP_NS, START_STAMP_NS + 3 * 10**9 + 1, 50_000_000))
    assert images == list(range(START_STAMP_NS, START_STAMP_NS + 3 * 10**9 + 1, 125_000_000))
    for before, after in pairwise(samples):
        assert before.stamp_ns < after.stamp_ns or (
            before.stamp_ns == after.stamp_ns
            and isinstance(before, OdometrySample)
            and isinstance(after, ImageSample)
        )


def test_longer_tour_starts_like_shorter_one():
    short, long = (list(OfficeTour(1, duration_s=s, options=BLIND)) for s in (2.0, 5.0))
    assert np.array_equal(poses(short), poses(long)[: len(short)])


def test_tour_has_expected_duration_speed_and_stops(tour):
    duration_s = (tour[-1].stamp_ns - tour[0].stamp_ns) / 1e9
    assert 360.0 < duration_s < 480.0
    speeds_mps = np.array([s.odometry.speed_mps for s in tour])
    assert 0.4 < np.median(speeds_mps) < 0.6
    resting = speeds_mps == 0.0
    rests = np.flatnonzero(np.diff(resting.astype(int)) == 1)
    assert len(rests) >= 3
    assert np.abs(np.diff(speeds_mps)).max() < 0.1


def test_tour_keeps_distance_from_walls(tour):
    plan = office()
    clearances_m = [clearance_m(plan, s.truth.x_m, s.truth.y_m) for s in tour[::10]]
    assert min(clearances_m) > 0.4


def test_tour_revisits_places_with_lateral_offset(tour):
    seen = poses(tour[::10])
    turn_rad = np.angle(np.exp(1j * (seen[:, None, 2] - seen[None, :, 2])))
    distance_m = np.hypot(*(seen[:, None, :2] - seen[None, :, :2]).transpose(2, 0, 1))
    index = np.arange(len(seen))
    before = index[None, :] < index[:, None] - 40  # 20 s ago or more
    revisit = before & (distance_m < 0.5) & (np.abs(turn_rad) < np.radians(15))
    assert revisit.any(axis=1).mean() > 0.5
    closest_m = np.where(revisit, distance_m, np.inf).min(axis=1)
    assert 0.01 < np.median(closest_m[np.isfinite(closest_m)]) < 0.2


def test_tour_dead_reckoning_error_is_metres(tour):
    truth = np.array([s.truth.x_m + 1j * s.truth.y_m for s in tour])
    reckoned = np.array([s.odometry.pose.x_m + 1j * s.odometry.pose.y_m for s in tour])
    truth, reckoned = truth - truth.mean(), reckoned - reckoned.mean()
    turn = np.vdot(reckoned, truth)
    ate_m = np.sqrt(np.mean(np.abs(truth - turn / abs(turn) * reckoned) ** 2))
    assert 1.0 < ate_m < 6.0
