# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Planar poses (SE(2)), their composition and inverse, and conversion to quaternions."""

from __future__ import annotations

import math
from typing import NamedTuple

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.turn_correction import TurnCorrection


class Pose(NamedTuple):
    """A planar pose in metres and radians; the heading is counter-clockwise from the x axis."""

    x_m: float
    y_m: float
    heading_rad: float


def heading_of(x: float, y: float, z: float, w: float) -> float:
    """Return the heading (yaw) of a quaternion, in radians."""
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def quaternion_of(heading_rad: float) -> tuple[float, float]:
    """Return the z and w components of the quaternion of a heading."""
    return math.sin(0.5 * heading_rad), math.cos(0.5 * heading_rad)


def composed(base: Pose, offset: Pose) -> Pose:
    """Return the composition ``base * offset``: ``offset`` is given in the frame of ``base``."""
    c, s = math.cos(base.heading_rad), math.sin(base.heading_rad)
    return Pose(
        base.x_m + c * offset.x_m - s * offset.y_m,
        base.y_m + s * offset.x_m + c * offset.y_m,
        wrap(base.heading_rad + offset.heading_rad),
    )


def inverse(pose: Pose) -> Pose:
    """Return the inverse transform: the pose of the origin in the frame of ``pose``."""
    c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    return Pose(
        -c * pose.x_m - s * pose.y_m, s * pose.x_m - c * pose.y_m, -pose.heading_rad
    )


def corrected_arc(motion: Pose, turns: TurnCorrection) -> Pose:
    """Return a measured motion along an arc, whose direction is half of its turn, corrected."""
    x_m, y_m, turn_rad = motion
    half_rad = 0.5 * (turns.corrected(turn_rad, math.hypot(x_m, y_m)) - turn_rad)
    return composed(Pose(0.0, 0.0, half_rad), Pose(x_m, y_m, turn_rad + half_rad))
