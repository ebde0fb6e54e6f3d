# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sonars as a coarse scan, for controllers that take scans."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan

MEMORY_S = 2.0
"""Time for which an echo counts. A wall at an angle returns none: a turning robot would lose it at
once, and explore at half the speed."""

BEAMS = 360
"""Beams of a scan, one per degree."""


class SonarScans:
    """Collects echoes for MEMORY_S; each is taken for a point on the axis of its sonar."""

    def __init__(self, mounts: Sequence[Pose]) -> None:
        """``mounts``: poses of the sonars on the robot."""
        self._x_m, self._y_m, self._heading_rad = np.array(mounts, np.float64).T
        self._heard: list[tuple[int, NDArray[np.float64]]] = []

    def add(self, stamp_ns: int, ranges_m: ArrayLike, pose: Pose) -> Scan:
        """Add one range of each sonar and return the scan in the frame of the robot.

        Args:
            stamp_ns: stamp of the ranges.
            ranges_m: (sonars,) ranges, not finite without an echo.
            pose: dead reckoning; only its changes count.
        """
        ranges_m = np.asarray(ranges_m, np.float64)
        has_echo = np.isfinite(ranges_m)
        range_m, heading_rad = ranges_m[has_echo], self._heading_rad[has_echo]
        x_m = self._x_m[has_echo] + range_m * np.cos(heading_rad)
        y_m = self._y_m[has_echo] + range_m * np.sin(heading_rad)
        since_ns = stamp_ns - round(MEMORY_S * 1e9)
        turned = np.exp(1j * pose.heading_rad)
        robot = complex(pose.x_m, pose.y_m)
        self._heard = [heard for heard in self._heard if heard[0] >= since_ns]
        self._heard.append((stamp_ns, robot + turned * (x_m + 1j * y_m)))
        points = (np.concatenate([points for _, points in self._heard]) - robot) / turned
        scan_m = np.full(BEAMS, math.inf)
        beams = np.rint(np.degrees(np.angle(points))).astype(np.int64) % BEAMS
        np.minimum.at(scan_m, beams, np.abs(points))
        return Scan(stamp_ns, 0.0, math.tau / BEAMS, scan_m)
