# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rooms made of line segments, laser scans of them, and a robot that drives in them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.goal_follower import GoalFollower, in_robot_frame, remaining_route
from ratslam_ros.core.driving.steering import Command

Line = Sequence[tuple[float, float]]

HERE = Pose(0.0, 0.0, 0.0)
SCAN_S = 0.1
SCAN_NS = round(SCAN_S * 1e9)
FIRST_RAD, LAST_RAD = -math.pi / 2, math.pi / 2


def scan_of_ranges(ranges_m: Sequence[float] | NDArray[np.float64], stamp_ns: int = 0) -> Scan:
    """Return a scan over 180 degrees, from right to left."""
    ranges = np.array(ranges_m, np.float64)
    return Scan(stamp_ns, FIRST_RAD, (LAST_RAD - FIRST_RAD) / max(len(ranges) - 1, 1), ranges)


def scan_in(walls: Sequence[Line], pose: Pose = HERE, stamp_ns: int = 0, beams: int = 361) -> Scan:
    """Return the scan of walls, each a line through points in m, with a range of 8 m."""
    ends = np.array([pair for wall in walls for pair in itertools.pairwise(wall)])
    ends = ends.reshape(-1, 2, 2)
    a, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    angles = pose.heading_rad + np.linspace(FIRST_RAD, LAST_RAD, beams)
    d_x, d_y = np.cos(angles)[:, None], np.sin(angles)[:, None]
    o_x, o_y = a[:, 0] - pose.x_m, a[:, 1] - pose.y_m
    # pose + t * ray = a + u * along, by Cramer's rule
    with np.errstate(all='ignore'):
        cross = d_x * along[:, 1] - d_y * along[:, 0]
        t = (o_x * along[:, 1] - o_y * along[:, 0]) / cross
        u = (o_x * d_y - o_y * d_x) / cross
    ranges_m = np.where((t > 0.0) & (u >= 0.0) & (u <= 1.0), t, np.inf).min(axis=1, initial=np.inf)
    return scan_of_ranges(np.where(ranges_m <= 8.0, ranges_m, np.inf), stamp_ns)


def clearance_m(walls: Sequence[Line], x_m: float, y_m: float) -> float:
    """Return the distance to the nearest wall."""
    return min(
        way_to_point_m(from_m, to_m, (x_m, y_m))
        for wall in walls
        for from_m, to_m in itertools.pairwise(wall)
    )


def way_to_point_m(
    from_m: tuple[float, float], to_m: tuple[float, float], point_m: tuple[float, float]
) -> float:
    """Return the distance between a line segment and a point."""
    (a_x, a_y), (b_x, b_y), (x, y) = from_m, to_m, point_m
    d_x, d_y = b_x - a_x, b_y - a_y
    squared = d_x * d_x + d_y * d_y
    share = 0.0 if squared == 0.0 else ((x - a_x) * d_x + (y - a_y) * d_y) / squared
    share = min(max(share, 0.0), 1.0)
    return math.hypot(a_x + share * d_x - x, a_y + share * d_y - y)


# Walls for several tests; x is ahead of the robot, y to its left.


def corridor(half_width_m: float = 1.0) -> list[Line]:
    return [[(-20.0, side), (20.0, side)] for side in (half_width_m, -half_width_m)]


def dead_end(at_m: float, half_width_m: float = 0.7) -> list[Line]:
    y = half_width_m
    return [[(-20.0, y), (at_m, y), (at_m, -y), (-20.0, -y)]]


def t_junction(end_m: float, width_m: float = 2.0, length_m: float = 20.0) -> list[Line]:
    """Return a corridor that ends in a transverse one, whose far wall is at ``end_m``."""
    near = end_m - width_m
    sides: list[Line] = [
        [(-20.0, side), (near, side), (near, math.copysign(length_m, side))]
        for side in (width_m / 2, -width_m / 2)
    ]
    return [*sides, [(end_m, length_m), (end_m, -length_m)]]


class Drive:
    """A robot without noise that follows a route between walls, which may change.

    ``range_sd_m``: standard deviation of the noise of the laser.
    """

    def __init__(
        self, walls: list[Line], route_m: list[tuple[float, float]], range_sd_m: float = 0.0
    ) -> None:
        self.walls, self.range_sd_m = walls, range_sd_m
        self._rng = np.random.default_rng(1)
        self.follower = GoalFollower(GoalFollowerParameters())
        self.behaviour = ''
        self.pose = Pose(0.0, 0.0, 0.0)
        self.left_m = np.array(route_m)
        self.stamp_ns = 0
        self.nearest_m = math.inf

    def step(self) -> Command:
        scan = scan_in(self.walls, self.pose, self.stamp_ns, beams=181)
        noise_m = self._rng.normal(0.0, self.range_sd_m, len(scan.ranges_m))
        scan = replace(scan, ranges_m=scan.ranges_m + noise_m)
        self.left_m = remaining_route(self.left_m, self.pose.x_m, self.pose.y_m)
        route_m = in_robot_frame(self.pose, self.left_m)
        command = self.follower.command(scan, route_m, self.behaviour)
        self.pose = moved(
            self.pose,
            Motion(SCAN_S, command.speed_mps * SCAN_S, command.turn_rate_radps * SCAN_S),
        )
        self.stamp_ns += SCAN_NS
        clear_m = clearance_m(self.walls, self.pose.x_m, self.pose.y_m)
        self.nearest_m = min(self.nearest_m, clear_m)
        return command

    def steps(self, seconds: float) -> list[Command]:
        return [self.step() for _ in range(round(seconds / SCAN_S))]

    def away_m(self, x_m: float, y_m: float) -> float:
        return math.hypot(self.pose.x_m - x_m, self.pose.y_m - y_m)
