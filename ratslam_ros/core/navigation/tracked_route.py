# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tracked route: a route to a goal with the position of the robot on it."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.route_planner import Route

PASSED_LINK_COUNT = 4
"""Number of passed links whose shortcuts still count as ahead, as the position is uncertain."""

BEHAVIOUR_LINK_COUNT = 10
"""Number of links ahead that determine which wall to follow."""

SAG_RATIO = 0.5
"""Maximum deviation of a driven path from its straight link, as a ratio of the link's length.

After pruning, one link stands for a path through several removed experiences.
"""


class TrackedRoute:
    """A route and the position of the robot on it.

    The route ends at the goal itself. The last segment, from the last experience to the goal,
    takes no time. Coordinates are read from the map at each call, because the map changes.
    """

    def __init__(self, route: Route, experience_map: ExperienceMap) -> None:
        self.ids = np.array(route.experience_ids)
        ends, count = experience_map.link_ends, len(experience_map)
        self._linked = np.asarray(_are_linked(ends, self.ids, count))
        """(n - 1,) whether a link connects each experience with the next; False: a shortcut."""
        arrival_s = np.array(route.arrival_s)
        self._to_goal_s = np.append(arrival_s[-1] - arrival_s, 0.0)
        self._segment, self._fraction = 0, 0.0
        self.cross_track_m = 0.0
        """Distance from the robot to its position on the route in m."""
        self.sag_m = 0.0
        """Possible deviation of the driven path from the current link in m."""
        self.is_at_end = False
        """Whether the robot is at the end of the route."""

    @property
    def remaining_s(self) -> float:
        """Time from the robot to the goal in s."""
        before_s, after_s = self._to_goal_s[self._segment : self._segment + 2].tolist()
        return float(before_s + self._fraction * (after_s - before_s))

    def advance(self, poses: NDArray[np.float64], goal: Pose, pose: Pose, window_m: float) -> None:
        """Move the position to the nearest point of the route ahead.

        Args:
            poses: (n, 3) poses of the experiences.
            goal: pose of the goal.
            pose: pose of the robot.
            window_m: length of the route section that is searched in m.
        """
        points = self._points(poses, goal)
        self._segment, self._fraction, self.cross_track_m = _nearest_ahead(
            points, self._segment, self._fraction, pose.x_m, pose.y_m, window_m
        )
        self.sag_m = SAG_RATIO * math.dist(*points[self._segment : self._segment + 2].tolist())
        self.is_at_end = (
            self._fraction == 1.0 or not np.diff(points[self._segment :], axis=0).any()
        )

    def advance_by_time(self, elapsed_s: float) -> None:
        """Move the position to where the robot arrives after a time, wherever it is on the map."""
        remaining_s = max(self.remaining_s - elapsed_s, 0.0)
        passed = int(np.count_nonzero(self._to_goal_s >= remaining_s))
        self._segment = min(passed, len(self.ids)) - 1
        before_s, after_s = self._to_goal_s[self._segment : self._segment + 2].tolist()
        self._fraction = (before_s - remaining_s) / (before_s - after_s) if before_s else 1.0
        self.cross_track_m = 0.0
        self.is_at_end = remaining_s == 0.0

    def ahead(
        self, poses: NDArray[np.float64], goal: Pose
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the (k, 2) points from the robot to the goal in m, and (k,) arrival times in s.

        Args:
            poses: (n, 3) poses of the experiences.
            goal: pose of the goal.
        """
        positions_m = self._points(poses, goal)[self._segment :]
        positions_m[0] += self._fraction * (positions_m[1] - positions_m[0])
        arrival_s = self.remaining_s - self._to_goal_s[self._segment :]
        arrival_s[0] = 0.0
        count = len(arrival_s)
        if (positions_m[-1] == positions_m[-2]).all():  # the goal is at its experience
            count -= 1
        return positions_m[:count], arrival_s[:count]

    def is_intact(self, experience_map: ExperienceMap) -> bool:
        """Return whether all links ahead of the robot still exist."""
        ends, count = experience_map.link_ends, len(experience_map)
        if self.ids.max() >= count:
            return False
        still = np.asarray(_are_linked(ends, self.ids[self._segment :], count))
        return bool(np.all(still | ~self._linked[self._segment :]))

    def shortcut_ends_ahead(self, poses: NDArray[np.float64], length_m: float) -> list[int]:
        """Return the ends of the shortcuts on the next section of the route.

        The section begins PASSED_LINK_COUNT links behind the robot.

        Args:
            poses: (n, 3) poses of the experiences.
            length_m: length of the section ahead of the robot in m.
        """
        first = max(self._segment - PASSED_LINK_COUNT, 0)
        steps_m = np.hypot(*np.diff(poses[self.ids[first:], :2], axis=0).T)
        steps_m[: self._segment - first] = 0.0
        count = int(np.count_nonzero(np.cumsum(steps_m) - steps_m <= length_m))
        shortcuts = np.flatnonzero(~self._linked[first : first + count]) + first
        return [int(self.ids[n]) for start in shortcuts.tolist() for n in (start, start + 1)]

    def behaviour(self, experience_map: ExperienceMap) -> str:
        """Return the wall that most of the next links were driven along, '' for neither."""
        ids = self.ids[self._segment : self._segment + BEHAVIOUR_LINK_COUNT + 1].tolist()
        behaviours = [experience_map.behaviour_between(a, b) for a, b in pairwise(ids)]
        left, right = behaviours.count('left_wall'), behaviours.count('right_wall')
        return '' if left == right else 'left_wall' if left > right else 'right_wall'

    def leads_over(self, experience_id: int) -> bool:
        """Return whether an experience lies on the route ahead."""
        return bool((self.ids[self._segment :] == experience_id).any())

    def ends_with(self, other: TrackedRoute) -> bool:
        """Return whether another route is the same or the last part of this one."""
        return np.array_equal(self.ids[-len(other.ids) :], other.ids)

    def is_rejoined_by(self, other: TrackedRoute, visited: set[int]) -> bool:
        """Return whether another route leads to this one over visited experiences only."""
        first = next((i for i in other.ids.tolist() if i not in visited), None)
        return first is not None and bool((self.ids == first).any())

    def _points(self, poses: NDArray[np.float64], goal: Pose) -> NDArray[np.float64]:
        points = np.empty((len(self.ids) + 1, 2))
        points[:-1] = poses[self.ids, :2]
        points[-1] = goal[:2]
        return points


class RouteLoss:
    """Position on the last route by elapsed time, while no route leads to the goal.

    Route loss recovery of Milford et al. (2006), section IV.D, as printed. ``RouteFollowing`` uses
    it in place of the position on the map with ``route_position: elapsed_time``.
    """

    def __init__(self) -> None:
        self._last_ns = 0
        self.is_lost = False
        """Whether the last known route is followed, as there is no other one."""

    def update(
        self, stamp_ns: int, last: TrackedRoute | None, planned: TrackedRoute | None
    ) -> TrackedRoute | None:
        """Return the last route while there is no plan, advanced by the time since the last call.

        Args:
            stamp_ns: current stamp.
            last: the route that is followed.
            planned: the route from the current experience, None if there is none.

        Returns:
            The route to follow; None if the plan replaces the route that was followed by time.
        """
        elapsed_s = (stamp_ns - self._last_ns) * 1e-9
        was_lost, self.is_lost = self.is_lost, planned is None and last is not None
        self._last_ns = stamp_ns
        if last is not None and planned is None:
            last.advance_by_time(elapsed_s)
        return last if self.is_lost or not was_lost else None


@compiled
def _nearest_ahead(
    points: NDArray[np.float64], first_segment: int, fraction: float, x: float, y: float,
    window: float,
) -> tuple[int, float, float]:
    """Return the nearest position on a polyline: segment, fraction of the segment, and distance.

    The search covers a length ``window`` from the given segment and fraction on. Among equally
    near positions the first is returned.
    """
    best_segment, best_fraction, best_distance = first_segment, fraction, math.inf
    least = fraction
    searched = 0.0
    for segment in range(first_segment, len(points) - 1):
        d_x = points[segment + 1, 0] - points[segment, 0]
        d_y = points[segment + 1, 1] - points[segment, 1]
        squared = d_x * d_x + d_y * d_y
        most = 1.0
        length = math.sqrt(squared)
        if searched + (1.0 - least) * length > window:
            most = least + (window - searched) / length
        along = least
        if squared > 0.0:
            along = ((x - points[segment, 0]) * d_x + (y - points[segment, 1]) * d_y) / squared
        along = min(max(along, least), most)
        e_x = points[segment, 0] + along * d_x - x
        e_y = points[segment, 1] + along * d_y - y
        distance = math.sqrt(e_x * e_x + e_y * e_y)
        if distance < best_distance:
            best_segment, best_fraction, best_distance = segment, along, distance
        searched += (1.0 - least) * length
        if searched >= window:
            break
        least = 0.0
    if best_fraction >= 1.0 and best_segment < len(points) - 2:
        return best_segment + 1, 0.0, best_distance
    return best_segment, best_fraction, best_distance


@compiled
def _are_linked(
    ends: NDArray[np.int64], ids: NDArray[np.int64], count: int
) -> NDArray[np.bool_]:
    """Return (n - 1,) whether a link in either direction connects each id with the next.

    Args:
        ends: (links, 2) source and target ids.
        ids: (n,) distinct ids.
        count: number of experiences on the map.
    """
    rank = np.full(count, -2, np.int64)
    linked = np.zeros(len(ids) - 1, np.bool_)
    for k in range(len(ids)):
        rank[ids[k]] = k
    for row in range(len(ends)):
        a = rank[ends[row, 0]]
        b = rank[ends[row, 1]]
        if a >= 0 and b >= 0 and abs(a - b) == 1:
            linked[min(a, b)] = True
    return linked
