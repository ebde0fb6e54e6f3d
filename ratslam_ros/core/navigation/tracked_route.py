# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tracked route: a route, and where the robot is on it."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.route_planner import Route

PASSED = 4
"""Links behind the robot that its shortcuts are looked for in, too."""

NEXT_LINKS = 10
"""Of a route, so many links say which wall to follow."""

SAG = 0.5
"""Where experiences were pruned one link stands for the way past them, which was not straight: so
far from it, in shares of its length, the robot is still on its route."""


class TrackedRoute:
    """A route, and how far the robot has come on it.

    It leads over the experiences to the place of the goal itself, which lies beside the last one;
    this last piece counts for no time. All but that place is looked up on the map, which changes.
    """

    def __init__(self, route: Route, experience_map: ExperienceMap) -> None:
        self.ids = np.array(route.experience_ids)
        ends, count = experience_map.link_ends, len(experience_map)
        self._links = np.asarray(_are_linked(ends, self.ids, count))
        """(n - 1,) whether a link leads on from each; where none does, places are joined."""
        arrival_s = np.array(route.arrival_s)
        self._to_goal_s = np.append(arrival_s[-1] - arrival_s, 0.0)
        self._at, self._share = 0, 0.0
        self.away_m = 0.0
        """From the robot to its place on the route."""
        self.sag_m = 0.0
        """How far the way that the present link stands for may lie from it."""
        self.is_at_end = False
        """Whether nothing of the route is left."""

    @property
    def remaining_s(self) -> float:
        """Time from the robot's place to the goal."""
        before_s, after_s = self._to_goal_s[self._at : self._at + 2].tolist()
        return float(before_s + self._share * (after_s - before_s))

    def advance(self, poses: NDArray[np.float64], goal: Pose, here: Pose, window_m: float) -> None:
        """Take the place nearest to the robot, from the present one to so far ahead."""
        points = self._points(poses, goal)
        self._at, self._share, self.away_m = _nearest_ahead(
            points, self._at, self._share, here.x_m, here.y_m, window_m
        )
        self.sag_m = SAG * math.dist(*points[self._at : self._at + 2].tolist())
        self.is_at_end = self._share == 1.0 or not np.diff(points[self._at :], axis=0).any()

    def wait(self, duration_s: float) -> None:
        """Take the place where the robot should be after some time."""
        remaining_s = max(self.remaining_s - duration_s, 0.0)
        # Times to the goal fall; of those that are equal the last is meant.
        at = int(np.count_nonzero(self._to_goal_s >= remaining_s)) - 1
        if at >= len(self.ids):
            self._at, self._share, self.is_at_end = len(self.ids) - 1, 1.0, True
        else:
            before_s, after_s = self._to_goal_s[at : at + 2].tolist()
            self._at, self._share = at, (before_s - remaining_s) / (before_s - after_s)

    def ahead(
        self, poses: NDArray[np.float64], goal: Pose
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (n, 2) positions from the robot's place to the goal, and (n,) s until there."""
        positions_m = self._points(poses, goal)[self._at :]
        positions_m[0] += self._share * (positions_m[1] - positions_m[0])
        arrival_s = self.remaining_s - self._to_goal_s[self._at :]
        arrival_s[0] = 0.0
        count = len(arrival_s)
        if (positions_m[-1] == positions_m[-2]).all():  # the goal is at its experience
            count -= 1
        return positions_m[:count], arrival_s[:count]

    def holds(self, experience_map: ExperienceMap) -> bool:
        """Return whether all links from the robot's place on are still there."""
        ends, count = experience_map.link_ends, len(experience_map)
        if self.ids.max() >= count:
            return False
        still = np.asarray(_are_linked(ends, self.ids[self._at :], count))
        return bool(np.all(still | ~self._links[self._at :]))

    def shortcut_ends_ahead(self, poses: NDArray[np.float64], length_m: float) -> list[int]:
        """Return the experiences that no link leads to or on from, so far along the route.

        Also from those that the robot believes to have passed.
        """
        first = max(self._at - PASSED, 0)
        steps_m = np.hypot(*np.diff(poses[self.ids[first:], :2], axis=0).T)
        steps_m[: self._at - first] = 0.0
        count = int(np.count_nonzero(np.cumsum(steps_m) - steps_m <= length_m))
        joins = np.flatnonzero(~self._links[first : first + count]) + first
        return [int(self.ids[at]) for join in joins.tolist() for at in (join, join + 1)]

    def behaviour(self, experience_map: ExperienceMap) -> str:
        """Return the wall that most of the next links were made along, '' for neither."""
        ids = self.ids[self._at : self._at + NEXT_LINKS + 1].tolist()
        made = [experience_map.behaviour_between(a, b) for a, b in pairwise(ids)]
        left, right = made.count('left_wall'), made.count('right_wall')
        return '' if left == right else 'left_wall' if left > right else 'right_wall'

    def needs(self, experience_id: int) -> bool:
        """Return whether the route leads over an experience from here on."""
        return bool((self.ids[self._at :] == experience_id).any())

    def ends_as(self, other: TrackedRoute) -> bool:
        """Return whether another route is this one, or its end."""
        return np.array_equal(self.ids[-len(other.ids) :], other.ids)

    def is_met_by(self, other: TrackedRoute, visited: set[int]) -> bool:
        """Return whether another one comes to this one over visited experiences."""
        first = next((i for i in other.ids.tolist() if i not in visited), None)
        return first is not None and bool((self.ids == first).any())

    def _points(self, poses: NDArray[np.float64], goal: Pose) -> NDArray[np.float64]:
        points = np.empty((len(self.ids) + 1, 2))
        points[:-1] = poses[self.ids, :2]
        points[-1] = goal[:2]
        return points


@compiled
def _nearest_ahead(
    points: NDArray[np.float64], at: int, share: float, x: float, y: float, window: float
) -> tuple[int, float, float]:
    """Return the nearest place on a way: its piece, the share of the piece, and how far it is.

    Looked for from the given place on, over a length; of places as near the first is taken.
    """
    best_at, best_share, best = at, share, math.inf
    behind = share
    gone = 0.0
    for piece in range(at, len(points) - 1):
        d_x = points[piece + 1, 0] - points[piece, 0]
        d_y = points[piece + 1, 1] - points[piece, 1]
        squared = d_x * d_x + d_y * d_y
        most = 1.0
        length = math.sqrt(squared)
        if gone + (1.0 - behind) * length > window:
            most = behind + (window - gone) / length
        along = behind
        if squared > 0.0:
            along = ((x - points[piece, 0]) * d_x + (y - points[piece, 1]) * d_y) / squared
        along = min(max(along, behind), most)
        e_x = points[piece, 0] + along * d_x - x
        e_y = points[piece, 1] + along * d_y - y
        away = math.sqrt(e_x * e_x + e_y * e_y)
        if away < best:
            best_at, best_share, best = piece, along, away
        gone += (1.0 - behind) * length
        if gone >= window:
            break
        behind = 0.0
    if best_share >= 1.0 and best_at < len(points) - 2:
        return best_at + 1, 0.0, best
    return best_at, best_share, best


@compiled
def _are_linked(
    ends: NDArray[np.int64], ids: NDArray[np.int64], count: int
) -> NDArray[np.bool_]:
    """Return (n - 1,) whether each of some experiences is linked with the next one, either way.

    ``ids``: each at most once; ``count``: experiences on the map.
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
