# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of the robot's pose relative to the places that are mapped around it.

The map itself may be displaced and bent, which later loop closures correct. That error is not
known, and is not part of this uncertainty: it is the one that matters for driving along the map.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.mapping.icp import PRIOR_SD_RAD
from ratslam_ros.core.mapping.scan_matching import DRIFT_M2_PER_M, VIEW_SD_M

STRAIGHT_M = 10.0
"""Length of a path on which drift of the heading explains the drift of the position."""

DRIFT_RAD2_PER_M = 3.0 * DRIFT_M2_PER_M / STRAIGHT_M**2
"""Variance of the heading that each metre adds. A random walk of the heading with q rad^2/m
displaces the end of a path of L m sideways with a variance of q L^3 / 3, here DRIFT_M2_PER_M L."""

UNKNOWN_M2, UNKNOWN_RAD2 = 1e6, math.pi**2 / 3.0
"""Variances of a robot that may be anywhere: of a position, and of a uniform heading."""

UNCERTAIN_M2 = 0.5**2
"""Variance of the position above which the pose is uncertain: 30 m after a recognised view, or
80 m after the start of a map."""

Localisation = Literal['unknown', 'uncertain', 'localised']
"""What is known of the robot's pose on the map. `unknown`: there is no pose on this map, and the
estimate is dead reckoning from an arbitrary place. `uncertain`: the pose was given by an operator
and not confirmed yet, or its standard deviation exceeds 0.5 m. `localised`: recent recognitions
confirm it, or the map has just begun."""


class PoseVariances(NamedTuple):
    """Variances of x and of y, each, and of the heading."""

    position_m2: float
    heading_rad2: float


class PoseUncertainty(Saved):
    """Grows with the distance driven, and shrinks when a place is recognised.

    A new map begins where the robot is, so its pose is exact there.
    """

    SAVED = (
        Field('variances', '_position_m2 _heading_rad2', float, (2,), 0.0),
        Field('unknown_because', 'reason', str),
    )  # fmt: skip

    def __init__(self) -> None:
        self._position_m2 = self._heading_rad2 = 0.0
        self.reason = ''
        """Why the pose is unknown, '' if it is known."""

    @property
    def variances(self) -> PoseVariances:
        """Variances of the pose, at most those of an unknown pose."""
        return PoseVariances(
            min(self._position_m2, UNKNOWN_M2), min(self._heading_rad2, UNKNOWN_RAD2)
        )

    @property
    def localisation(self) -> Localisation:
        """What these variances mean."""
        if self.reason:
            return 'unknown'
        return 'localised' if self._position_m2 <= UNCERTAIN_M2 else 'uncertain'

    def integrate(self, distance_m: float) -> None:
        """Add the drift of a motion over a distance in m."""
        self._position_m2 += DRIFT_M2_PER_M * distance_m
        self._heading_rad2 += DRIFT_RAD2_PER_M * distance_m

    def lose(self, reason: str) -> None:
        """Make the pose unknown, for a reason that is shown to the user."""
        self.give(PoseVariances(UNKNOWN_M2, UNKNOWN_RAD2))
        self.reason = reason

    def give(self, variances: PoseVariances) -> None:
        """Replace the pose by one with these variances."""
        self._position_m2, self._heading_rad2 = variances
        self.reason = ''

    def recognise(self) -> None:
        """Take a recognised place into account.

        Views of one place deviate in the same way, so that several are no better than one.
        """
        self.reason = ''
        self._position_m2 = min(self._position_m2, VIEW_SD_M**2)
        self._heading_rad2 = min(self._heading_rad2, PRIOR_SD_RAD**2)

    def align(self, by_scan_m2: float) -> None:
        """Take the position by scan matching into account: it refines a known pose.

        Args:
            by_scan_m2: its variance; inf without a scan.
        """
        if not self.reason:
            self._position_m2 = min(self._position_m2, by_scan_m2)
