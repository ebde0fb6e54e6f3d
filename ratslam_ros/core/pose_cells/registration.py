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


def registered(torus: Torus, source: Located, target: Located, located: Located) -> Located:
    """Return where a place of one component lies in another one.

    Args:
        torus: extents of the pose cells.
        source: a pose in the component that is moved.
        target: the same pose in the other component.
        located: the place.
    """
    turn_planes = target.place.theta - source.place.theta
    turn_rad = turn_planes / torus.planes_per_rad
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    x = located.unwrapped[0] - source.unwrapped[0]
    y = located.unwrapped[1] - source.unwrapped[1]
    d_x, d_y = cos * x - sin * y, sin * x + cos * y
    return Located(
        Place(
            (target.place.x + d_x) % torus.n_x,
            (target.place.y + d_y) % torus.n_y,
            (located.place.theta + turn_planes) % torus.n_theta,
        ),
        (target.unwrapped[0] + d_x, target.unwrapped[1] + d_y),
    )
