# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose hint: where an operator has said that the robot is, as evidence for a relocation.

A hint alone does not move the robot, as the operator may be wrong. It lets recognised views do so
earlier: two loop closures that agree with it and with each other suffice, instead of six.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.mapping.icp import PRIOR_SD_RAD
from ratslam_ros.core.mapping.scan_matching import DRIFT_M2_PER_M, VIEW_SD_M
from ratslam_ros.errors import UnusableInput

CHI_SQUARE_3 = 11.345
"""99 % quantile of the chi-square distribution with 3 degrees of freedom: x, y and heading."""

LONGEST_M = 30.0
"""Distance driven after which a hint is discarded: as far as two places count as two visits."""

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


class GivenHint(NamedTuple):
    """A hint in use: the robot's pose on the map and the odometer when it was given."""

    hint: PoseHint
    there: Pose
    odometer_m: float

    def agrees(self, here: Pose, claimed: Pose, odometer_m: float) -> bool:
        """Return whether a pose agrees with the hint, carried along by odometry.

        Args:
            here: present pose of the robot on the map, by the odometry since the hint.
            claimed: pose of the robot according to a recognised view.
            odometer_m: present odometer reading in m.
        """
        expected = composed(self.hint.pose, composed(inverse(self.there), here))
        turned = expected.heading_rad - self.hint.pose.heading_rad
        driven_m = odometer_m - self.odometer_m
        away = math.dist(self.there[:2], here[:2])
        # The heading's uncertainty displaces the end of the path since the hint.
        spread = VIEW_SD_M**2 + DRIFT_M2_PER_M * driven_m + self.hint.heading_rad2 * away**2
        a, b, c = self.hint.x_m2 + spread, self.hint.xy_m2, self.hint.y_m2 + spread
        x, y = claimed.x_m - expected.x_m, claimed.y_m - expected.y_m
        position = (c * x * x - 2.0 * b * x * y + a * y * y) / (a * c - b * b)
        heading = wrap(claimed.heading_rad - self.hint.pose.heading_rad - turned)
        heading_rad2 = self.hint.heading_rad2 + PRIOR_SD_RAD**2
        return position + heading * heading / heading_rad2 <= CHI_SQUARE_3

    def state(self) -> list[Any]:
        """Return all values, for ``from_state``."""
        return [list(self.hint.pose), list(self.hint[1:]), list(self.there), self.odometer_m]

    @classmethod
    def from_state(cls, state: list[Any]) -> GivenHint:
        """Return a hint from ``state``."""
        pose, variances, there, odometer_m = state
        return cls(PoseHint(Pose(*pose), *variances), Pose(*there), float(odometer_m))
