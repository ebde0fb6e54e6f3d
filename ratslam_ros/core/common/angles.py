# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Angles in radians, counter-clockwise."""

from __future__ import annotations

import math

from ratslam_ros.core.common.compiled import compiled


@compiled
def wrap(angle_rad: float) -> float:
    """Wrap an angle in radians to (-pi, pi]."""
    if -math.pi < angle_rad <= math.pi:
        return angle_rad
    wrapped = angle_rad - math.tau * math.ceil((angle_rad - math.pi) / math.tau)
    # Rounding can return -pi exactly, which lies outside the half-open interval.
    if wrapped <= -math.pi:
        return wrapped + math.tau
    return min(wrapped, math.pi)
