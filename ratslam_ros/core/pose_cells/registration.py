# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Registration: rigid transform from the cells of one component to those of another.

After a gap of the odometry the robot may be anywhere, so what it sees is stored in cells of its
own: a component. Places in different components cannot be compared until consistent views show the
robot's place in both. Not in the papers.
"""

from __future__ import annotations

import math

from ratslam_ros.core.pose_cells.torus import Located, Place, Torus


class Registration:
    """Transform of the places of one component, by one pose that is known in both."""

    def __init__(self, torus: Torus, source: Located, target: Located) -> None:
        """Register two components.

        Args:
            torus: extents of the pose cells.
            source: the pose in the component that is moved.
            target: the same pose in the other component.
        """
        self._torus = torus
        self._source, self._target = source, target
        self._turn_planes = target.place.theta - source.place.theta
        turn_rad = self._turn_planes / torus.planes_per_rad
        self._cos, self._sin = math.cos(turn_rad), math.sin(turn_rad)

    def moved(self, located: Located) -> Located:
        """Return where a place lies in the other component."""
        torus, target = self._torus, self._target
        x = located.unwrapped[0] - self._source.unwrapped[0]
        y = located.unwrapped[1] - self._source.unwrapped[1]
        d_x, d_y = self._cos * x - self._sin * y, self._sin * x + self._cos * y
        return Located(
            Place(
                (target.place.x + d_x) % torus.n_x,
                (target.place.y + d_y) % torus.n_y,
                (located.place.theta + self._turn_planes) % torus.n_theta,
            ),
            (target.unwrapped[0] + d_x, target.unwrapped[1] + d_y),
        )
