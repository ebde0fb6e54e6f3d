# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exploration by the map: drive to the nearest exit of a known place that was never taken.

After Milford (2008): the links of the experience map are "used to aid exploration". The excerpt
does not say how. An exit is a free direction of a place, and it was taken if the robot has been
where it leads to.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.free_directions import LocalMovement
from ratslam_ros.core.driving.goal_follower import GoalFollower, in_robot_frame
from ratslam_ros.core.driving.steering import Command
from ratslam_ros.core.navigation.goals import Goal
from ratslam_ros.core.navigation.route_following import RouteFollowing
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE

EXIT_M = 2.5
"""Free distance of an exit in m. The point at this distance stands for the exit: further than the
other lane of a corridor, so that it lies in the room behind a door."""

EVERY_DIRECTION = 5
"""Step between the directions that are examined, in those of ``LocalMovement``: 15 degrees."""

TAKEN_M = 1.5
"""Distance from an experience within which the point of an exit was visited, in m."""

AT_EXPERIENCE_M = 0.3
"""Maximum distance from an experience at which its exits are recorded, in m."""

KNOWN_M = 1.0
"""Distance from older experiences within which the robot is on known ground, in m."""

OLD_M = 10.0
"""Distance driven since an experience was created, from which it is older, in m. A look-back is
shorter."""

RETURNED_M = 1.0
"""Distance on known ground after which the robot drives to an exit, in m."""

PERIOD_NS = 10_000_000_000
"""Time after which exits are searched again if there is none, or no way to one."""

MAX_TRY_COUNT = 2
"""Failed tries after which an exit is given up."""

TIMEOUT_S, TIMEOUT_FACTOR = 20.0, 3.0
"""An exit is given up after the duration of its route times the factor, and this many s."""


class UntriedExits:
    """Records the exits of all places, and leads the robot to those that were never taken.

    On new ground the robot follows walls as before. On known ground it takes the fastest route to
    an exit in whose direction no experience lies; if there is none, it follows walls.
    """

    def __init__(self, parameters: GoalFollowerParameters, planner: RoutePlanner) -> None:
        self._p, self._planner, self._map = parameters, planner, planner.experience_map
        self._exits: list[Goal] = []
        self._abandoned: list[Goal] = []
        self._at = NO_EXPERIENCE
        self._known_since_m: float | None = None
        self._search_ns = self._end_ns = self._try_count = 0
        self._following: RouteFollowing | None = None
        self._follower = GoalFollower(parameters)

    def command(self, scan: Scan, pose: Pose, offset: Pose) -> Command | None:
        """Return the command towards an exit, None for a robot that should follow walls.

        Args:
            scan: the current scan.
            pose: pose of the robot on the map.
            offset: its pose in the frame of the current experience.
        """
        if self._map.localisation != 'localised' or self._map.current_id == NO_EXPERIENCE:
            self._following = self._known_since_m = None
            return None
        self._record(scan, offset)
        if self._following is None and self._has_returned(pose):
            self._choose(scan.stamp_ns)
        if self._following is None:
            return None
        command = self._follow(self._following, scan, pose)
        if command is None:
            self._following = self._known_since_m = None
        return command

    @property
    def goal(self) -> Pose | None:
        """Pose on the map of the exit that the robot drives to, None if it follows walls."""
        return None if self._following is None else self._following.goal.pose_on(self._map)

    def remove_pruned(self, experience_id: int, stand_in_id: int, pose_in_stand_in: Pose) -> None:
        """Handle the removal of an experience from the map; see ``Goal.reanchored``."""
        self._exits = [e for e in self._exits if e.experience_id != experience_id]
        if self._at == experience_id:
            self._at = NO_EXPERIENCE  # the id may be given again
        removed = experience_id, stand_in_id, pose_in_stand_in
        self._abandoned = [e.reanchored(*removed) for e in self._abandoned]
        if self._following is not None:
            self._following.remove_pruned(*removed)

    def _record(self, scan: Scan, offset: Pose) -> None:
        """Record the exits of an experience that has just become the current one."""
        at = self._map.current_id
        if at == self._at or math.hypot(offset.x_m, offset.y_m) > AT_EXPERIENCE_M:
            return
        self._at = at
        for direction in LocalMovement(self._p, scan).straight_directions()[::EVERY_DIRECTION]:
            if direction.free_m >= EXIT_M:
                heading_rad = direction.heading_rad
                ahead = Pose(
                    EXIT_M * math.cos(heading_rad), EXIT_M * math.sin(heading_rad), heading_rad
                )
                self._exits.append(Goal(at, composed(offset, ahead)))

    def _has_returned(self, pose: Pose) -> bool:
        """Return whether the robot has driven RETURNED_M on known ground."""
        poses, driven_m = self._map.poses, self._map.odometer_m
        near = np.hypot(poses[:, 0] - pose.x_m, poses[:, 1] - pose.y_m) < KNOWN_M
        if not (self._map.created_m[near] < driven_m - OLD_M).any():
            self._known_since_m = None
            return False
        if self._known_since_m is None:
            self._known_since_m = driven_m
        return driven_m - self._known_since_m >= RETURNED_M

    def _choose(self, stamp_ns: int) -> None:
        """Forget the exits that were taken or given up, and start to the nearest other one."""
        from scipy.spatial import cKDTree

        if not self._exits or stamp_ns < self._search_ns:
            return
        at_m = self._points(self._exits)
        taken = cKDTree(self._map.poses[:, :2]).query(at_m)[0] < TAKEN_M
        if self._abandoned:
            taken |= cKDTree(self._points(self._abandoned)).query(at_m)[0] < TAKEN_M
        self._exits = [e for e, is_taken in zip(self._exits, taken, strict=True) if not is_taken]
        arrival_s = self._planner.temporal_map().arrival_s
        ways = [(float(arrival_s[e.experience_id]), e) for e in self._exits]
        duration_s, goal = min(ways, key=lambda way: way[0], default=(math.inf, None))
        if goal is None or not math.isfinite(duration_s):
            self._search_ns = stamp_ns + PERIOD_NS
            return
        self._following = RouteFollowing(self._planner, goal)
        self._follower, self._try_count = GoalFollower(self._p), 0
        self._end_ns = stamp_ns + round((TIMEOUT_S + TIMEOUT_FACTOR * duration_s) * 1e9)

    def _follow(self, following: RouteFollowing, scan: Scan, pose: Pose) -> Command | None:
        """Return the command along the route, None at its end, or if the exit is given up."""
        guidance = following.update(scan.stamp_ns, pose)
        if guidance.status == 'succeeded':
            return None
        if len(guidance.positions_m) and scan.stamp_ns < self._end_ns:
            route = in_robot_frame(pose, guidance.positions_m)
            command = self._follower.command(scan, route, guidance.behaviour)
            self._try_count += command.failed
            if self._try_count < MAX_TRY_COUNT:
                return command
        self._abandoned.append(following.goal)
        return None

    def _points(self, exits: list[Goal]) -> NDArray[np.float64]:
        return np.array([e.pose_on(self._map)[:2] for e in exits])
