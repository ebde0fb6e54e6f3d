# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scans of any laser -> what core takes of them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from sensor_msgs.msg import LaserScan

from ratslam_ros.core.scan import Scan
from ratslam_ros.errors import UnusableInput
from ratslam_ros.nodes.convert import stamp_ns

MOST_BEAMS = 100_000
TOUCHING_M = 0.01
"""Where something is too close to be measured, by a laser that does not say how close that is."""


class UnusableScan(UnusableInput):
    """No way on can be seen in a scan."""


def usable_scan(message: LaserScan, refuse: Callable[[str, str], None]) -> Scan | None:
    """Return what core takes of a scan; None where nothing can be, which ``refuse`` is told."""
    try:
        return scan_of(message)
    except UnusableScan as error:
        refuse('scan', str(error))
        return None


def scan_of(message: LaserScan) -> Scan:
    """Return what core takes of a scan.

    What is not within ``range_min`` to ``range_max`` is nothing there, but for -inf: that is too
    close to be measured (REP 117), so as close as can be.

    Raises:
        UnusableScan: the directions of its beams are not known, or there are none.
    """
    first_rad, step_rad = float(message.angle_min), float(message.angle_increment)
    beams = len(message.ranges)
    if not 0 < beams <= MOST_BEAMS:
        raise UnusableScan(f'it has {beams} beams; expected 1 to {MOST_BEAMS}')
    known = all(map(math.isfinite, (first_rad, step_rad))) and (step_rad != 0.0 or beams == 1)
    if not known or abs(step_rad) * (beams - 1) > math.tau + abs(step_rad):
        raise UnusableScan(
            f'angle_min is {first_rad} and angle_increment {step_rad} for {beams} beams; expected '
            'at most one turn'
        )
    least_m, most_m = float(message.range_min), float(message.range_max)
    if not 0.0 <= least_m < most_m:
        raise UnusableScan(f'range_min is {least_m} and range_max {most_m}; expected some range')
    given_m = np.asarray(message.ranges, np.float64)
    ranges_m = np.where((given_m >= least_m) & (given_m <= most_m), given_m, math.inf)
    ranges_m[given_m == -math.inf] = max(least_m, TOUCHING_M)
    return Scan(stamp_ns(message.header), first_rad, step_rad, ranges_m)
