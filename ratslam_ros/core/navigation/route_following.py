# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Route following: experience map, goal -> the route to be on now, kept where none is found."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config.goal_recall import GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Goal
from ratslam_ros.core.navigation.route_planner import (
    GoalTree,
    Route,
    RoutePlanner,
)
from ratslam_ros.errors import UnreachableGoal

Status = Literal[
    'idle', 'following', 'recovering', 'lost', 'succeeded', 'failed', 'timed_out', 'cancelled'
]

PASSING = 1.2
"""Times the radius of a goal: reached within this where the robot has come to the route's end."""

ARRIVED_M, LEAVING_M, LINGER_S = 0.04, 0.05, 4.0
"""Within the radius the robot goes on until it is this close to the goal, has this much further
to go again, or has been there for so long."""

STUCK_S, STUCK_M, PAUSE_S = 25.0, 2.5, 5.0
"""A robot that has stayed within a square of this width for this long gets nowhere, unless nothing
was asked of it for a while."""

JOINS_M, PASSED, BESIDE_M = 2.0, 4, 1.0
"""Joins so far ahead of a robot that gets nowhere are given up, those of the last links, and those
of all places so far around it."""

LONGEST_STEP_M = 0.2
"""Of a step between two updates, so much may have been driven; the rest is the map that moved."""

NEXT_LINKS = 10
"""Of a route, so many links say which wall to follow."""

SAG = 0.5
"""Where experiences were pruned one link stands for the way past them, which was not straight: so
far from it, in shares of its length, the robot is still on its route."""

STRAY_M = 4.0
"""How far a robot explores where it stood."""

WINDOW = 2.0
"""Times the width of a route: so far ahead the robot's position on it is looked for."""


@dataclass(frozen=True, eq=False)
class Guidance:
    """Where to go now.

    ``status``: ``following`` the route that the map has now; ``recovering``: the last good one, as
    there is none or only a longer one; ``lost``: there is none; ``idle``: there is no goal; else
    how the last goal ended. ``positions_m``: (n, 2) the route on the map, from the robot's place
    on it to the goal; ``arrival_s``: (n,) when the robot should be where, from now. Both are empty
    and ``remaining_s`` infinite where there is no route. ``waypoint``: a pose some way ahead,
    heading along the route. ``explore``: the robot should look for a way by exploring.
    ``behaviour``: the one that most of the next links were made by, '' for none. ``unknown_m``:
    how far the robot has come since a place that it knew. ``replanned``: routes taken for this
    goal; ``switched``: those of them that were other ways.
    """

    status: Status
    positions_m: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    arrival_s: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    remaining_s: float = math.inf
    waypoint: Pose | None = None
    goal: Pose | None = None
    explore: bool = False
    unknown_m: float = 0.0
    behaviour: str = ''
    replanned: int = 0
    switched: int = 0


class RouteFollowing:
    """Follows routes to one goal over a map that changes while the robot drives on it.

    Seed 000 section IV.D and seed 002: the route is found anew whenever the robot comes to
    another experience or links change. A shorter one is taken at once, a longer one once nothing
    else was found for ``route_switch_s``. Where there is none the last good one is kept for
    ``route_keep_s``. A way back over the experiences that the robot has come by since, to the
    very route that it is on, is not another route: where views are not recognised a new layer of
    experiences grows beside the old one, and every way over its links leads back to where it
    began.

    The robot's place on its route is the one nearest to it on the map, never further back than
    before. The paper lets it advance by the time that passes; that runs ahead of a robot that
    waits until somebody has gone by, and here odometry says how far it has come. Time is used
    where that is not known.

    A kept route is dropped at once where the robot is further than ``route_width_m`` from it, and
    where a link of it, ahead of the robot, is unlearned.
    """

    def __init__(self, recall: RoutePlanner, experience_map: ExperienceMap, goal: Goal) -> None:
        """Set out for a goal.

        Args:
            recall: finds the ways; its parameters may be replaced at any time.
            experience_map: the map, also of every update.
            goal: where to go.
        """
        self.goal = goal
        self._recall = recall
        self._map = experience_map
        self._tree: GoalTree | None = None
        self._seen: tuple[int, int, int, int] | None = None
        self._kept: TrackedRoute | None = None
        self._found: TrackedRoute | None = None
        self._taken: TrackedRoute | None = None
        self._visited: set[int] = set()
        """Experiences that the robot was at since its route was last the one that was found."""
        self._confirmed_ns = self._updated_ns = 0
        self._last: Pose | None = None
        self._unknown_m = self._stray_m = 0.0
        self._known_m = 0.0
        """How far the robot had come when it last was at an experience that it knew."""
        self._scan_confirmed_m = 0.0
        self._longer_since_ns: int | None = None
        self._near: tuple[float, int] | None = None
        """The closest that the robot has come to the goal since it was within its radius, and
        since when it is."""
        self._trail: deque[tuple[int, float, float]] = deque()
        self._replanned = self._switched = 0

    def update(self, stamp_ns: int, pose: Pose | None = None, located: bool = True) -> Guidance:
        """Return where to go.

        Args:
            stamp_ns: of now; the stamps of updates never fall.
            pose: the robot on the map, None: as the map has it.
            located: whether the motion since the current experience is known; else the place on
                the route advances with the time.
        """
        here = self._map.pose if pose is None else pose
        goal = self.goal.pose_on(self._map)
        poses = self._map.poses
        self._look()
        self._recognise(here)
        if not located:
            if self._kept is not None:
                self._kept.wait((stamp_ns - self._updated_ns) * 1e-9)
        else:
            for route in (self._found, self._kept):
                if route is not None:
                    route.advance(poses, goal, here, WINDOW * self._p.route_width_m)
            sure = not 0.0 < self._p.goal_sure_m < self._unknown_m
            if self._is_reached(goal, here, stamp_ns) and sure:
                return self._told('succeeded', goal, remaining_s=0.0)
            if self._gets_nowhere(stamp_ns, here) and self.report_blocked():
                self.start_recovery()
            if self._stray_m > 0.0 or 0.0 < self._p.route_unknown_m < self._unknown_m:
                self._updated_ns, self._kept = stamp_ns, None
                return self._told('lost', goal, explore=True)
            kept = self._kept
            if kept is not None and kept.away_m > max(self._p.route_width_m, kept.sag_m):
                self._kept = None
        self._updated_ns = stamp_ns
        confirmed = self._choose(stamp_ns)
        way = self._kept
        if way is None:
            return self._told('lost', goal, explore=True)
        positions_m, arrival_s = way.ahead(poses, goal)
        waypoint = point_ahead(positions_m, self._p.waypoint_ahead_m, here.heading_rad)
        return self._told(
            'following' if confirmed else 'recovering', goal, positions_m=positions_m,
            arrival_s=arrival_s, remaining_s=way.remaining_s, waypoint=waypoint,
            behaviour=way.behaviour(self._map),
        )  # fmt: skip

    def start_recovery(self) -> None:
        """Explore for some way: the robot stands where its route does not lead on, nor is closed.

        It is not where it believes to be, and while it stands nothing would tell it so.
        """
        self._kept, self._stray_m = None, STRAY_M

    def report_blocked(self) -> bool:
        """Take note that a try led nowhere; return whether nothing was joined there.

        Where the route goes on over places that are only close together on the map, there is no
        way from one to the other.
        """
        self._trail.clear()  # what is tried is counted by whoever tries
        way = self._kept
        joined = [] if way is None else way.joined_ahead(self._map.poses, JOINS_M)
        if not joined:
            return True
        # Others beside them would only lead to the same closed place again.
        x_m, y_m, _ = self._map.pose
        poses = self._map.poses
        beside = np.hypot(poses[:, 0] - x_m, poses[:, 1] - y_m) < BESIDE_M
        self._recall.part(self._map, [*joined, *np.flatnonzero(beside).tolist()])
        self._kept = self._seen = None
        return False

    def _gets_nowhere(self, stamp_ns: int, here: Pose) -> bool:
        """Return whether the robot has driven or turned to and fro in one place for long."""
        trail = self._trail
        if trail and stamp_ns - trail[-1][0] > PAUSE_S * 1e9:
            trail.clear()  # nobody asked where to go for a while
        if not trail or stamp_ns - trail[-1][0] >= 1e9:
            trail.append((stamp_ns, here.x_m, here.y_m))
        if stamp_ns - trail[0][0] < STUCK_S * 1e9:
            return False
        places = np.array(trail)[:, 1:]
        trail.popleft()
        if (np.ptp(places, axis=0) > STUCK_M).any():
            return False
        trail.clear()
        return True

    def forgotten(self, experience_id: int, stand_in_id: int, pose_in_stand_in: Pose) -> None:
        """Go on where an experience is forgotten; see ``Goal.without``."""
        self.goal = self.goal.without(experience_id, stand_in_id, pose_in_stand_in)
        self._seen = None
        if self._kept is not None and self._kept.needs(experience_id):
            self._kept = None

    @property
    def _p(self) -> GoalRecallParameters:
        return self._recall.parameters

    def _look(self) -> None:
        """Find the route from the current experience, where something has changed."""
        graph = self._map
        rejected_shortcuts = self._recall.rejected_shortcuts(graph)
        seen = graph.current_id, graph.links_version, len(graph), rejected_shortcuts
        if seen == self._seen:
            return
        relinked = self._seen is None or seen[1] != self._seen[1]
        kept = self._kept
        if relinked and kept is not None and not kept.holds(graph):
            self._kept = None
        self._seen = seen
        self._visited.add(graph.current_id)
        goal_id, tree = self.goal.experience_id, self._tree
        try:
            if tree is None or tree.goal_id != goal_id:
                tree = self._tree = GoalTree(self._recall, graph, goal_id)
            self._found = TrackedRoute(tree.route(), graph)
        except UnreachableGoal:
            self._found = None

    def _recognise(self, here: Pose) -> None:
        """Add up how far the robot has come from where it had been before it lost its way."""
        graph = self._map
        fit = graph.scan_confirmed_m > self._scan_confirmed_m
        if self._last is None or fit or graph.made_m(graph.current_id) <= self._known_m:
            self._unknown_m, self._known_m = 0.0, graph.odometer_m
            self._scan_confirmed_m = graph.scan_confirmed_m
        if self._last is not None:
            step_m = math.hypot(here.x_m - self._last.x_m, here.y_m - self._last.y_m)
            self._unknown_m += min(step_m, LONGEST_STEP_M)
            self._stray_m -= min(step_m, LONGEST_STEP_M)
        self._last = here

    def _choose(self, stamp_ns: int) -> bool:
        """Take the found route or keep the last one; return whether the one taken is found."""
        found, kept = self._found, self._kept
        if kept is not None and found is not None and kept.ends_as(found):
            found = kept
        elif kept is not None:
            kept_s = (stamp_ns - self._confirmed_ns) * 1e-9
            if kept.is_at_end or kept_s >= self._p.route_keep_s:
                kept = self._kept = None
        if found is None:
            return False
        if found is not kept:
            if kept is not None and not self._is_better(found, kept, stamp_ns):
                return False
            self._switched += kept is not None
            self._replanned += self._taken is None or not self._taken.ends_as(found)
            self._kept = self._taken = found
        self._confirmed_ns, self._longer_since_ns = stamp_ns, None
        self._visited.clear()
        return True

    def _is_better(self, found: TrackedRoute, kept: TrackedRoute, stamp_ns: int) -> bool:
        """Return whether to leave the kept route for the found one."""
        if found.remaining_s <= kept.remaining_s:
            return True
        if kept.is_met_by(found, self._visited):
            self._longer_since_ns = None
            return False
        if self._longer_since_ns is None:
            self._longer_since_ns = stamp_ns
        return stamp_ns - self._longer_since_ns >= self._p.route_switch_s * 1e9

    def _is_reached(self, goal: Pose, here: Pose, stamp_ns: int) -> bool:
        """Return whether the robot is as close to the goal as it will come.

        At the edge of the radius it would always stop short of it.
        """
        away_m = math.hypot(goal.x_m - here.x_m, goal.y_m - here.y_m)
        if self._kept is not None and self._kept.is_at_end:
            return away_m <= self._p.goal_radius_m * PASSING
        if away_m > self._p.goal_radius_m:
            gone = self._near is not None and away_m <= self._p.goal_radius_m * PASSING
            self._near = self._near if gone else None
            return gone
        closest_m, since_ns = self._near or (away_m, stamp_ns)
        self._near = min(closest_m, away_m), since_ns
        leaves = away_m > closest_m + LEAVING_M
        return away_m < ARRIVED_M or leaves or stamp_ns - since_ns > LINGER_S * 1e9

    def _told(self, status: Status, goal: Pose, **told: Any) -> Guidance:
        return Guidance(
            status, goal=goal, replanned=self._replanned, switched=self._switched,
            unknown_m=self._unknown_m, **told
        )


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

    def joined_ahead(self, poses: NDArray[np.float64], length_m: float) -> list[int]:
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


def point_ahead(positions_m: NDArray[np.float64], ahead_m: float, heading_rad: float) -> Pose:
    """Return the point of a way so far from its beginning, or its end, heading along it.

    ``positions_m``: (n, 2), at least one; ``heading_rad``: where the way has no length.
    """
    steps_m = np.diff(positions_m, axis=0)
    lengths_m = np.hypot(steps_m[:, 0], steps_m[:, 1])
    x_m, y_m = positions_m[-1].tolist()
    pieces = np.flatnonzero(lengths_m)
    if len(pieces) == 0:
        return Pose(x_m, y_m, heading_rad)
    reached_m = np.cumsum(lengths_m[pieces])
    piece = min(int(np.searchsorted(reached_m, ahead_m)), len(pieces) - 1)
    d_x, d_y = (steps_m[pieces[piece]] / lengths_m[pieces[piece]]).tolist()
    back_m = max(float(reached_m[piece]) - ahead_m, 0.0)
    x_m, y_m = positions_m[pieces[piece] + 1].tolist()
    return Pose(x_m - back_m * d_x, y_m - back_m * d_y, math.atan2(d_y, d_x))


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
