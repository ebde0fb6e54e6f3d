# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scans of any laser, live or recorded -> what core takes of them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ratslam_ros.core.scan import Scan
from ratslam_ros.errors import UnusableInput

MOST_BEAMS = 100_000
TOUCHING_M = 0.01
"""Where something is too close to be measured, by a laser that does not say how close that is."""


class UnusableScan(UnusableInput):
    """No way on can be seen in a scan."""


def usable_scan(
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
    if not 0 < beams <= MOST_BEAMS:
        raise UnusableScan(f'it has {beams} beams; expected 1 to {MOST_BEAMS}')
    known = all(map(math.isfinite, (first_rad, step_rad))) and (step_rad != 0.0 or beams == 1)
    if not known or abs(step_rad) * (beams - 1) > math.tau + abs(step_rad):
        raise UnusableScan(
            f'angle_min is {first_rad} and angle_increment {step_rad} for {beams} beams; expected '
            'at most one turn'
        )
    if not 0.0 <= least_m < most_m:
        raise UnusableScan(f'range_min is {least_m} and range_max {most_m}; expected some range')
    seen_m = np.where((given_m >= least_m) & (given_m <= most_m), given_m, math.inf)
    seen_m[given_m == -math.inf] = max(least_m, TOUCHING_M)
    return Scan(stamp_ns, first_rad, step_rad, seen_m)
