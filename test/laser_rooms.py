# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scans of rooms with noise and people, for the tests of landmarks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from rooms import Line, scan_in

from ratslam_ros.core.common.mount import CENTRED, Mount
from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.common.scan import Scan, checked_scan

ROOM: list[Line] = [
    [(-3.0, -2.0), (4.0, -2.0), (4.0, 1.5), (1.0, 1.5), (1.0, 3.0), (-3.0, 3.0), (-3.0, -2.0)],
    [(2.0, -0.8), (2.8, -0.8), (2.8, 0.0), (2.0, 0.0), (2.0, -0.8)],
]
"""Room with an alcove and a cupboard."""

ROBOT = Pose(-1.0, 0.5, 0.4)
"""A pose of the robot in it."""

MOUNTS = [
    CENTRED, Mount(0.3, 0.0, math.pi), Mount(0.1, -0.2, 1.0), Mount(0.3, 0.1, -2.0, True),
]
"""Places of a laser on the robot."""

CORNERS = np.array([point for line in ROOM for point in line[:-1]])
"""(10, 2) positions of its corners, in m."""


def noisy_scan(
    walls: list[Line], pose: Pose, rng: np.random.Generator, sd_m: float = 0.01,
    people: tuple[tuple[float, float], ...] = (), beams: int = 361, stamp_ns: int = 0,
) -> Scan:
    """Return a scan over 180 degrees with noise, and with people at positions in the room."""
    scan = scan_in(walls, pose, stamp_ns, beams)
    ranges = scan.ranges_m.copy()
    angles = pose.heading_rad + scan.angle_min_rad + scan.angle_increment_rad * np.arange(beams)
    for x_m, y_m in people:
        ranges = np.minimum(ranges, _ranges_to_person(x_m - pose.x_m, y_m - pose.y_m, angles))
    ranges += sd_m * rng.standard_normal(beams)
    return Scan(stamp_ns, scan.angle_min_rad, scan.angle_increment_rad, ranges)


def _ranges_to_person(
    x_m: float, y_m: float, angles: NDArray[np.float64], radius_m: float = 0.25
) -> NDArray[np.float64]:
    along = x_m * np.cos(angles) + y_m * np.sin(angles)
    across = x_m * np.sin(angles) - y_m * np.cos(angles)
    inside = radius_m**2 - across**2
    hit = (inside > 0.0) & (along > 0.0)
    return np.where(hit, along - np.sqrt(np.maximum(inside, 0.0)), math.inf)


def full_turn(walls: list[Line], pose: Pose, half_beams: int = 360) -> Scan:
    """Return a scan of a full turn without noise, from straight behind."""
    behind = scan_in(walls, Pose(pose.x_m, pose.y_m, pose.heading_rad - math.pi / 2), 0,
                     half_beams + 1)
    ahead = scan_in(walls, Pose(pose.x_m, pose.y_m, pose.heading_rad + math.pi / 2), 0,
                    half_beams + 1)
    ranges = np.concatenate((behind.ranges_m[:-1], ahead.ranges_m[:-1]))
    return Scan(0, -math.pi, math.pi / half_beams, ranges)


def mounted_scan(mount: Mount) -> Scan:
    """Return the scan that a laser with a mount takes of the room, with the robot at ``ROBOT``."""
    seen = full_turn(ROOM, composed(ROBOT, Pose(mount.x_m, mount.y_m, mount.yaw_rad)))
    ranges_m, first_rad = seen.ranges_m, seen.angle_min_rad
    if mount.is_upside_down:  # its beams run clockwise as seen from above
        ranges_m, first_rad = ranges_m[::-1], -(first_rad + seen.angle_increment_rad * 719)
    return checked_scan(0, first_rad, seen.angle_increment_rad, 0.0, 30.0, ranges_m, mount)
