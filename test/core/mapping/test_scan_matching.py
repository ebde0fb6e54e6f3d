# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scan matching: the robot's pose relative to experiences by the scans of both visits."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from rooms import Line, corridor, scan_in
from scans import HALL, ORIGIN, ROOM, TICK_NS, drive, map_action, pose_error

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.scan import Scan, points_of
from ratslam_ros.core.mapping.odometry_noise import UNMEASURED
from ratslam_ros.core.mapping.pose_covariance import PoseCovariance, isotropic
from ratslam_ros.core.mapping.scan_match import ScanMatch
from ratslam_ros.core.mapping.scan_matching import MAX_SCAN_AGE_NS, ScanMatcher
from ratslam_ros.core.pose_cells.map_action import MapAction


def locate(matcher: ScanMatcher, tick: int, action: MapAction) -> Pose | None:
    """Return the robot's pose in the frame of the action's target, without map estimates."""
    return matcher.locate(tick * TICK_NS, action, -1, ORIGIN).from_target


# Stored scans


def test_scan_is_transformed_to_the_action_stamp() -> None:
    matcher = ScanMatcher()
    created_at, tick = drive(matcher, ROOM, ORIGIN, 0, 5)
    match = matcher.locate(tick * TICK_NS, map_action('create', 0), -1, ORIGIN)
    assert match == ScanMatch(fits=match.fits, driven_m=match.driven_m)
    recognised_at, tick = drive(matcher, ROOM, Pose(-0.1, 0.2, 0.1), tick, 5)
    found = locate(matcher, tick, map_action('link', 0, 0.1))
    error_m, error_rad = pose_error(found, composed(inverse(created_at), recognised_at))
    assert error_m < 0.03
    assert error_rad < 0.02


def test_experience_frame_is_rotated_by_relative_heading() -> None:
    matcher = ScanMatcher()
    _, tick = drive(matcher, ROOM, ORIGIN, 0, 4, still=True)
    locate(matcher, tick, map_action('create', 0, 0.15))
    _, tick = drive(matcher, ROOM, ORIGIN, tick, 4, still=True)
    found = locate(matcher, tick, map_action('link', 0, 0.1))
    error_m, error_rad = pose_error(found, Pose(0.0, 0.0, 0.15))
    assert error_m < 0.01
    assert error_rad < 0.01


def test_locate_without_fresh_scan_returns_none() -> None:
    matcher = ScanMatcher()
    locate(matcher, 0, map_action('create', 0))
    _, tick = drive(matcher, ROOM, ORIGIN, 0, 4, still=True)
    assert locate(matcher, tick, map_action('link', 0)) is None  # created without a scan
    locate(matcher, tick, map_action('create', 1))
    assert locate(matcher, tick, map_action('link', 1)) is not None
    assert locate(matcher, tick, map_action('none', 1)) is None
    assert locate(matcher, tick + 10, map_action('link', 1)) is None
    matcher.restart()
    assert locate(matcher, tick, map_action('link', 1)) is None


def test_create_with_used_id_replaces_its_scan() -> None:
    matcher = ScanMatcher()
    _, tick = drive(matcher, HALL, ORIGIN, 0, 4, still=True)
    locate(matcher, tick, map_action('create', 0))
    _, tick = drive(matcher, ROOM, ORIGIN, tick, 4, still=True)
    assert locate(matcher, tick, map_action('link', 0)) is None
    locate(matcher, tick, map_action('create', 0))
    assert locate(matcher, tick, map_action('set', 0)) is not None


def test_stamp_jump_back_discards_older_scans() -> None:
    matcher = ScanMatcher()
    _, tick = drive(matcher, ROOM, ORIGIN, 50, 4, still=True)
    locate(matcher, tick, map_action('create', 0))
    _, tick = drive(matcher, HALL, ORIGIN, 0, 4, still=True)
    assert locate(matcher, tick, map_action('link', 0)) is None


# Several lasers


def turned_scan(walls: list[Line], stamp_ns: int, laser: int) -> Scan:
    """Return the scan of a half laser at the origin: laser 0 looks ahead, laser 1 back."""
    seen = scan_in(walls, Pose(0.0, 0.0, laser * math.pi), stamp_ns, beams=181)
    return replace(seen, angle_min_rad=seen.angle_min_rad + laser * math.pi, laser=laser)


def two_lasers(rear_ns: int) -> ScanMatcher:
    """Return a matcher with an experience seen by a front scan at 1 s and an earlier rear scan."""
    matcher = ScanMatcher()
    for tick in range(11):
        matcher.integrate(tick * TICK_NS, Motion(0.1, 0.0, 0.0))
    matcher.scan(turned_scan(ROOM, rear_ns, 1))
    matcher.scan(turned_scan(ROOM, 10 * TICK_NS, 0))
    locate(matcher, 10, map_action('create', 0))
    return matcher


def test_newest_scans_of_all_lasers_are_stored_together() -> None:
    matcher = two_lasers(10 * TICK_NS)
    points = matcher.reference(0)
    assert points is not None
    expected = [points_of(turned_scan(ROOM, 0, laser)) for laser in (0, 1)]
    assert points == pytest.approx(np.concatenate(expected), abs=1e-5)
    observed = matcher.observed(10 * TICK_NS)
    assert observed is not None
    assert [scan.laser for scan, _ in observed.scans] == [0, 1]
    copy = ScanMatcher()
    copy.restore(matcher.state())
    again = copy.observed(10 * TICK_NS)
    assert again is not None
    assert np.array_equal(again.points, observed.points)


def test_each_laser_is_moved_by_the_motion_since_its_scan() -> None:
    matcher = ScanMatcher()
    for tick in range(3):
        matcher.integrate(tick * TICK_NS, Motion(0.1, 0.1, 0.0))
        matcher.scan(turned_scan(ROOM, tick * TICK_NS, tick % 2))
    observed = matcher.observed(2 * TICK_NS)
    assert observed is not None
    assert [pose.x_m for _, pose in observed.scans] == pytest.approx([0.0, -0.1])


def test_laser_without_recent_scans_is_left_out() -> None:
    points = two_lasers(10 * TICK_NS - MAX_SCAN_AGE_NS - 1).reference(0)
    assert points is not None
    assert len(points) == len(points_of(turned_scan(ROOM, 0, 0)))


# The pose relative to the current experience


def test_pose_from_current_experience_corrects_odometry() -> None:
    matcher = ScanMatcher()
    created_at, tick = drive(matcher, ROOM, ORIGIN, 0, 5)
    locate(matcher, tick, map_action('create', 0))
    pose, tick = drive(matcher, ROOM, created_at, tick, 5)
    true = composed(inverse(created_at), pose)
    odometry = Pose(true.x_m + 0.02, true.y_m, true.heading_rad + 0.1)  # with wheel slip
    found = matcher.locate(tick * TICK_NS, map_action('create', 1), 0, odometry)
    assert found.from_target is None
    error_m, error_rad = pose_error(found.from_current, true)
    assert error_m < 0.02
    assert error_rad < 0.01


# View or map


def drive_on_in_corridor(matcher: ScanMatcher, distance_m: float) -> tuple[int, PoseCovariance]:
    """Create experience 0 in a bare corridor, and drive on from an accurate pose.

    Returns:
        The time in ticks, and the covariance of the pose.
    """
    _, tick = drive(matcher, corridor(1.0), ORIGIN, 0, 4, still=True)
    locate(matcher, tick, map_action('create', 0))
    motion, covariance = Motion(0.1, distance_m, 0.0), PoseCovariance()
    covariance.replace(isotropic(0.05, 0.02))
    covariance.integrate(motion, UNMEASURED)
    matcher.integrate(tick * TICK_NS, motion)
    _, tick = drive(matcher, corridor(1.0), ORIGIN, tick, 4, still=True)
    return tick, covariance


@pytest.mark.parametrize(
    ('distance_m', 'expected_m', 'min_m', 'max_m'),
    [
        (1.0, 0.6, 0.45, 0.6),  # shortly after a recognition the map is more accurate
        (20.0, 0.6, -0.05, 0.05),  # long after it, the view is more accurate
        (1.0, 4.0, -0.05, 0.05),  # the map disagrees, and is ignored
    ],
)
def test_corridor_axis_keeps_the_better_of_view_and_map(
    distance_m: float, expected_m: float, min_m: float, max_m: float
) -> None:
    matcher = ScanMatcher()
    tick, covariance = drive_on_in_corridor(matcher, distance_m)
    expected = Pose(expected_m, 0.0, 0.0)
    link = map_action('link', 0)
    match = matcher.locate(tick * TICK_NS, link, -1, ORIGIN, expected, covariance)
    found = match.from_target
    assert found is not None
    assert min_m <= found.x_m <= max_m


@pytest.mark.parametrize(
    ('distance_m', 'expected', 'min_m', 'max_m'),
    [
        (1.0, Pose(0.6, 0.0, 0.1), 0.45, 0.6),
        (20.0, Pose(0.6, 0.0, 0.1), math.nan, math.nan),
        (1.0, Pose(4.0, 0.0, 0.1), math.nan, math.nan),
        (1.0, Pose(0.6, 0.0, 1.5), math.nan, math.nan),
    ],
)
def test_unmatched_scan_falls_back_to_view_or_map(
    distance_m: float, expected: Pose, min_m: float, max_m: float
) -> None:
    """A view that is recognised 1 m early does not displace a robot whose pose is accurate."""
    matcher = ScanMatcher()
    tick, covariance = drive_on_in_corridor(matcher, distance_m)
    _, tick = drive(matcher, HALL, ORIGIN, tick, 4, still=True)
    link = map_action('link', 0)
    found = matcher.locate(
        tick * TICK_NS, link, -1, ORIGIN, expected, covariance
    ).from_target
    if math.isnan(min_m):
        assert found is None
    else:
        assert found is not None
        assert min_m <= found.x_m <= max_m
        assert 0.0 < found.heading_rad <= 0.1
    later_ns = (tick + 10) * TICK_NS
    assert matcher.locate(later_ns, link, -1, ORIGIN, expected, covariance) == ScanMatch()


def test_view_dominates_an_unknown_pose() -> None:
    matcher = ScanMatcher()
    tick, covariance = drive_on_in_corridor(matcher, 0.0)
    covariance.lose('the robot may have been moved')
    expected, link = Pose(0.6, 0.0, 0.0), map_action('link', 0)
    found = matcher.locate(
        tick * TICK_NS, link, -1, ORIGIN, expected, covariance
    ).from_target
    assert found is not None
    assert abs(found.x_m) < 0.05


# Confirmation of the pose


def scan_fits(walls: list[Line], later_walls: list[Line], error_m: float = 0.0) -> bool:
    """Return whether a scan of ``later_walls`` fits an experience that was created in ``walls``.

    ``error_m``: error of the expected pose along x.
    """
    matcher = ScanMatcher()
    created_at, tick = drive(matcher, walls, ORIGIN, 0, 5)
    matcher.locate(tick * TICK_NS, map_action('create', 0), -1, ORIGIN)
    pose, tick = drive(matcher, later_walls, Pose(-0.1, 0.2, 0.1), tick, 5)
    expected = composed(inverse(created_at), pose)
    fits = matcher.locate(tick * TICK_NS, map_action('link', 5), 5, ORIGIN).fits
    assert fits is not None
    return fits(0, expected._replace(x_m=expected.x_m + error_m))


def test_scan_fits_only_close_to_the_expected_pose() -> None:
    assert scan_fits(ROOM, ROOM)
    assert scan_fits(ROOM, ROOM, 0.2)
    assert not scan_fits(ROOM, ROOM, 1.0)
    assert not scan_fits(ROOM, HALL)


def test_scan_of_bare_corridor_never_fits() -> None:
    assert not scan_fits(corridor(1.0), corridor(1.0))


def test_scan_does_not_fit_experience_without_scan() -> None:
    matcher = ScanMatcher()
    assert matcher.locate(0, map_action('link', 0), 0, ORIGIN).fits is None
    _, tick = drive(matcher, ROOM, ORIGIN, 0, 4, still=True)
    fits = matcher.locate(tick * TICK_NS, map_action('link', 0), 0, ORIGIN).fits
    assert fits is not None
    assert not fits(0, ORIGIN)
