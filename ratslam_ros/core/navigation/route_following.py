# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Route following: replanning, route switching, recovery, and arrival at one goal."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config.goal_recall import GoalRecallParameters
from ratslam_ros.core.navigation.goal_tree import GoalTree
from ratslam_ros.core.navigation.goals import Goal
from ratslam_ros.core.navigation.route_planner import RoutePlanner, nowhere_because
from ratslam_ros.core.navigation.tracked_route import RouteLoss, TrackedRoute
from ratslam_ros.errors import UnreachableGoal

Status = Literal[
    'idle', 'following', 'recovering', 'lost', 'succeeded', 'failed', 'timed_out', 'cancelled'
]

END_RADIUS_FACTOR = 1.2
"""Factor on ``goal_radius_m`` for a robot that is at the end of its route."""

AT_GOAL_M = 0.04
"""Distance at which the goal is reached at once, in m."""

RECEDING_M = 0.05
"""Increase of the distance, within the goal radius, after which the goal is reached, in m."""

MAX_DWELL_S = 4.0
"""Time within the goal radius after which the goal is reached, in s."""

STUCK_S = 25.0
"""Time without progress after which the robot is stuck, in s."""

STUCK_M = 2.5
"""Side of the square that a robot without progress stays in, in m."""

UPDATE_GAP_S = 5.0
"""Time between updates that restarts the detection of a stuck robot, in s."""

MAX_STEP_M = 0.2
"""Upper limit of the distance counted as driven between two updates, in m. Larger changes of the
pose are corrections of the map."""

SHORTCUT_AHEAD_M = 2.0
"""Length of the route section ahead of a blocked robot whose shortcuts are rejected, in m."""

SHORTCUT_RADIUS_M = 1.0
"""Radius around a blocked robot in which all shortcuts are rejected, in m."""

RECOVERY_M = 4.0
"""Distance that a stuck robot explores before it follows a route again, in m."""

ROUTE_KEEP_S = 60.0
"""Time in s for which the last valid route is followed if none is found from the present place. In
it, the robot crosses stretches that are not recognised."""

ROUTE_WIDTH_M = 1.5
"""Distance in m from a followed route at which it is dropped: wider than the bends of the map, and
narrower than the distance between two corridors."""

SEARCH_WINDOW_M = 2.0 * ROUTE_WIDTH_M
"""Length of the route section in which the robot is located, in m."""

WAYPOINT_AHEAD_M = 1.0
"""Distance of the waypoint ahead of the robot in m: smooths small bends and cuts no corners."""


@dataclass(frozen=True, eq=False)
class Guidance:
    """Where to go now.

    Attributes:
        status: ``following`` the route of the current map; ``recovering``: following the last
            route, as there is no route now or only a slower one; ``lost``: there is no route;
            ``idle``: there is no goal; otherwise the final status of the last goal.
        positions_m: (n, 2) the route on the map from the robot to the goal in m, empty for none.
        arrival_s: (n,) expected arrival times from now in s.
        remaining_s: time to the goal in s, infinite without a route.
        waypoint: a lookahead point on the route, with the heading of the route.
        goal: the goal on the map.
        explore: whether the robot should explore to find a route.
        behaviour: wall that most of the next links were learned along, '' for neither.
        replanned: number of routes adopted for this goal.
        switched: number of times that a route was replaced by a different one.
        reason: why the goal is paused, '' if it is not.
    """

    status: Status
    positions_m: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    arrival_s: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    remaining_s: float = math.inf
    waypoint: Pose | None = None
    goal: Pose | None = None
    explore: bool = False
    behaviour: str = ''
    replanned: int = 0
    switched: int = 0
    reason: str = ''


class RouteFollowing:
    """Follows the route to one goal on a map that changes during the drive.

    After Milford et al. (2006), section IV.D, and Milford (2008). The route is replanned whenever
    the current experience or the links change. A faster route is adopted at once. A slower one is
    adopted only if no other was found for ``route_switch_s`` (hysteresis). If no route is found,
    the last one is followed for ROUTE_KEEP_S. The same applies if the planned route only leads
    back to the followed one, over experiences visited since the two last agreed: while
    views are not recognised, a second layer of experiences grows beside the old one, and all
    routes over its links lead back to its start.

    The position on the route is the nearest point ahead, so the odometry measures the progress.
    With ``route_position: elapsed_time``, it advances by elapsed time while no route is found, as
    in the original work (``RouteLoss``). While the robot's pose is unknown, no route is followed:
    it explores until a place is recognised.

    A followed route is dropped at once if the robot is more than ROUTE_WIDTH_M away from it,
    or if a link ahead of the robot is unlearned.
    """

    def __init__(self, planner: RoutePlanner, goal: Goal) -> None:
        """Start with a goal.

        Args:
            planner: plans the routes; its parameters may be replaced at any time.
            goal: the goal.
        """
        self.goal = goal
        self._planner = planner
        self._map = planner.experience_map
        self._tree: GoalTree | None = None
        self._tries_blocked = True
        """Whether unlearned links are used if no others lead to the goal."""
        self._planned_version: tuple[int, int, int, int] | None = None
        """Version of the map and position for which ``_planned`` was computed."""
        self._planned: TrackedRoute | None = None
        self._followed: TrackedRoute | None = None
        self._adopted: TrackedRoute | None = None
        """The last followed route, even after it was dropped."""
        self._visited: set[int] = set()
        """Experiences visited since the planned route last agreed with the followed one."""
        self._confirmed_ns = 0
        self._last_pose: Pose | None = None
        self._recovery_m = 0.0
        self._slower_since_ns: int | None = None
        self._closest: tuple[float, int] | None = None
        """Smallest distance to the goal in m since the robot entered its radius, and when it
        entered."""
        self._trail: deque[tuple[int, float, float]] = deque()
        """Stamps and positions of the last STUCK_S, about one per second."""
        self._replanned = self._switched = 0
        self._loss = RouteLoss()

    def update(self, stamp_ns: int, pose: Pose | None = None) -> Guidance:
        """Return where to go.

        Args:
            stamp_ns: current stamp; must not decrease.
            pose: pose of the robot on the map, None: the map's estimate.
        """
        pose = self._map.pose if pose is None else pose
        goal = self.goal.pose_on(self._map)
        poses = self._map.poses
        if reason := nowhere_because(self._map):
            self._trail.clear()
            self._planned = self._planned_version = self._followed = None
            self._closest = self._last_pose = None
            return self._guidance('lost', goal, explore=True, reason=reason)
        self._replan()
        self._update_recovery(pose)
        if self._p.route_position == 'elapsed_time':
            self._followed = self._loss.update(stamp_ns, self._followed, self._planned)
        for route in (self._planned, self._followed):
            if route is not None and not self._loss.is_lost:
                route.advance(poses, goal, pose, SEARCH_WINDOW_M)
        if self._is_reached(goal, pose, stamp_ns) and self._map.localisation == 'localised':
            return self._guidance('succeeded', goal, remaining_s=0.0)
        if self._is_stuck(stamp_ns, pose) and self.report_blocked():
            self.start_recovery()
        if self._recovery_m > 0.0:
            self._followed = None
            return self._guidance('lost', goal, explore=True)
        followed = self._followed
        if followed is not None and followed.cross_track_m > max(ROUTE_WIDTH_M, followed.sag_m):
            self._followed = None
        confirmed = self._select_route(stamp_ns)
        route = self._followed
        if route is None:
            return self._guidance('lost', goal, explore=True)
        positions_m, arrival_s = route.ahead(poses, goal)
        waypoint = point_ahead(positions_m, WAYPOINT_AHEAD_M, pose.heading_rad)
        return self._guidance(
            'following' if confirmed else 'recovering', goal, positions_m=positions_m,
            arrival_s=arrival_s, remaining_s=route.remaining_s, waypoint=waypoint,
            behaviour=route.behaviour(self._map),
        )

    def start_recovery(self) -> None:
        """Drop the route and explore for RECOVERY_M.

        For a robot that cannot follow its route although no link is unlearned: its position
        estimate is wrong, and nothing would correct it while the robot stands still.
        """
        self._followed, self._recovery_m = None, RECOVERY_M

    def report_blocked(self) -> bool:
        """Handle a failed try; return False if shortcuts of the route were rejected for it.

        If the next section of the route has shortcuts or unlearned links, these are assumed to be
        blocked. From now on, no route to this goal is planned over unlearned links.
        """
        self._trail.clear()  # the caller counts this try
        self._tries_blocked, self._planned_version = False, None
        route, poses = self._followed, self._map.poses
        ends = [] if route is None else route.shortcut_ends_ahead(poses, SHORTCUT_AHEAD_M)
        if not ends:
            return True
        # Shortcuts beside the rejected ones would only lead to the same obstacle again.
        x_m, y_m, _ = self._map.pose
        near = np.hypot(poses[:, 0] - x_m, poses[:, 1] - y_m) < SHORTCUT_RADIUS_M
        self._planner.rejected_shortcuts.update([*ends, *np.flatnonzero(near).tolist()])
        self._followed = None
        return False

    def _is_stuck(self, stamp_ns: int, pose: Pose) -> bool:
        """Return whether the robot has stayed within STUCK_M for STUCK_S."""
        trail = self._trail
        if trail and stamp_ns - trail[-1][0] > UPDATE_GAP_S * 1e9:
            trail.clear()
        if not trail or stamp_ns - trail[-1][0] >= 1e9:
            trail.append((stamp_ns, pose.x_m, pose.y_m))
        if stamp_ns - trail[0][0] < STUCK_S * 1e9:
            return False
        places = np.array(trail)[:, 1:]
        trail.popleft()
        if (np.ptp(places, axis=0) > STUCK_M).any():
            return False
        trail.clear()
        return True

    def remove_pruned(self, experience_id: int, stand_in_id: int, pose_in_stand_in: Pose) -> None:
        """Handle the removal of an experience from the map; see ``Goal.reanchored``."""
        self.goal = self.goal.reanchored(experience_id, stand_in_id, pose_in_stand_in)
        self._planned_version = None
        if self._followed is not None and self._followed.leads_over(experience_id):
            self._followed = None

    @property
    def _p(self) -> GoalRecallParameters:
        return self._planner.parameters

    def _replan(self) -> None:
        """Plan the route from the current experience if position or map have changed."""
        graph = self._map
        rejected = len(self._planner.rejected_shortcuts)
        version = graph.current_id, graph.link_table.version, len(graph), rejected
        if version == self._planned_version:
            return
        relinked = self._planned_version is None or version[1] != self._planned_version[1]
        followed = self._followed
        if relinked and followed is not None and not followed.is_intact(graph):
            self._followed = None
        self._planned_version = version
        self._visited.add(graph.current_id)
        goal_id, tree = self.goal.experience_id, self._tree
        try:
            if tree is None or tree.goal_id != goal_id:
                tree = self._tree = GoalTree(self._planner, goal_id)
            try:
                route = tree.route()
            except UnreachableGoal:
                if not self._tries_blocked or len(graph.unlearned_ends) == 0:
                    raise
                route = self._planner.temporal_map(blocked=True).route_to(goal_id)
            self._planned = TrackedRoute(route, graph)
        except UnreachableGoal:
            self._planned = None
            if graph.component_of(graph.current_id) != graph.component_of(goal_id):
                self._followed = None  # the pose relative to the route is unknown

    def _update_recovery(self, pose: Pose) -> None:
        """Update the distance for which the robot still explores."""
        if self._last_pose is not None:
            step_m = math.hypot(pose.x_m - self._last_pose.x_m, pose.y_m - self._last_pose.y_m)
            self._recovery_m -= min(step_m, MAX_STEP_M)
        self._last_pose = pose

    def _select_route(self, stamp_ns: int) -> bool:
        """Choose between planned and followed route; return whether the plan confirms the choice.

        A planned route that is the end of the followed one confirms the followed route.
        """
        planned, followed = self._planned, self._followed
        if followed is not None and planned is not None and followed.ends_with(planned):
            planned = followed
        elif followed is not None:
            unconfirmed_s = (stamp_ns - self._confirmed_ns) * 1e-9
            if followed.is_at_end or unconfirmed_s >= ROUTE_KEEP_S:
                followed = self._followed = None
        if planned is None:
            return False
        if planned is not followed:
            if followed is not None and not self._should_switch(planned, followed, stamp_ns):
                return False
            self._switched += followed is not None
            self._replanned += self._adopted is None or not self._adopted.ends_with(planned)
            self._followed = self._adopted = planned
        self._confirmed_ns, self._slower_since_ns = stamp_ns, None
        self._visited.clear()
        return True

    def _should_switch(
        self, planned: TrackedRoute, followed: TrackedRoute, stamp_ns: int
    ) -> bool:
        """Return whether to replace the followed route, with hysteresis for slower routes."""
        if planned.remaining_s <= followed.remaining_s:
            return True
        if followed.is_rejoined_by(planned, self._visited):
            self._slower_since_ns = None
            return False
        if self._slower_since_ns is None:
            self._slower_since_ns = stamp_ns
        return stamp_ns - self._slower_since_ns >= self._p.route_switch_s * 1e9

    def _is_reached(self, goal: Pose, pose: Pose, stamp_ns: int) -> bool:
        """Return whether the robot is within the goal radius and comes no closer.

        Without the second condition every drive would end at the edge of the radius.
        """
        distance_m = math.hypot(goal.x_m - pose.x_m, goal.y_m - pose.y_m)
        is_near = distance_m <= self._p.goal_radius_m * END_RADIUS_FACTOR
        if self._followed is not None and self._followed.is_at_end:
            return is_near
        if distance_m > self._p.goal_radius_m:
            has_left = self._closest is not None and is_near
            self._closest = self._closest if has_left else None
            return has_left
        closest_m, since_ns = self._closest or (distance_m, stamp_ns)
        self._closest = min(closest_m, distance_m), since_ns
        recedes = distance_m > closest_m + RECEDING_M
        return distance_m < AT_GOAL_M or recedes or stamp_ns - since_ns > MAX_DWELL_S * 1e9

    def _guidance(self, status: Status, goal: Pose, **fields: Any) -> Guidance:
        return Guidance(
            status, goal=goal, replanned=self._replanned, switched=self._switched, **fields
        )


def point_ahead(
    positions_m: NDArray[np.float64], lookahead_m: float, heading_rad: float
) -> Pose:
    """Return the lookahead point of a polyline, with the heading of its segment.

    Args:
        positions_m: (n, 2) polyline in m, n > 0.
        lookahead_m: distance along the polyline in m; beyond its end the last point is returned.
        heading_rad: heading to return for a polyline of length 0.
    """
    steps_m = np.diff(positions_m, axis=0)
    lengths_m = np.hypot(steps_m[:, 0], steps_m[:, 1])
    x_m, y_m = positions_m[-1].tolist()
    segments = np.flatnonzero(lengths_m)
    if len(segments) == 0:
        return Pose(x_m, y_m, heading_rad)
    ends_m = np.cumsum(lengths_m[segments])
    index = min(int(np.searchsorted(ends_m, lookahead_m)), len(segments) - 1)
    d_x, d_y = (steps_m[segments[index]] / lengths_m[segments[index]]).tolist()
    back_m = max(float(ends_m[index]) - lookahead_m, 0.0)
    x_m, y_m = positions_m[segments[index] + 1].tolist()
    return Pose(x_m - back_m * d_x, y_m - back_m * d_y, math.atan2(d_y, d_x))
