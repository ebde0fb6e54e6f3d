# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Laser scans of small rooms for the tests of scan matching."""

from __future__ import annotations

import math

import numpy as np
from rooms import Line, scan_in

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.common.scan import points_of
from ratslam_ros.core.mapping.scan_matching import ScanMatcher
from ratslam_ros.core.pose_cells.map_action import Action, MapAction
from ratslam_ros.core.pose_cells.torus import Place

ROOM: list[Line] = [
    [(-2.0, -1.5), (4.0, -1.5), (4.0, 2.0), (1.0, 2.0), (1.0, 3.5), (-2.0, 3.5), (-2.0, -1.5)],
    [(2.0, -0.5), (2.6, -0.5), (2.6, 0.3), (2.0, 0.3), (2.0, -0.5)],
]
"""Room with an alcove and a table."""

HALL: list[Line] = [[(-1.0, -7.0), (5.0, -4.0), (6.0, 7.0), (-3.0, 5.0), (-1.0, -7.0)]]
TICK_NS = 100_000_000
"""Interval between two odometry messages."""

ORIGIN = Pose(0.0, 0.0, 0.0)


def scan_points(walls: list[Line], pose: Pose) -> np.ndarray:
    """Return the (n, 2) points in m, in the robot's frame, of a scan taken at a pose."""
    return points_of(scan_in(walls, pose, beams=181))


def pose_error(found: Pose | None, true: Pose) -> tuple[float, float]:
    """Return the distance in m and the rotation in rad between a pose and the true one."""
    assert found is not None
    turned = math.remainder(found.heading_rad - true.heading_rad, math.tau)
    return math.dist(found[:2], true[:2]), abs(turned)


def map_action(kind: Action, target: int, relative_rad: float = 0.0) -> MapAction:
    return MapAction(kind, 0, target, target, relative_rad, Place(0.0, 0.0, 0.0))


def drive(
    matcher: ScanMatcher, walls: list[Line], start: Pose, tick: int, ticks: int,
    still: bool = False,
) -> tuple[Pose, int]:
    """Drive along a curve, with odometry at each tick and a scan halfway between two ticks.

    Args:
        matcher: receives odometry and scans.
        walls: walls that the scans are taken of.
        start: pose of the robot among the walls.
        tick: present time in ticks.
        ticks: duration in ticks.
        still: whether the robot stands still instead.

    Returns:
        Pose of the robot and time in ticks at the end.
    """
    motion = Motion(0.1, 0.0, 0.0) if still else Motion(0.1, 0.05, 0.06)
    pose = start
    for _ in range(ticks):
        halfway = composed(pose, Pose(motion.distance_m / 2, 0.0, motion.turn_rad / 2))
        matcher.scan(scan_in(walls, halfway, tick * TICK_NS + TICK_NS // 2, beams=181))
        tick += 1
        pose = composed(pose, Pose(motion.distance_m, 0.0, motion.turn_rad))
        matcher.integrate(tick * TICK_NS, motion)
    return pose, tick
