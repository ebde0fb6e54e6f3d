# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of the robot's pose relative to the places that are mapped around it.

The map itself may be displaced and bent, which later loop closures correct. That error is not
known, and is not part of this uncertainty: it is the one that matters for driving along the map.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.mapping.experience_map import MapUpdate
from ratslam_ros.core.mapping.icp import PRIOR_SD_RAD
from ratslam_ros.core.mapping.scan_matching import DRIFT_M2_PER_M, VIEW_SD_M
from ratslam_ros.core.pose_cells.map_action import MapAction

STRAIGHT_M = 10.0
"""Length of a path on which drift of the heading explains the drift of the position."""

DRIFT_RAD2_PER_M = 3.0 * DRIFT_M2_PER_M / STRAIGHT_M**2
"""Variance of the heading that each metre adds. A random walk of the heading with q rad^2/m
displaces the end of a path of L m sideways with a variance of q L^3 / 3, here DRIFT_M2_PER_M L."""

UNKNOWN_M2, UNKNOWN_RAD2 = 1e6, math.pi**2 / 3.0
"""Variances of a robot that may be anywhere: of a position, and of a uniform heading."""


class PoseVariances(NamedTuple):
    """Variances of x and of y, each, and of the heading."""

    position_m2: float
    heading_rad2: float


class PoseUncertainty:
    """Grows with the distance driven, and shrinks when a place is recognised."""

    def __init__(self, is_known: bool = True) -> None:
        """Begin a map, or continue one at an unknown place.

        Args:
            is_known: whether the robot is at the start of its map.
        """
        self._position_m2 = 0.0 if is_known else UNKNOWN_M2
        self._heading_rad2 = 0.0 if is_known else UNKNOWN_RAD2

    @property
    def variances(self) -> PoseVariances:
        """Variances of the pose, at most those of an unknown pose."""
        return PoseVariances(
            min(self._position_m2, UNKNOWN_M2), min(self._heading_rad2, UNKNOWN_RAD2)
        )

    def integrate(self, motion: Motion) -> None:
        """Add one motion; after an unknown one, the pose is unknown."""
        if not motion.is_known:
            self._position_m2, self._heading_rad2 = UNKNOWN_M2, UNKNOWN_RAD2
            return
        self._position_m2 += DRIFT_M2_PER_M * abs(motion.distance_m)
        self._heading_rad2 += DRIFT_RAD2_PER_M * abs(motion.distance_m)

    def apply(self, action: MapAction, update: MapUpdate, by_scan_m2: float = math.inf) -> None:
        """Take the result of one map action into account.

        Args:
            action: the action.
            update: what it changed. A rejected closure says nothing about the pose.
            by_scan_m2: variance of the position by scan matching; inf without a laser.
        """
        if update.relocation is not None or (
            action.action in ('link', 'set') and not update.rejected
        ):
            # Views of one place deviate in the same way, so that several are no better than one.
            self._position_m2 = min(self._position_m2, VIEW_SD_M**2)
            self._heading_rad2 = min(self._heading_rad2, PRIOR_SD_RAD**2)
        self._position_m2 = min(self._position_m2, by_scan_m2)
