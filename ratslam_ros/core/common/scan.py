# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Laser scans, and where their beams ended."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.errors import UnusableInput

MAX_BEAM_COUNT = 100_000
CONTACT_RANGE_M = 0.01
"""Where something is too close to be measured, by a laser that does not say how close that is."""


@dataclass(frozen=True, slots=True)
class Scan:
    """One laser scan, beams counter-clockwise from ``angle_min_rad``; 0 is straight ahead.

    ``ranges_m``: (n,); what is not a finite positive number is no obstacle.
    """

    stamp_ns: int
    angle_min_rad: float
    angle_increment_rad: float
    ranges_m: NDArray[np.float64]


class UnusableScan(UnusableInput):
    """No way on can be seen in a scan."""


def checked_scan(
    stamp_ns: int,
    first_rad: float,
    step_rad: float,
    least_m: float,
    most_m: float,
    ranges_m: ArrayLike,
) -> Scan:
    """Return what core takes of a scan.

    What is not within ``least_m`` to ``most_m`` is nothing there, but for -inf: that is too
    close to be measured (REP 117), so as close as can be.

    Args:
        stamp_ns: of the scan.
        first_rad, step_rad: ``angle_min`` and ``angle_increment`` of a sensor_msgs/LaserScan.
        least_m, most_m: its ``range_min`` and ``range_max``.
        ranges_m: (n,), its ``ranges``.

    Raises:
        UnusableScan: the directions of its beams are not known, or there are none.
    """
    given_m = np.asarray(ranges_m, np.float64)
    beams = len(given_m)
    if not 0 < beams <= MAX_BEAM_COUNT:
        raise UnusableScan(f'it has {beams} beams; expected 1 to {MAX_BEAM_COUNT}')
    known = all(map(math.isfinite, (first_rad, step_rad))) and (step_rad != 0.0 or beams == 1)
    if not known or abs(step_rad) * (beams - 1) > math.tau + abs(step_rad):
        raise UnusableScan(
            f'angle_min is {first_rad} and angle_increment {step_rad} for {beams} beams; expected '
            'at most one turn'
        )
    if not 0.0 <= least_m < most_m:
        raise UnusableScan(f'range_min is {least_m} and range_max {most_m}; expected some range')
    seen_m = np.where((given_m >= least_m) & (given_m <= most_m), given_m, math.inf)
    seen_m[given_m == -math.inf] = max(least_m, CONTACT_RANGE_M)
    return Scan(stamp_ns, first_rad, step_rad, seen_m)


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
