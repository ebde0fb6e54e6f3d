# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose hint: where an operator has said that the robot is.

The robot is there at once, but the operator may be wrong: nothing links its place with the rest of
the map before recognised places agree.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.pose_covariance import Matrix, turned
from ratslam_ros.errors import UnusableInput

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

    @property
    def covariance(self) -> Matrix:
        """Covariance of the pose, in the robot's frame."""
        on_map = np.array([
            [self.x_m2, self.xy_m2, 0.0], [self.xy_m2, self.y_m2, 0.0],
            [0.0, 0.0, self.heading_rad2],
        ])
        return turned(on_map, -self.pose.heading_rad)


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
