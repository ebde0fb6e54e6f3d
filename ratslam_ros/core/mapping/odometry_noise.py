# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of the odometry, from stretches that were driven before.

Between two recognitions the odometry gives a displacement, and the recognised experiences have
another one on the map. They differ by the errors of two drives, and of the recognitions. The
median of many such differences does not depend on false recognitions.
"""

from __future__ import annotations

import math

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.mapping.icp import PRIOR_SD_RAD
from ratslam_ros.core.mapping.link_weights import VIEW_STD_RAD
from ratslam_ros.core.mapping.pose_covariance import Matrix, OdometryVariance, isotropic
from ratslam_ros.core.mapping.scan_match import TURN_M_PER_RAD, VIEW_SD_M

PRIOR_STD, PRIOR_COUNT = 0.2, 8
"""Standard deviation after one view spacing, in view spacings, before anything was measured, and
the number of measurements that it counts as."""

LEAST_STD = 1e-3
"""Smallest estimate. Simulated odometry may be exact, but covariances have to be definite."""

MAX_COUNT = 128
"""Number of latest measurements that are used."""

LEAST_SPACINGS, MOST_SPACINGS = 2.0, 8.0
"""Distance between two compared recognitions, in view spacings. On shorter ones the errors of the
recognitions dominate."""

MEAN_SPACINGS = 4.0
"""Length of a typical stretch: the geometric mean of the two."""

UNMEASURED = OdometryVariance(m2_per_m=0.003, rad2_per_m=9e-5)
"""Variances before the view spacing is known. With scans the errors are smaller."""

UNMEASURED_VIEW = isotropic(VIEW_SD_M, PRIOR_SD_RAD)
"""Covariance of a recognition then: a view is recognised up to a metre from its place."""

MEDIAN_CHI_SQUARE_1 = 0.4549
"""Median of the chi-square distribution with 1 degree of freedom."""

MEDIAN_PER_VARIANCE = 4.0 * math.log(2.0)
"""Median of the squared length of a difference in the plane, relative to the variance of one of
the two displacements along one axis."""


class OdometryNoise(Saved):
    """Estimate of the variance of the odometry, which is proportional to the distance driven.

    On so short stretches, the errors of odometry and recognitions cannot be separated.
    """

    SAVED = (
        Field('measured', '_measured', float, ('',), 0.0),
        Field('place', '_place', float, (3,), make=Pose, nullable=True),
        Field('motion', '_motion', float, (3,), make=Pose),
        Field('driven_m', '_driven_m', low=0.0),
        Field('scanned', '_scanned', float, ('', 2), 0.0, make=lambda m2, rad2: (m2, rad2),
              when=lambda own: own._scanned),
        Field('present/since_scan_m', '_since_scan_m', low=0.0,
              when=lambda own: own._since_scan_m is not None),
    )

    def __init__(self) -> None:
        self._measured: list[float] = [PRIOR_STD * PRIOR_STD * MEDIAN_PER_VARIANCE] * PRIOR_COUNT
        """Latest squared differences, relative to the distance driven, all in view spacings."""
        self.std = PRIOR_STD
        """Standard deviation of the position after one view spacing, in view spacings."""
        self._scanned: list[tuple[float, float]] = []
        """Latest squared differences of position and heading by scans, in m^2/m and rad^2/m."""
        self._since_scan_m: float | None = None
        self.by_scans: OdometryVariance | None = None
        """Variances that driving adds, as scans measure them; None before enough are aligned."""
        self.restart()

    def _estimate(self) -> None:
        median = sorted(self._measured)[len(self._measured) // 2]
        self.std = max(math.sqrt(median / MEDIAN_PER_VARIANCE), LEAST_STD)
        self.by_scans = None
        if len(self._scanned) >= PRIOR_COUNT:
            m2, rad2 = (sorted(one)[len(one) // 2] for one in zip(*self._scanned, strict=True))
            per_m = rad2 / MEDIAN_CHI_SQUARE_1
            self.by_scans = OdometryVariance(
                2.0 * m2 / MEDIAN_PER_VARIANCE, per_m, TURN_M_PER_RAD * per_m
            )

    def _restored(self, state: State) -> None:
        self._estimate()

    @property
    def has_scans(self) -> bool:
        """Whether scans were aligned."""
        return self._since_scan_m is not None or bool(self._scanned)

    def compare(self, by_odometry: Pose, by_scan: Pose, learns: bool = True) -> None:
        """Compare the motion since the last aligned scan with that by scans.

        Args:
            by_odometry, by_scan: poses of the robot, in one frame.
            learns: whether the estimate changes.
        """
        driven_m = self._since_scan_m
        self._since_scan_m = 0.0
        if not driven_m or not learns:
            return
        x_m, y_m, turn_rad = composed(inverse(by_odometry), by_scan)
        turn_rad = wrap(turn_rad)
        self._scanned.append((
            (x_m * x_m + y_m * y_m) / driven_m, turn_rad * turn_rad / driven_m
        ))
        del self._scanned[:-MAX_COUNT]
        self._estimate()

    def variance(self, view_spacing_m: float) -> OdometryVariance:
        """Return the variances that driving adds; the view spacing is 0 if it is unknown.

        Recognitions, position and heading are each given a third of the differences. A heading
        that drifts by q rad^2/m displaces the end of a path sideways by q L^3 / 3 m^2.
        """
        if view_spacing_m == 0.0:
            return UNMEASURED
        variance = self.std * self.std
        per_m = 2.0 * variance / (MEAN_SPACINGS * MEAN_SPACINGS * view_spacing_m)
        return OdometryVariance(variance * view_spacing_m / 3.0, per_m)

    def recognition(self, view_spacing_m: float) -> Matrix:
        """Return the covariance of a recognition; the view spacing is 0 if it is unknown.

        It explains all of the difference on a typical stretch, because some recognitions are
        false. Those along the stretch deviate in the same way, so together they count as one.
        """
        if view_spacing_m == 0.0:
            return UNMEASURED_VIEW
        return isotropic(MEAN_SPACINGS * self.std * view_spacing_m, VIEW_STD_RAD)

    def restart(self) -> None:
        """Continue after a motion that is unknown."""
        self._place: Pose | None = None
        self._since_scan_m = None
        self._motion, self._driven_m = Pose(0.0, 0.0, 0.0), 0.0

    def integrate(self, motion: Motion) -> None:
        """Follow the robot."""
        if self._since_scan_m is not None:
            self._since_scan_m += abs(motion.distance_m) + TURN_M_PER_RAD * abs(motion.turn_rad)
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
                self._estimate()
        self._place, self._motion, self._driven_m = place, Pose(0.0, 0.0, relative_rad), 0.0
