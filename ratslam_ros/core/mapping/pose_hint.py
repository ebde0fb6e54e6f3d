# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose hint: where an operator has said that the robot is.

The robot is there at once, but the operator may be wrong: nothing links its place with the rest of
the map before recognised places agree.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.icp import PRIOR_SD_RAD
from ratslam_ros.core.mapping.scan_matching import DRIFT_M2_PER_M, VIEW_SD_M
from ratslam_ros.errors import UnusableInput

CHI_SQUARE_3 = 11.345
"""99 % quantile of the chi-square distribution with 3 degrees of freedom: x, y and heading."""

LONGEST_M = 30.0
"""Distance driven after which a hint is dropped that no recognised place has confirmed: as far as
two places count as two visits."""

MAX_COORDINATE_M, MAX_VARIANCE = 1e6, 1e6
"""Largest accepted coordinate in m, and variance in m^2 or rad^2."""


class PoseHint(NamedTuple):
    """A pose of the robot on the map, and the variances and covariance of its position.

    Attributes:
        pose: the pose.
        x_m2, xy_m2, y_m2: covariance of the position.
        heading_rad2: variance of the heading.
    """

    pose: Pose
    x_m2: float
    xy_m2: float
    y_m2: float
    heading_rad2: float

    def checked(self) -> PoseHint:
        """Return the hint itself.

        Raises:
            UnusableInput: a value is not finite or too large, or the covariance is not positive
                semidefinite.
        """
        if not all(abs(value) <= MAX_COORDINATE_M for value in self.pose):  # NaN is not
            raise UnusableInput(f'its pose is {tuple(self.pose)}; expected finite coordinates')
        a, b, c = self.x_m2, self.xy_m2, self.y_m2
        variances = a, c, self.heading_rad2
        if not all(0.0 <= value <= MAX_VARIANCE for value in variances) or not b * b <= a * c:
            raise UnusableInput(
                f'its covariance has the variances {variances} and the covariance {b} of x and y; '
                f'expected 0 to {MAX_VARIANCE:g}, and a positive semidefinite matrix'
            )
        return self

    def agrees(self, expected: Pose, claimed: Pose, driven_m: float = 0.0) -> bool:
        """Return whether a pose lies within the 99 % region of the hint.

        Args:
            expected: the pose of the hint, carried along by odometry.
            claimed: pose of the robot according to a recognised place.
            driven_m: distance driven since the hint.
        """
        # The heading's uncertainty displaces the end of the path since the hint.
        away = math.dist(self.pose[:2], expected[:2])
        spread = VIEW_SD_M**2 + DRIFT_M2_PER_M * driven_m + self.heading_rad2 * away**2
        a, b, c = self.x_m2 + spread, self.xy_m2, self.y_m2 + spread
        x, y = claimed.x_m - expected.x_m, claimed.y_m - expected.y_m
        position = (c * x * x - 2.0 * b * x * y + a * y * y) / (a * c - b * b)
        heading = wrap(claimed.heading_rad - expected.heading_rad)
        heading_rad2 = self.heading_rad2 + PRIOR_SD_RAD**2
        return position + heading * heading / heading_rad2 <= CHI_SQUARE_3


class GivenHint(NamedTuple):
    """A hint in use, and the odometer reading in m when it was given."""

    hint: PoseHint
    odometer_m: float

    def state(self) -> list[Any]:
        """Return all values, for ``from_state``."""
        return [list(self.hint.pose), list(self.hint[1:]), self.odometer_m]

    @classmethod
    def from_state(cls, state: list[Any]) -> GivenHint:
        """Return a hint from ``state``."""
        pose, variances, odometer_m = state
        return cls(PoseHint(Pose(*pose), *variances), float(odometer_m))
