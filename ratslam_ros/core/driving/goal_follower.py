# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal follower: scan, route -> Command; of the ways on, the one closest to the route."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.detour import plan_detour
from ratslam_ros.core.driving.free_directions import (
    WALLS,
    Behaviour,
    DirectionCandidate,
    LocalMovement,
)
from ratslam_ros.core.driving.steering import Command, drive, turn

SAMPLES = 8
"""Points of a way on that are compared with the route."""

NEAR = 3
"""Of these, the one that says where the route begins to lead."""

PASSED_M = 2.0
"""Of a route, the beginning that the robot may have driven since it came: of two parts that lie
beside each other the one further on is not taken for this one."""

WALL_M = 0.3
"""So much better a way along a wall counts than another one: it leads where the robot drove when
it learned the route, and what it sees there it knows. By the map alone it would drive beside."""

LEARNED_M = 0.6
"""And the way along the wall that it followed then."""

STEADY_M = 0.1
"""So much worse, for a radian, a way round something counts in another direction than the last."""

LEAST_M = 0.3
"""Ways on are compared over this length at least."""

LAST_M = 0.8
"""So far from its end a route is followed for itself."""

WALL_RAD = math.radians(50.0)
"""A wall leads along the route where it leads no further aside than this."""

BEHIND_RAD = math.radians(95.0)
"""What lies further behind than this is turned to on the spot."""

GAIN_M = 0.1
"""A way on must lead so much nearer to where the route leads."""

MOVED_M = 0.1
"""A robot on a way round that has come so far has not tried in vain."""

FACING_RAD = math.radians(25.0)
"""Turning ends when the route is this close to straight ahead."""


class GoalFollower:
    """Behaviour arbitration (seed 000, section IV.C), and what keeps the robot from harm."""

    def __init__(self, parameters: GoalFollowerParameters) -> None:
        self._p = parameters
        self._turning = False
        self._tried_since_ns: int | None = None
        self._tried_m = 0.0
        self._last_rad = 0.0
        self._last: tuple[int, Command] | None = None

    def command(self, scan: Scan, route: NDArray[np.float64], behaviour: str = '') -> Command:
        """Choose a way on and return how to take it.

        ``route``: (n, 2) m, in the robot's frame, from the robot's place on it to the goal.
        ``behaviour``: the one that the route was learned with, '' where that is not known.
        """
        p = self._p
        self._account(scan.stamp_ns)
        movement = LocalMovement(p, scan)
        ahead = _ahead(route, p.route_ahead_m)
        most_mps = _approach_mps(route, p)
        command = None
        if behaviour in WALLS and ahead[-1, 2] > LAST_M:
            command = self._repeat(movement, ahead, behaviour, most_mps)
        if command is None:
            command = self._choose(scan.stamp_ns, movement, route, ahead, behaviour, most_mps)
        else:
            self._tried_since_ns = None
        self._last = scan.stamp_ns, command
        return command

    def _account(self, stamp_ns: int) -> None:
        """Take that the last command was done: the robot has moved, what it had chosen has not."""
        then_ns, last = self._last or (stamp_ns, None)
        duration_s = (stamp_ns - then_ns) * 1e-9
        if last is None or not 0.0 <= duration_s <= self._p.scan_timeout_s:
            self._last_rad, self._tried_since_ns = 0.0, None  # nobody asked for a while
            return
        self._last_rad = wrap(self._last_rad - last.turn_rate_radps * duration_s)
        self._tried_m += last.speed_mps * duration_s

    def _choose(
        self, stamp_ns: int, movement: LocalMovement, route: NDArray[np.float64],
        ahead: NDArray[np.float64], behaviour: str, most_mps: float,
    ) -> Command:  # fmt: skip
        """Take the way on that is closest to the route."""
        p = self._p
        bearing_rad = math.atan2(float(ahead[-1, 1]), float(ahead[-1, 0]))
        if abs(bearing_rad) > (FACING_RAD if self._turning else BEHIND_RAD):
            self._turning, self._tried_since_ns = True, None
            return turn(bearing_rad, p)
        self._turning = False
        stop_m = p.stop_distance_m
        options = [o for o in [*movement.fan(), *movement.options()] if _nearer(o, ahead, stop_m)]
        if not options:  # between the posts of a door little is open until the robot is through
            narrow = [o for o in movement.narrow() if _is_about(o, bearing_rad)]
            options = [o for o in narrow if _nearer(o, ahead, stop_m)]
        best = min(
            options, key=lambda option: self._rank_m(option, ahead, behaviour), default=None
        )
        wanted_m = min(p.wall_look_ahead_m, max(float(ahead[-1, 2]), LEAST_M))
        if best is None or best.open_m < wanted_m:  # something stands there: it is gone round
            around = plan_detour(movement, route, p, self._last_rad)
            if around is not None:
                return self._go_round(stamp_ns, drive(movement, around, p, most_mps))
            best = min(
                [o for o in options if o.open_m >= wanted_m] or options,
                key=lambda o: _cost_m(o, ahead) + STEADY_M * abs(o.heading_rad - self._last_rad),
                default=None,
            )
        if best is None:
            return self._blocked(stamp_ns, bearing_rad)
        self._tried_since_ns = None
        self._last_rad = best.heading_rad
        return drive(movement, best, p, most_mps)

    def _go_round(self, stamp_ns: int, command: Command) -> Command:
        """Take a way round; where the robot only turns to and fro there is none."""
        self._last_rad = command.ahead_rad
        failed = self._has_failed(stamp_ns)
        if self._tried_m > MOVED_M:
            self._tried_since_ns = None
        return replace(command, failed=failed)

    def _repeat(
        self, movement: LocalMovement, ahead: NDArray[np.float64], behaviour: str, most_mps: float
    ) -> Command | None:
        """Follow the wall that the route was learned along; None where that leads elsewhere.

        What counts is how the route runs, not where it lies: the wall says that better.
        """
        runs_rad = _runs_rad(ahead)
        if abs(runs_rad) > (FACING_RAD if self._turning else BEHIND_RAD):
            self._turning = True
            return turn(runs_rad, self._p)
        self._turning = False
        side: Behaviour = 'left_wall' if behaviour == 'left_wall' else 'right_wall'
        option = movement.wall(side, runs_rad, WALL_RAD)
        if option is None:
            return None
        return drive(movement, option, self._p, most_mps)

    def _rank_m(
        self, option: DirectionCandidate, ahead: NDArray[np.float64], behaviour: str
    ) -> float:
        """Return how far from the route a way on counts to be; the least is taken."""
        rank_m = _cost_m(option, ahead)
        if option.behaviour not in WALLS or abs(option.heading_rad - _runs_rad(ahead)) > WALL_RAD:
            return rank_m
        return rank_m - (LEARNED_M if option.behaviour == behaviour else WALL_M)

    def _blocked(self, stamp_ns: int, bearing_rad: float) -> Command:
        """Face the route and wait: people go away, closed doors do not."""
        failed = self._has_failed(stamp_ns)
        return Command(
            0.0, 0.5 * bearing_rad * self._p.turn_rate_radps, 'centreline', failed, bearing_rad
        )

    def _has_failed(self, stamp_ns: int) -> bool:
        """Return whether what is tried has led nowhere for long; then the next try begins."""
        if self._tried_since_ns is None:
            self._tried_since_ns, self._tried_m = stamp_ns, 0.0
        failed = stamp_ns - self._tried_since_ns >= self._p.try_timeout_s * 1e9
        if failed:
            self._tried_since_ns, self._tried_m = stamp_ns, 0.0
        return failed


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


def _is_about(option: DirectionCandidate, bearing_rad: float) -> bool:
    """Return whether a way on leads in about a direction; beside the door little is open too."""
    return abs(wrap(option.heading_rad - bearing_rad)) <= WALL_RAD


def _nearer(option: DirectionCandidate, ahead: NDArray[np.float64], stop_m: float) -> bool:
    """Return whether a way on comes nearer to where the route leads, and the robot may go there.

    ``stop_m``: the gap that must stay to what ends it.
    """
    x, y, _ = ahead[-1].tolist()
    away_m = math.hypot(x, y)
    aside_rad = option.heading_rad - math.atan2(y, x)
    reach_m = min(max(option.open_m - stop_m, 0.0), away_m * max(math.cos(aside_rad), 0.0))
    to_x, to_y = reach_m * math.cos(option.heading_rad), reach_m * math.sin(option.heading_rad)
    return math.hypot(x - to_x, y - to_y) < away_m - min(GAIN_M, away_m / 2)


def _runs_rad(ahead: NDArray[np.float64]) -> float:
    """Return the direction in which a route begins to run."""
    x, y, _ = (ahead[NEAR] - ahead[0]).tolist()
    return math.atan2(y, x)


def _cost_m(option: DirectionCandidate, ahead: NDArray[np.float64]) -> float:
    """Return how far a way on is from the route on average, and what it leaves of it."""
    wanted_m = max(float(ahead[-1, 2]), LEAST_M)
    reach_m = min(option.open_m, wanted_m)
    s = np.linspace(0.0, reach_m, SAMPLES + 1)[1:]
    x = s[:, None] * math.cos(option.heading_rad) - ahead[:, 0]
    y = s[:, None] * math.sin(option.heading_rad) - ahead[:, 1]
    away_m = np.hypot(x, y)
    return float(away_m.min(axis=1).mean() + 0.5 * away_m[:, -1].min())


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
