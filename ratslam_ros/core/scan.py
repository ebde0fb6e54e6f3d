# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Laser scans, and where their beams ended."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.compiled import compiled


@dataclass(frozen=True, slots=True)
class Scan:
    """One laser scan, beams counter-clockwise from ``angle_min_rad``; 0 is straight ahead.

    ``ranges_m``: (n,); what is not a finite positive number is no obstacle.
    """

    stamp_ns: int
    angle_min_rad: float
    angle_increment_rad: float
    ranges_m: NDArray[np.float64]


def points_of(scan: Scan) -> NDArray[np.float64]:
    """Return (n, 2) m, where beams ended, in the robot's frame and the order of the beams."""
    points: NDArray[np.float64] = _points(
        scan.ranges_m, scan.angle_min_rad, scan.angle_increment_rad
    )
    return points


@compiled
def _points(
    ranges_m: NDArray[np.float64], angle_min_rad: float, angle_increment_rad: float
) -> NDArray[np.float64]:
    points = np.empty((len(ranges_m), 2))
    count = 0
    for beam in range(len(ranges_m)):
        if 0.0 < ranges_m[beam] < 1e6:
            angle = angle_min_rad + beam * angle_increment_rad
            points[count, 0] = ranges_m[beam] * math.cos(angle)
            points[count, 1] = ranges_m[beam] * math.sin(angle)
            count += 1
    return points[:count]
