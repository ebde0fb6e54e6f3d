# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Occupancy plot of sonars in the plane of the pose cells: Milford et al. (2005), section V.A.

The profile of a beam is that of Moravec and Elfes (1985): evidence falls with the square of the
angle from the axis; before the echo, with the square of the distance; around the echo, with the
square of the distance from it. The paper uses "a simplified version" and "a Bayesian update"
without values: here the profile is multiplied by the log odds of the grid of scans. The plot is a
picture; nothing is computed from it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.mapping.occupancy import HIGHEST, HIT, LOWEST, MISS
from ratslam_ros.core.pose_cells.torus import Place, Torus

ERROR_RATIO = 0.01
"""Error of a range, relative to it (Moravec and Elfes 1985); at least the size of a cell."""


class SonarGrid:
    """Log odds that the cells (x', y') are occupied, on the torus of the pose cells."""

    def __init__(self, torus: Torus) -> None:
        """Create a grid in which every cell is unknown."""
        self._torus = torus
        self._log_odds = np.zeros((torus.n_y, torus.n_x))
        self._is_seen = np.zeros((torus.n_y, torus.n_x), np.bool_)

    def add(
        self, place: Place, cell_m: float, mount: Pose, cone_rad: float, range_m: float
    ) -> None:
        """Add a range of a sonar.

        Args:
            place: peak of the active packet.
            cell_m: size of a cell.
            mount: pose of the sonar on the robot.
            cone_rad: width of its beam.
            range_m: its range. One without an echo, which is not finite, is ignored, as it is
                mostly a specular reflection (Moravec and Elfes 1985).
        """
        if not (math.isfinite(range_m) and cone_rad > 0.0):
            return
        heading_rad = place.theta / self._torus.planes_per_rad
        sonar = composed(Pose(place.x * cell_m, place.y * cell_m, heading_rad), mount)
        error_m = max(ERROR_RATIO * range_m, cell_m)
        reach = math.ceil((range_m + error_m) / cell_m)
        x = round(sonar.x_m / cell_m) + _around(reach, self._torus.n_x)
        y = round(sonar.y_m / cell_m) + _around(reach, self._torus.n_y)
        x_m, y_m = (x * cell_m - sonar.x_m)[None, :], (y * cell_m - sonar.y_m)[:, None]
        away_m = np.hypot(x_m, y_m)
        off_rad = np.arctan2(y_m, x_m) - sonar.heading_rad
        off_rad -= math.tau * np.rint(off_rad / math.tau)
        lateral = np.maximum(1.0 - (2.0 * off_rad / cone_rad) ** 2, 0.0)
        free = lateral * np.maximum(1.0 - (away_m / max(range_m - error_m, 1e-9)) ** 2, 0.0)
        arc = lateral * np.maximum(1.0 - ((away_m - range_m) / error_m) ** 2, 0.0)
        cells = np.ix_(y % self._torus.n_y, x % self._torus.n_x)
        before = self._log_odds[cells]
        # One reflector on the arc explains the echo: most likely where other beams found one.
        occupied = arc / (1.0 + np.exp(-before))
        occupied /= max(occupied.sum(), 1e-9)
        self._log_odds[cells] = np.clip(before + MISS * free + HIT * occupied, LOWEST, HIGHEST)
        self._is_seen[cells] |= free + arc > 0.0

    def percent(self) -> NDArray[np.int8]:
        """Return the probabilities, (n_y, n_x), in percent; -1 where no beam has been."""
        percent = np.rint(100.0 / (1.0 + np.exp(-self._log_odds))).astype(np.int8)
        return np.where(self._is_seen, percent, np.int8(-1))


def _around(reach: int, count: int) -> NDArray[np.int64]:
    """Return offsets up to a reach, without those that meet again on a torus of so many cells."""
    reach = max(min(reach, (count - 1) // 2), 0)
    return np.arange(-reach, reach + 1)
