# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Angles in radians, counter-clockwise."""

from __future__ import annotations

import math

from ratslam_ros.core.common.compiled import compiled

TWO_PI = 2.0 * math.pi
"""One turn, in rad."""


@compiled
def wrap(angle_rad: float) -> float:
    """Wrap an angle in radians to (-pi, pi]."""
    if -math.pi < angle_rad <= math.pi:
        return angle_rad
    wrapped = angle_rad - TWO_PI * math.ceil((angle_rad - math.pi) / TWO_PI)
    # Rounding can return -pi exactly, which lies outside the half-open interval.
    if wrapped <= -math.pi:
        return wrapped + TWO_PI
    return min(wrapped, math.pi)
