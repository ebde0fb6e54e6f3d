# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Laser scans: validation, and conversion to points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.mount import CENTRED, Mount
from ratslam_ros.core.common.state import State
from ratslam_ros.errors import UnusableInput

MAX_BEAM_COUNT = 100_000
"""Scans with more beams are rejected."""

CONTACT_RANGE_M = 0.01
"""Range of a beam that is below the minimum range, if the laser gives a smaller ``range_min``."""

_MAX_RANGE_M = 1e6
"""Beams with at least this range count as free of obstacles."""


@dataclass(frozen=True, slots=True)
class Scan:
    """One laser scan.

    Beam i points ``angle_min_rad + i * angle_increment_rad`` counter-clockwise from straight
    ahead of the robot. ``ranges_m`` is (n,); beams whose range is not finite and positive hit no
    obstacle. ``x_m`` and ``y_m``: position of the laser, ahead and left of the robot's centre.
    ``laser``: number of the laser, from 0.
    """

    stamp_ns: int
    angle_min_rad: float
    angle_increment_rad: float
    ranges_m: NDArray[np.float64]
    x_m: float = 0.0
    y_m: float = 0.0
    laser: int = 0


def scan_stream(laser: int) -> str:
    """Return the name of the stream of a laser: each has stamps of its own."""
    return f'scan_{laser + 1}' if laser else 'scan'


def scan_state(scan: Scan) -> State:
    """Return a scan for a saved state."""
    return {
        'stamp_ns': scan.stamp_ns, 'angles': [scan.angle_min_rad, scan.angle_increment_rad],
        'ranges_m': scan.ranges_m.copy(), 'position_m': [scan.x_m, scan.y_m],
        **({'laser': scan.laser} if scan.laser else {}),
    }


def scan_from_state(state: State) -> Scan:
    """Return a scan from ``scan_state``."""
    first_rad, step_rad = state['angles']
    x_m, y_m = state.get('position_m', (0.0, 0.0))
    return Scan(
        int(state['stamp_ns']), float(first_rad), float(step_rad), state['ranges_m'], x_m, y_m,
        int(state.get('laser', 0)),
    )


class UnusableScan(UnusableInput):
    """A scan whose beam angles or ranges are invalid."""


def checked_scan(
    stamp_ns: int,
    angle_min_rad: float,
    angle_increment_rad: float,
    range_min_m: float,
    range_max_m: float,
    ranges_m: ArrayLike,
    mount: Mount = CENTRED,
) -> Scan:
    """Validate the fields of a sensor_msgs/LaserScan and return them as a Scan.

    Ranges outside ``range_min_m`` to ``range_max_m`` become infinite (no obstacle). A range of
    -inf is an object too close to be measured (REP 117): it becomes ``range_min_m``, but at
    least ``CONTACT_RANGE_M``.

    Args:
        stamp_ns: stamp of the scan.
        angle_min_rad: direction of the first beam, counter-clockwise in the frame of the laser.
        angle_increment_rad: angle between two beams.
        range_min_m: smallest valid range.
        range_max_m: largest valid range.
        ranges_m: (n,) ranges.
        mount: where the laser sits on the robot.

    Raises:
        UnusableScan: there are no beams or too many, or an angle or range limit is invalid.
    """
    measured_m = np.asarray(ranges_m, np.float64)
    beams = len(measured_m)
    if not 0 < beams <= MAX_BEAM_COUNT:
        raise UnusableScan(f'it has {beams} beams; expected 1 to {MAX_BEAM_COUNT}')
    step_rad = abs(angle_increment_rad)
    are_finite = all(map(math.isfinite, (angle_min_rad, angle_increment_rad)))
    has_angles = are_finite and (angle_increment_rad != 0.0 or beams == 1)
    if not has_angles or step_rad * (beams - 1) > math.tau + step_rad:
        raise UnusableScan(
            f'angle_min is {angle_min_rad} and angle_increment {angle_increment_rad} for {beams} '
            'beams; expected at most one turn'
        )
    if not 0.0 <= range_min_m < range_max_m:
        raise UnusableScan(
            f'range_min is {range_min_m} and range_max {range_max_m}; expected range_max above '
            'range_min, which is at least 0'
        )
    is_valid = (measured_m >= range_min_m) & (measured_m <= range_max_m)
    checked_m = np.where(is_valid, measured_m, math.inf)
    checked_m[measured_m == -math.inf] = max(range_min_m, CONTACT_RANGE_M)
    if mount.is_upside_down:
        angle_min_rad, angle_increment_rad = -angle_min_rad, -angle_increment_rad
    return Scan(
        stamp_ns, angle_min_rad + mount.yaw_rad, angle_increment_rad, checked_m, mount.x_m,
        mount.y_m,
    )


def points_of(scan: Scan) -> NDArray[np.float64]:
    """Return (n, 2) end points of the beams that hit something, in metres in the robot's frame."""
    points: NDArray[np.float64] = _points(
        scan.ranges_m, scan.angle_min_rad, scan.angle_increment_rad, scan.x_m, scan.y_m
    )
    return points


@compiled
def _points(
    ranges_m: NDArray[np.float64], angle_min_rad: float, angle_increment_rad: float, x_m: float,
    y_m: float,
) -> NDArray[np.float64]:
    points = np.empty((len(ranges_m), 2))
    count = 0
    for beam in range(len(ranges_m)):
        if 0.0 < ranges_m[beam] < _MAX_RANGE_M:
            angle = angle_min_rad + beam * angle_increment_rad
            points[count, 0] = x_m + ranges_m[beam] * math.cos(angle)
            points[count, 1] = y_m + ranges_m[beam] * math.sin(angle)
            count += 1
    return points[:count]
