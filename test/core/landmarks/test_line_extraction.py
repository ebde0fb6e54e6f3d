# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Walls, corners and edges from laser scans."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from laser_rooms import CORNERS, MOUNTS, ROOM, full_turn, mounted_scan, noisy_scan
from numpy.typing import NDArray
from rooms import Line, scan_in, scan_of_ranges

from ratslam_ros.core.common.mount import CENTRED, Mount
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.landmarks.line_extraction import (
    LaserLandmarks,
    extract_landmarks,
    observations_of,
)
from ratslam_ros.core.landmarks.line_kernels import find_walls, ordered_beams
from ratslam_ros.core.landmarks.models import LaserModel
from ratslam_ros.core.landmarks.wall_end_kernels import CORNER, EDGE

PARAMETERS = LaserModel()
EXACT = LaserModel(range_sd_m=0.01, wall_sd_m=0.001)
"""The noise of the tests' laser, and straight walls."""


def bars(found: LaserLandmarks, kind: int) -> NDArray[np.float64]:
    """Return the (n, 4) values of the landmarks of a kind."""
    return found.features.values.reshape(-1, 4)[found.kinds == kind]


def wall_count(scan: Scan, p: LaserModel) -> int:
    """Return the number of walls in a scan, whatever their ends."""
    beams = ordered_beams(
        scan.ranges_m, scan.angle_min_rad, scan.angle_increment_rad, p.max_range_m
    )
    return len(find_walls(*beams, p.range_sd_m, p.wall_sd_m, p.min_length_m)[0])


def on_map(pose: Pose, bar: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x, y and direction of a bar in the frame of the room."""
    c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    x, y, direction = bar[:3]
    return np.array([pose.x_m + c * x - s * y, pose.y_m + s * x + c * y,
                     math.remainder(direction + pose.heading_rad, math.tau)])


def test_rectangle_gives_its_corners() -> None:
    room: list[Line] = [[(-2.0, -1.0), (3.0, -1.0), (3.0, 2.0), (-2.0, 2.0), (-2.0, -1.0)]]
    found = extract_landmarks(full_turn(room, Pose(0.0, 0.0, 0.0)), PARAMETERS)
    corners = bars(found, CORNER)
    assert len(found.kinds) == len(corners) == 4
    turned = corners[np.argsort(np.arctan2(corners[:, 1], corners[:, 0]))]
    expected = [(-2, -1, 0.25), (3, -1, 0.75), (3, 2, -0.75), (-2, 2, -0.25)]
    for corner, (x, y, share) in zip(turned, expected, strict=True):
        assert corner[:2] == pytest.approx((x, y), abs=0.01)
        assert math.remainder(corner[2] - share * math.pi, math.tau) == pytest.approx(0, abs=0.01)


def test_convex_corner_opens_towards_the_robot() -> None:
    found = extract_landmarks(
        scan_in([[(4.0, -2.0), (2.0, 0.0), (4.0, 2.0)]], beams=361), PARAMETERS
    )
    [(x, y, direction, length)] = bars(found, CORNER)
    assert (x, y, length) == pytest.approx((2.0, 0.0, 0.0), abs=0.01)
    assert abs(math.remainder(direction - math.pi, math.tau)) < 0.01


def test_wall_before_free_space_has_two_edges() -> None:
    walls: list[Line] = [[(2.0, 1.0), (2.0, -1.0)], [(5.0, 5.0), (5.0, -5.0)]]
    found = extract_landmarks(scan_in(walls, beams=721), PARAMETERS)
    edges = bars(found, EDGE)
    assert edges[:, :2] == pytest.approx(np.array([(2.0, -1.0), (2.0, 1.0)]), abs=0.02)
    # Each looks along the wall.
    assert edges[:, 2] == pytest.approx([math.pi / 2, -math.pi / 2], abs=0.01)
    # The wall behind is cut by the one before it, and by the field of view.
    assert len(found.kinds) == 2


def test_person_before_a_wall_does_not_cut_it() -> None:
    walls: list[Line] = [[(3.0, 3.0), (3.0, -3.0)], [(3.0, 3.0), (-1.0, 3.0)],
                         [(3.0, -3.0), (-1.0, -3.0)]]
    scan = noisy_scan(
        walls, Pose(0, 0, 0), np.random.default_rng(1), people=((1.8, 0.2), (0.2, -1.6))
    )
    found = extract_landmarks(scan, PARAMETERS)
    assert len(bars(found, EDGE)) == 0
    corners = bars(found, CORNER)
    assert corners[:, :2] == pytest.approx(np.array([(3.0, -3.0), (3.0, 3.0)]), abs=0.06)


def test_people_alone_are_no_landmarks() -> None:
    rng = np.random.default_rng(2)
    hits = 0
    for _ in range(300):
        at = rng.uniform(0.6, 6.0), rng.uniform(-1.0, 1.0)
        scan = noisy_scan([], Pose(0, 0, 0), rng, people=(at,), beams=181)
        found = extract_landmarks(scan, PARAMETERS)
        hits += len(found.kinds)
        assert np.isfinite(scan.ranges_m).any()
    assert hits == 0


def test_landmarks_are_where_their_covariance_says() -> None:
    """NEES of corners and edges seen from all over the room, at the true noise."""
    rng = np.random.default_rng(3)
    squared: list[float] = []
    count = 0
    for _ in range(150):
        pose = Pose(rng.uniform(-2.5, 1.5), rng.uniform(-1.5, 1.0), rng.uniform(-3, 3))
        found = extract_landmarks(noisy_scan(ROOM, pose, rng), EXACT)
        offsets, covariance = found.features.offsets, found.features.covariance
        for index in range(len(found.kinds)):
            at = offsets[index]
            seen = on_map(pose, found.features.values[at : at + 4])
            true = CORNERS[np.argmin(np.hypot(*(CORNERS - seen[:2]).T))]
            assert math.dist(seen[:2], true) < 0.2
            # Corners look along diagonals, edges along walls.
            quarter = math.pi / 4 if found.kinds[index] == CORNER else 0.0
            turn = math.remainder(seen[2] - quarter, math.pi / 2)
            c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
            d_x, d_y = seen[:2] - true
            error = np.array([c * d_x + s * d_y, -s * d_x + c * d_y, turn])
            block = covariance[at : at + 3, at : at + 3]
            squared.append(error @ np.linalg.solve(block, error) / 3.0)
            count += 1
    assert count > 500
    assert 0.5 < np.mean(squared) < 1.3
    assert np.mean(np.array(squared) > 5.42) < 0.01  # 0.1 % if it were normal


def test_full_turn_does_not_depend_on_its_first_beam() -> None:
    scan = full_turn(ROOM, Pose(-1.0, 0.3, 0.4))
    expected = extract_landmarks(scan, PARAMETERS)
    for shift in (1, 100, 333):
        turned = Scan(0, scan.angle_min_rad + shift * scan.angle_increment_rad,
                      scan.angle_increment_rad, np.roll(scan.ranges_m, -shift))
        found = extract_landmarks(turned, PARAMETERS)
        assert sorted(found.kinds.tolist()) == sorted(expected.kinds.tolist())
        # A beam that hits a corner belongs to either wall.
        for bar in expected.features.positions_m:
            distances = np.hypot(*(found.features.positions_m - bar).T)
            assert distances.min() < 0.005


@settings(max_examples=40, deadline=None)
@given(turn=st.floats(-3.0, 3.0), seed=st.integers(0, 100))
def test_turned_laser_turns_all_landmarks(turn: float, seed: int) -> None:
    scan = noisy_scan(ROOM, Pose(0, 0, 0.5), np.random.default_rng(seed))
    turned = Scan(0, scan.angle_min_rad + turn, scan.angle_increment_rad, scan.ranges_m)
    expected, found = (extract_landmarks(one, PARAMETERS) for one in (scan, turned))
    assert found.kinds.tolist() == expected.kinds.tolist()
    for before, after in zip(
        expected.features.values.reshape(-1, 4), found.features.values.reshape(-1, 4), strict=True
    ):
        x, y, direction = on_map(Pose(0, 0, turn), before)
        assert after[:2] == pytest.approx((x, y), abs=1e-6)
        assert math.remainder(after[2] - direction, math.tau) == pytest.approx(0.0, abs=1e-6)
        assert after[3] == pytest.approx(before[3], abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(
    ranges=st.lists(
        st.one_of(st.floats(-1.0, 12.0), st.sampled_from([math.nan, math.inf, -math.inf, 0.0])),
        max_size=60,
    ),
    step=st.floats(-0.1, 0.1).filter(lambda value: abs(value) > 1e-3),
)
def test_any_ranges_give_finite_landmarks(ranges: list[float], step: float) -> None:
    found = extract_landmarks(Scan(0, -1.0, step, np.array(ranges, np.float64)), PARAMETERS)
    covariance = found.features.covariance
    assert np.isfinite(found.features.values).all() and np.isfinite(covariance).all()
    assert (covariance == covariance.T).all()
    assert len(covariance) == 0 or np.linalg.eigvalsh(covariance).min() > 0.0


def test_joint_covariance_is_positive_and_ties_the_ends_of_a_wall() -> None:
    found = extract_landmarks(full_turn(ROOM, Pose(-1.0, 0.3, 0.4)), PARAMETERS)
    covariance = found.features.covariance
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    first, second = found.features.offsets[:2]
    assert (covariance[first, second : second + 3] != 0.0).any()


def test_scan_without_walls_is_empty() -> None:
    for ranges in ([], [1.0], [math.nan] * 30, [-1.0] * 30, [math.inf] * 30):
        found = extract_landmarks(scan_of_ranges(np.array(ranges, np.float64)), PARAMETERS)
        assert len(found.kinds) == 0 and found.features.covariance.shape == (0, 0)
        assert len(observations_of(found.features)) == 0


def test_wall_along_the_beams_gives_no_landmark() -> None:
    """No beam at the ends of the wall meets the line that fits it."""
    ranges = np.full(721, math.nan)
    ranges[491:497] = 0.619, 0.679, 0.763, 0.886, 1.049, 1.226
    scan = Scan(0, -math.pi / 2, math.radians(0.25), ranges)
    model = LaserModel(min_length_m=0.25)
    assert (len(extract_landmarks(scan, model).kinds), wall_count(scan, model)) == (0, 1)


def test_lost_beams_do_not_cut_a_wall() -> None:
    scan = scan_in([[(2.0, 3.0), (2.0, -3.0)]], beams=181)
    ranges = scan.ranges_m.copy()
    ranges[[80, 95, 96]] = math.nan
    assert wall_count(scan_of_ranges(ranges), PARAMETERS) == 1


def test_observations_have_the_variance_of_their_landmarks() -> None:
    rng = np.random.default_rng(5)
    found = extract_landmarks(noisy_scan(ROOM, Pose(0, 0, 0.5), rng), EXACT)
    seen = observations_of(found.features)
    assert seen.variances is not None and (seen.variances > 0.0).all()
    x, y = found.features.positions_m.T
    ranges, bearings, directions, lengths = seen.values.T
    assert ranges == pytest.approx(np.hypot(x, y))
    assert bearings == pytest.approx(np.arctan2(y, x))
    at = found.features.offsets[:-1]
    total = np.diag(found.features.covariance)[at] + np.diag(found.features.covariance)[at + 1]
    rotated = seen.variances[:, 0] + ranges**2 * seen.variances[:, 1]
    assert rotated == pytest.approx(total)
    bars = found.features.values.reshape(-1, 4)
    assert (np.stack((directions, lengths), axis=1) == bars[:, 2:]).all()


@pytest.mark.parametrize('mount', MOUNTS[1:])
def test_landmarks_are_those_of_a_centred_laser(mount: Mount) -> None:
    expected, corners = (
        bars(extract_landmarks(mounted_scan(m), EXACT), CORNER) for m in (CENTRED, mount)
    )
    nearest = np.hypot(*(corners[:, None, :2] - expected[None, :, :2]).transpose(2, 0, 1))
    match = nearest.argmin(axis=1)
    is_same = nearest.min(axis=1) < 0.02
    assert is_same.sum() >= 4  # The others are hidden behind the cupboard for one of the two.
    turn = corners[is_same, 2] - expected[match[is_same], 2]
    assert np.abs(np.sin(turn / 2)).max() < 0.02
