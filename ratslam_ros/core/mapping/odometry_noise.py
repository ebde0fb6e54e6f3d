# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of the odometry, from stretches that were driven before.

Between two recognitions the odometry gives a displacement, and the recognised experiences have
another one on the map. They differ by the errors of two drives. The median of many such
differences does not depend on false recognitions.
"""

from __future__ import annotations

import math

from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.saved import Field, Saved

PRIOR_STD, PRIOR_COUNT = 0.2, 8
"""Standard deviation after one view spacing, in view spacings, before anything was measured, and
the number of measurements that it counts as."""

MAX_COUNT = 128
"""Number of latest measurements that are used."""

LEAST_SPACINGS, MOST_SPACINGS = 2.0, 8.0
"""Distance between two compared recognitions, in view spacings. On shorter ones the errors of the
recognitions dominate."""

MEDIAN_PER_VARIANCE = 4.0 * math.log(2.0)
"""Median of the squared length of a difference in the plane, relative to the variance of one of
the two displacements along one axis."""


class OdometryNoise(Saved):
    """Estimate of the variance of the odometry, which is proportional to the distance driven."""

    SAVED = (
        Field('measured', '_measured', float, ('',), 0.0),
        Field('place', '_place', float, (3,), make=Pose, nullable=True),
        Field('motion', '_motion', float, (3,), make=Pose),
        Field('driven_m', '_driven_m', low=0.0),
    )

    def __init__(self) -> None:
        self._measured: list[float] = [PRIOR_STD * PRIOR_STD * MEDIAN_PER_VARIANCE] * PRIOR_COUNT
        """Latest squared differences, relative to the distance driven, all in view spacings."""
        self._place: Pose | None = None
        self._motion = Pose(0.0, 0.0, 0.0)
        self._driven_m = 0.0

    @property
    def std(self) -> float:
        """Standard deviation of the position after one view spacing, in view spacings."""
        return math.sqrt(sorted(self._measured)[len(self._measured) // 2] / MEDIAN_PER_VARIANCE)

    def restart(self) -> None:
        """Continue after a motion that is unknown."""
        self._place, self._motion, self._driven_m = None, Pose(0.0, 0.0, 0.0), 0.0

    def integrate(self, motion: Motion) -> None:
        """Follow the robot."""
        if self._place is not None:
            self._motion = moved(self._motion, motion)
            self._driven_m += abs(motion.distance_m)

    def recognise(self, place: Pose, relative_rad: float, view_spacing_m: float) -> None:
        """Compare the displacement since an earlier recognition with that on the map.

        Args:
            place: pose of the recognised experience on the map.
            relative_rad: heading of the robot relative to it.
            view_spacing_m: view spacing.
        """
        if self._place is not None:
            if self._driven_m < LEAST_SPACINGS * view_spacing_m:
                return
            if self._driven_m < MOST_SPACINGS * view_spacing_m:
                x_m, y_m, _ = composed(inverse(self._place), place)
                apart_m = math.hypot(x_m - self._motion.x_m, y_m - self._motion.y_m)
                self._measured.append(apart_m * apart_m / (self._driven_m * view_spacing_m))
                del self._measured[:-MAX_COUNT]
        self._place, self._motion, self._driven_m = place, Pose(0.0, 0.0, relative_rad), 0.0
