# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal follower: scan, route -> Command; of the ways on, the one closest to the route."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.angles import wrap
from ratslam_ros.core.local_movement import WALLS, Behaviour, LocalMovement, Option, Scan
from ratslam_ros.core.movement_config import GoalFollowerParameters
from ratslam_ros.core.odometry import Pose
from ratslam_ros.core.steering import Command, drive, turn
from ratslam_ros.core.wall_following import WallFollowing

SAMPLES = 8
"""Points of a way on that are compared with the route."""

NEAR = 3
"""Of these, the one that says where the route begins to lead."""

ASIDE_RAD = math.radians(60.0)
"""A route that begins further than this to the side is turned to on the spot."""

PASSED_M = 2.0
"""Of a route, the beginning that the robot may have driven since it came: of two parts that lie
beside each other the one further on is not taken for this one."""

ALONG_RAD = math.radians(80.0)
"""A way on that leads further than this away from the route is none of its."""

WALL_M = 0.3
"""So much better a way along a wall counts than another one: it leads where the robot drove when
it learned the route, and what it sees there it knows. By the map alone it would drive beside."""

LEARNED_M = 0.6
"""And the way along the wall that it followed then."""

STEADY_M = 0.1
"""So much worse, for a radian, a way on in another direction than the last one counts."""

LEAST_M = 0.3
"""Ways on are compared over this length at least."""

FACING_RAD = math.radians(25.0)
"""Turning ends when the route is this close to straight ahead."""


class GoalFollower:
    """Behaviour arbitration (seed 000, section IV.C), and what keeps the robot from harm."""

    def __init__(self, parameters: GoalFollowerParameters) -> None:
        self._p = parameters
        self._wall = WallFollowing(parameters)
        self._turning = False
        self._tried_since_ns: int | None = None
        self._last_rad = 0.0

    def __call__(self, scan: Scan, route: NDArray[np.float64], behaviour: str = '') -> Command:
        """Choose a way on and return how to take it.

        ``route``: (n, 2) m, in the robot's frame, from the robot's place on it to the goal.
        ``behaviour``: the one that the route was learned with, '' where that is not known.
        """
        p = self._p
        movement = LocalMovement(p, scan)
        ahead = _ahead(route, p.route_ahead_m)
        bearing_rad = math.atan2(float(ahead[-1, 1]), float(ahead[-1, 0]))
        along = self._along_wall(movement, ahead, behaviour)
        if along is not None and not self._turning:
            self._tried_since_ns, self._last_rad = None, along.heading_rad
            return drive(movement, along, p, most_mps=_approach_mps(route, p))
        if abs(bearing_rad) > (FACING_RAD if self._turning else ASIDE_RAD):
            self._turning, self._tried_since_ns = True, None
            return turn(bearing_rad, p)
        self._turning = False
        towards = [*movement.options(), movement.towards(bearing_rad)]
        wanted_m = min(p.wall_look_ahead_m, max(float(ahead[-1, 2]), LEAST_M))
        options = _leading(towards, bearing_rad, wanted_m)
        if not options:  # between the posts of a door little is open until the robot is through
            options = _leading(movement.narrow(), bearing_rad, LEAST_M)
        if not options:
            return self._blocked(scan.stamp_ns, bearing_rad)
        self._tried_since_ns = None
        best = min(options, key=lambda option: self._rank_m(option, ahead, behaviour))
        self._last_rad = best.heading_rad
        return drive(movement, best, p, most_mps=_approach_mps(route, p))

    def _along_wall(
        self, movement: LocalMovement, ahead: NDArray[np.float64], behaviour: str
    ) -> Option | None:
        """Return the way along the wall that the route was learned along, where it leads on."""
        if behaviour not in WALLS:
            return None
        side: Behaviour = 'left_wall' if behaviour == 'left_wall' else 'right_wall'
        option = self._wall.way_on(movement, side)
        if option is None:
            return None
        bearings_rad = [math.atan2(float(y), float(x)) for x, y, _ in (ahead[NEAR], ahead[-1])]
        away_rad = min(abs(wrap(option.heading_rad - bearing)) for bearing in bearings_rad)
        return option if away_rad < ALONG_RAD else None

    def _rank_m(self, option: Option, ahead: NDArray[np.float64], behaviour: str) -> float:
        """Return how far from the route a way on counts to be; the least is taken."""
        rank_m = _cost_m(option, ahead) + STEADY_M * abs(option.heading_rad - self._last_rad)
        if option.behaviour == behaviour:
            return rank_m - LEARNED_M
        walls = ('left_wall', 'right_wall')
        return rank_m - WALL_M if not behaviour and option.behaviour in walls else rank_m

    def _blocked(self, stamp_ns: int, bearing_rad: float) -> Command:
        """Face the route and wait: people go away, closed doors do not."""
        if self._tried_since_ns is None:
            self._tried_since_ns = stamp_ns
        failed = stamp_ns - self._tried_since_ns >= self._p.try_timeout_s * 1e9
        if failed:
            self._tried_since_ns = stamp_ns
        return Command(
            0.0, 0.5 * bearing_rad * self._p.turn_rate_radps, 'centreline', failed, bearing_rad
        )


def _approach_mps(route: NDArray[np.float64], p: GoalFollowerParameters) -> float:
    """Return the speed from which the robot can stop at the end of the route."""
    left_m = float(np.hypot(*np.diff(route, axis=0).T).sum()) + math.hypot(*route[0].tolist())
    return 0.1 + math.sqrt(2.0 * p.braking_mps2 * left_m)


def _ahead(route: NDArray[np.float64], length_m: float) -> NDArray[np.float64]:
    """Return (SAMPLES + 1, 3) x, y and way along the beginning of a route."""
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route, axis=0).T))])
    at_m = np.linspace(0.0, min(length_m, float(along_m[-1])), SAMPLES + 1)
    x, y = (np.interp(at_m, along_m, route[:, axis]) for axis in (0, 1))
    return np.stack([x, y, at_m], axis=1)


def _leading(options: list[Option], bearing_rad: float, open_m: float) -> list[Option]:
    """Return the ways on that lead along the route, and are open so far."""
    return [
        option
        for option in options
        if abs(wrap(option.heading_rad - bearing_rad)) < ALONG_RAD
        and abs(option.heading_rad) <= ASIDE_RAD
        and option.open_m >= open_m
    ]


def _cost_m(option: Option, ahead: NDArray[np.float64]) -> float:
    """Return how far a way on is from the route on average."""
    reach_m = min(option.open_m, max(float(ahead[-1, 2]), LEAST_M))
    s = np.linspace(0.0, reach_m, SAMPLES + 1)[1:]
    x = s[:, None] * math.cos(option.heading_rad) - ahead[:, 0]
    y = s[:, None] * math.sin(option.heading_rad) - ahead[:, 1]
    return float(np.hypot(x, y).min(axis=1).mean())


def seen_from(pose: Pose, positions_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, 2) positions on the map as the robot sees them: x ahead, y to the left."""
    c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    x, y = positions_m[:, 0] - pose.x_m, positions_m[:, 1] - pose.y_m
    return np.stack([c * x + s * y, c * y - s * x], axis=1)


def rest_of(route_m: NDArray[np.float64], x_m: float, y_m: float) -> NDArray[np.float64]:
    """Return what of a route, (n, 2) with n > 0, is left: from the place nearest to the robot on.

    Given what was left before, it never goes back.
    """
    steps_m = np.diff(route_m, axis=0)
    lengths_m = np.hypot(*steps_m.T)
    begins_m = np.cumsum(lengths_m) - lengths_m
    count = max(int(np.count_nonzero(begins_m < PASSED_M)), 1)
    if len(steps_m) == 0:
        return route_m
    starts, steps_m, lengths_m = route_m[:count], steps_m[:count], lengths_m[:count]
    along = ((np.array([x_m, y_m]) - starts) * steps_m).sum(axis=1)
    share = np.clip(along / np.maximum(lengths_m, 1e-9) ** 2, 0.0, 1.0)[:, None]
    nearest = starts + share * steps_m
    at = int(np.hypot(nearest[:, 0] - x_m, nearest[:, 1] - y_m).argmin())
    return np.concatenate([nearest[at : at + 1], route_m[at + 1 :]])
