# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of the odometry, from stretches that were driven before.

Between two recognitions the odometry gives a motion, and the recognised experiences have another
one on the map. They differ by the errors of two drives, and of the recognitions. The median of
many such differences hardly depends on false recognitions.

Errors of recognitions do not grow with the distance driven, so that positions after two lengths
tell them from those of the odometry. Headings are compared after long stretches, where errors of
recognitions are small. Errors of odometry are not independent: biases let them grow faster than
the root of the distance. The variance of the heading is therefore the largest one at any length.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.mapping.icp import PRIOR_SD_RAD
from ratslam_ros.core.mapping.link_weights import VIEW_STD_RAD
from ratslam_ros.core.mapping.pose_covariance import Matrix, OdometryVariance, isotropic
from ratslam_ros.core.mapping.scan_match import TURN_M_PER_RAD, VIEW_SD_M

PRIOR_STD, PRIOR_STD_RAD, PRIOR_COUNT = 0.2, 0.1, 8
"""Standard deviations of position, in view spacings, and heading after one view spacing, before
anything was measured, and the number of differences that they count as, for each length."""

LEAST_STD = 1e-3
"""Smallest estimate. Simulated odometry may be exact, but covariances have to be definite."""

MAX_COUNT = 128
"""Number of latest differences that are used, for each length."""

LENGTHS = (2.0, 8.0, 16.0, 32.0, 64.0)
"""Lengths of compared stretches, in view spacings; each may be up to twice as long. The first one
is the short one."""

MEAN_SPACINGS = 4.0
"""Length of a stretch on which errors of odometry and recognitions are alike, in view spacings."""

LEAST_SHARE = 0.25
"""Smallest share of odometry in the differences of position after the second length."""

UNMEASURED = OdometryVariance(m2_per_m=0.003, rad2_per_m=9e-5)
"""Variances before the view spacing is known. With scans the errors are smaller."""

UNMEASURED_VIEW = isotropic(VIEW_SD_M, PRIOR_SD_RAD)
"""Covariance of a recognition then: a view is recognised up to a metre from its place."""

MEDIAN_CHI_SQUARE_1 = 0.4549
"""Median of the chi-square distribution with 1 degree of freedom."""

MEDIAN_PER_VARIANCE, MEDIAN_RAD2_PER_VARIANCE = 4.0 * math.log(2.0), 2.0 * MEDIAN_CHI_SQUARE_1
"""Medians of the squared difference of two displacements in the plane, and of two headings,
relative to the variance of one of them, along one axis."""


class Difference(NamedTuple):
    """Squared difference of a motion by odometry and on the map, for each view spacing driven.

    Attributes:
        position: in view spacings.
        rad2: of the heading.
    """

    position: float
    rad2: float


def _by_length(rows: list[list[float]]) -> dict[float, list[Difference]]:
    return {
        length: [Difference(*one) for of, *one in rows if of == length] for length in LENGTHS
    }


class Recognised(NamedTuple):
    """Pose of the robot where it was recognised, by odometry and on the map."""

    driven_m: float
    by_odometry: Pose
    on_map: Pose


class OdometryNoise(Saved):
    """Estimate of the variance of the odometry, which is proportional to the distance driven."""

    SAVED = (
        Field('differences', '_differences', float, ('', 3), 0.0, optional=True,
              save=lambda found: [(length, *one) for length, all in found.items() for one in all],
              load=_by_length, fits=(
                  'rows of each length', lambda rows, _: {row[0] for row in rows} == {*LENGTHS}
              )),
        Field('trail', '_trail', float, ('', 7), optional=True,
              save=lambda trail: [(one.driven_m, *one.by_odometry, *one.on_map) for one in trail],
              make=lambda driven_m, *poses: Recognised(
                  driven_m, Pose(*poses[:3]), Pose(*poses[3:])
              )),
        Field('motion', '_motion', float, (3,), make=Pose),
        Field('driven_m', '_driven_m', low=0.0),
        Field('scanned', '_scanned', float, ('', 2), 0.0, make=lambda m2, rad2: (m2, rad2),
              when=lambda own: own._scanned),
        Field('present/since_scan_m', '_since_scan_m', low=0.0,
              when=lambda own: own._since_scan_m is not None),
    )

    def __init__(self) -> None:
        prior = Difference(
            PRIOR_STD * PRIOR_STD * MEDIAN_PER_VARIANCE,
            PRIOR_STD_RAD * PRIOR_STD_RAD * MEDIAN_RAD2_PER_VARIANCE,
        )
        self._differences = {length: [prior] * PRIOR_COUNT for length in LENGTHS}
        """Latest differences, by the length of their stretches."""
        self._scanned: list[tuple[float, float]] = []
        """Latest squared differences of position and heading by scans, in m^2/m and rad^2/m."""
        self._since_scan_m: float | None = None
        self.by_scans: OdometryVariance | None = None
        """Variances that driving adds, as scans measure them; None before enough are aligned."""
        self.restart()
        self._estimate()

    def _estimate(self) -> None:
        short, *long = self._differences.values()
        near = _median(one.position for one in short) / MEDIAN_PER_VARIANCE
        far = _median(one.position for one in long[0]) / MEDIAN_PER_VARIANCE
        # The part of both that does not fall with the length.
        own = (LENGTHS[1] * far - LENGTHS[0] * near) / (LENGTHS[1] - LENGTHS[0])
        rad2 = max(_median(one.rad2 for one in found) for found in long)
        self.std = max(math.sqrt(max(own, LEAST_SHARE * far)), LEAST_STD)
        """Standard deviation of the position after one view spacing, in view spacings."""
        self.std_rad = max(math.sqrt(rad2 / MEDIAN_RAD2_PER_VARIANCE), LEAST_STD)
        """Standard deviation of the heading after one view spacing."""
        self._short_std = max(math.sqrt(near), LEAST_STD)
        """That of the position on short stretches, with the errors of recognitions."""

    def _estimate_by_scans(self) -> None:
        if len(self._scanned) >= PRIOR_COUNT:
            m2, rad2 = (_median(one) for one in zip(*self._scanned, strict=True))
            per_m = rad2 / MEDIAN_CHI_SQUARE_1
            self.by_scans = OdometryVariance(
                2.0 * m2 / MEDIAN_PER_VARIANCE, per_m, TURN_M_PER_RAD * per_m
            )

    def _restored(self, state: State) -> None:
        self._estimate()
        self._estimate_by_scans()

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
        self._estimate_by_scans()

    def variance(self, view_spacing_m: float) -> OdometryVariance:
        """Return the variances that driving adds; the view spacing is 0 if it is unknown.

        The pose is relative to a place on the map nearby. Recognitions, position and heading are
        each given a third of the differences on short stretches. A heading that drifts by
        q rad^2/m displaces the end of a path sideways by q L^3 / 3 m^2.
        """
        if view_spacing_m == 0.0:
            return UNMEASURED
        variance = self._short_std * self._short_std
        per_m = 2.0 * variance / (MEAN_SPACINGS * MEAN_SPACINGS * view_spacing_m)
        return OdometryVariance(variance * view_spacing_m / 3.0, per_m)

    def recognition(self, view_spacing_m: float) -> Matrix:
        """Return the covariance of a recognition; the view spacing is 0 if it is unknown.

        It explains all of the difference on a typical stretch, because some recognitions are
        false. Those along the stretch deviate in the same way, so together they count as one.
        """
        if view_spacing_m == 0.0:
            return UNMEASURED_VIEW
        return isotropic(MEAN_SPACINGS * self._short_std * view_spacing_m, VIEW_STD_RAD)

    def restart(self) -> None:
        """Continue after a motion that is unknown."""
        self._trail: list[Recognised] = []
        self._since_scan_m = None
        self._motion, self._driven_m = Pose(0.0, 0.0, 0.0), 0.0

    def integrate(self, motion: Motion) -> None:
        """Follow the robot."""
        if self._since_scan_m is not None:
            self._since_scan_m += abs(motion.distance_m) + TURN_M_PER_RAD * abs(motion.turn_rad)
        if self._trail:
            self._motion = moved(self._motion, motion)
            self._driven_m += abs(motion.distance_m)

    def recognise(self, place: Pose, relative_rad: float, view_spacing_m: float) -> None:
        """Compare the motion since earlier recognitions with that on the map.

        Args:
            place: pose of the recognised experience on the map.
            relative_rad: heading of the robot relative to it.
            view_spacing_m: view spacing.
        """
        if self._trail and (
            self._driven_m - self._trail[-1].driven_m < LENGTHS[0] * view_spacing_m
        ):
            return
        now = Recognised(
            self._driven_m, self._motion, composed(place, Pose(0.0, 0.0, relative_rad))
        )
        for length, differences in self._differences.items():
            since = [one for one in self._trail
                     if length <= (now.driven_m - one.driven_m) / view_spacing_m < 2.0 * length]
            if since:
                differences.append(_difference(since[-1], now, view_spacing_m))
            del differences[:-MAX_COUNT]
        farthest_m = 2.0 * LENGTHS[-1] * view_spacing_m
        self._trail = [one for one in self._trail if now.driven_m - one.driven_m < farthest_m]
        self._trail.append(now)
        self._estimate()


def _difference(start: Recognised, end: Recognised, view_spacing_m: float) -> Difference:
    """Return how the motions by odometry and on the map differ between two recognitions."""
    x_m, y_m, turn_rad = composed(inverse(start.by_odometry), end.by_odometry)
    place_x_m, place_y_m, place_rad = composed(inverse(start.on_map), end.on_map)
    apart_rad = wrap(place_rad - turn_rad)
    # An error of the heading that grows evenly turns the displacement by half of the error.
    c, s = math.cos(0.5 * apart_rad), math.sin(0.5 * apart_rad)
    apart_m = math.hypot(place_x_m - c * x_m + s * y_m, place_y_m - s * x_m - c * y_m)
    apart = apart_m / view_spacing_m
    spacings = (end.driven_m - start.driven_m) / view_spacing_m
    return Difference(apart * apart / spacings, apart_rad * apart_rad / spacings)


def _median(values: Iterable[float]) -> float:
    ordered = sorted(values)
    return ordered[len(ordered) // 2]
