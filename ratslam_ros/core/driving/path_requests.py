# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Requests to a controller that follows whole paths, such as the controller server of Nav2."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.driving.goal_follower import remaining_route

UNCHANGED_M = 0.05
"""Displacement of a route below which the controller keeps the old one: the resolution of the
usual costmap."""

AHEAD_M = 1.0
"""Distance along the route that determines the direction of a blocked attempt, in m."""

NO_ROUTE = np.empty((0, 2))


class PathRequests:
    """Decides when a route must be sent to the controller, or driving be cancelled."""

    def __init__(self) -> None:
        self.is_driving = False
        """Whether the controller has been asked to follow a route and has not ended."""
        self._sent = NO_ROUTE

    def on_route(self, route_m: NDArray[np.float64]) -> Literal['send', 'cancel', 'keep']:
        """Return what to do on a route.

        Args:
            route_m: (n, 2) positions from the robot to the goal; n = 0 ends driving.
        """
        if not len(route_m):
            is_driving, self.is_driving = self.is_driving, False
            return 'cancel' if is_driving else 'keep'
        if self.is_driving and self._is_rest_of_sent(route_m):
            return 'keep'
        self._sent, self.is_driving = route_m, True
        return 'send'

    def blocked_direction_rad(self, pose: Pose) -> float:
        """Return the direction on the map in which the robot should have driven.

        Args:
            pose: the robot's pose on the map.
        """
        if not len(self._sent):
            return pose.heading_rad
        rest = remaining_route(self._sent, pose.x_m, pose.y_m)
        along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rest, axis=0).T))])
        x, y = (np.interp(AHEAD_M, along_m, rest[:, axis]) for axis in (0, 1))
        if math.hypot(x - pose.x_m, y - pose.y_m) < UNCHANGED_M:
            return pose.heading_rad
        return math.atan2(y - pose.y_m, x - pose.x_m)

    def _is_rest_of_sent(self, route_m: NDArray[np.float64]) -> bool:
        count = len(route_m)
        if count > len(self._sent):
            return False
        moved = route_m - self._sent[len(self._sent) - count :]
        return float(np.hypot(*moved.T).max()) < UNCHANGED_M
