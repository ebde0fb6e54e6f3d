# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal follower: a local planner that chooses the free direction closest to the route."""

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
    WALL_LOOK_AHEAD_M,
    WALLS,
    Behaviour,
    DirectionCandidate,
    LocalMovement,
)
from ratslam_ros.core.driving.steering import Command, drive, turn

SAMPLE_COUNT = 8
"""Number of points of a candidate that are compared with the route."""

DIRECTION_SAMPLE = 3
"""Index of the route sample that gives the initial direction of the route."""

MAX_PASSED_M = 2.0
"""Length of the route prefix the robot may already have driven since the message was sent, in m.
Limits confusion with later parts of the route that lie beside it."""

WALL_DISCOUNT_M = 0.3
"""Cost discount for directions that follow a wall along the route, in m. The robot learned its
routes along walls, so it recognises the views there better than away from the wall."""

LEARNED_WALL_DISCOUNT_M = 0.6
"""Cost discount for directions that follow the wall the route was learned along, in m."""

TURN_COST_M_PER_RAD = 0.1
"""Cost per rad of change of the direction round an obstacle: hysteresis, in m/rad."""

ROUTE_AHEAD_M = 1.2
"""Length of the route that candidates are compared with, in m. With less the robot oscillates
about the route, with more it cuts corners."""

TRY_TIMEOUT_S = 3.0
"""Time without a free direction along the route after which a try has failed, in s. People have
stepped aside by then."""

MIN_COMPARED_M = 0.3
"""Minimum length over which candidates are compared with the route, in m."""

DIRECT_APPROACH_M = 0.8
"""Length of the remaining route below which the learned wall is ignored, and directions are not
averaged, in m."""

MAX_WALL_DEVIATION_RAD = math.radians(50.0)
"""Maximum angle between a wall and the route that it leads along."""

TURN_START_RAD = math.radians(95.0)
"""Bearing of the route above which the robot turns on the spot."""

TURN_END_RAD = math.radians(25.0)
"""Bearing of the route at which a turn on the spot ends."""

MIN_GAIN_M = 0.1
"""Minimum decrease of the distance to the route's lookahead point by a candidate, in m."""

SWITCH_RAD = 0.2
"""Change of the direction from which on it is a switch to another one, in rad. Noise of the laser
moves the edges of free sectors by less: by up to three of the directions that are examined."""

SWITCH_S = 0.5
"""Time for which another direction must be chosen before the robot switches to it, in s, unless
the present one is blocked. Otherwise it oscillates between two directions of equal cost."""

MIN_DETOUR_M = 0.1
"""Distance driven on a detour from which it counts as progress, in m."""


class GoalFollower:
    """Behaviour arbitration after Milford et al. (2006), section IV.C, with obstacle avoidance."""

    def __init__(self, parameters: GoalFollowerParameters) -> None:
        self._p = parameters
        self._turning = False
        self._try_start_ns: int | None = None
        self._try_driven_m = 0.0
        self._last_rad = 0.0
        """The last direction, in the present frame of the robot."""
        self._switch_start_ns: int | None = None
        self._last: tuple[int, Command] | None = None

    def command(self, scan: Scan, route: NDArray[np.float64], behaviour: str = '') -> Command:
        """Choose a free direction and return the command for it.

        Args:
            scan: the current scan.
            route: (n, 2) route in the frame of the robot in m, from the robot to the goal.
            behaviour: wall that the route was learned along, '' for unknown.
        """
        p = self._p
        if p.path_choice == 'nearest':
            behaviour = ''
        self._account_for_motion(scan.stamp_ns)
        movement, ahead, command = LocalMovement(p, scan), _ahead(route), None
        if behaviour in WALLS and ahead[-1, 2] > DIRECT_APPROACH_M:
            command = self._follow_wall(movement, ahead, behaviour)
        if command is None:
            command = self._choose(movement, route, ahead, behaviour)
        else:
            self._try_start_ns = None
        speed_mps = min(command.speed_mps, _approach_speed_mps(route, p))
        command = replace(command, speed_mps=speed_mps)
        self._last = scan.stamp_ns, command
        return command

    def _account_for_motion(self, stamp_ns: int) -> None:
        """Update last heading and driven distance, assuming that the last command was executed."""
        last_ns, last = self._last or (stamp_ns, None)
        duration_s = (stamp_ns - last_ns) * 1e-9
        if last is None or not 0.0 <= duration_s <= self._p.scan_timeout_s:
            self._last_rad, self._try_start_ns, self._last = 0.0, None, None
            return
        self._last_rad = wrap(self._last_rad - last.turn_rate_radps * duration_s)
        self._try_driven_m += last.speed_mps * duration_s

    def _choose(
        self, movement: LocalMovement, route: NDArray[np.float64], ahead: NDArray[np.float64],
        behaviour: str,
    ) -> Command:
        """Return the command for the candidate of least cost, for a detour, or for waiting."""
        p, stamp_ns = self._p, movement.scan.stamp_ns
        bearing_rad = math.atan2(float(ahead[-1, 1]), float(ahead[-1, 0]))
        if abs(bearing_rad) > (TURN_END_RAD if self._turning else TURN_START_RAD):
            self._turning, self._try_start_ns = True, None
            return turn(bearing_rad, p)
        self._turning = False
        stop_m = p.stop_distance_m
        free = [*movement.straight_directions(), *movement.candidates()]
        candidates = [c for c in free if _gains(c, ahead, stop_m)]
        if not candidates:  # no direction is free with the full margin, as in a doorway
            candidates = [
                c for c in movement.narrow_passages()
                if abs(wrap(c.heading_rad - bearing_rad)) <= MAX_WALL_DEVIATION_RAD
                and _gains(c, ahead, stop_m)
            ]
        best = min(
            candidates, key=lambda c: self._discounted_cost_m(c, ahead, behaviour), default=None
        )
        wanted_m = min(WALL_LOOK_AHEAD_M, max(float(ahead[-1, 2]), MIN_COMPARED_M))
        if best is None or best.free_m < wanted_m:  # an obstacle is on the route
            detour = plan_detour(movement, route, p, self._last_rad)
            if detour is not None:
                return self._take_detour(stamp_ns, drive(movement, detour, p))
            best = min(
                [c for c in candidates if c.free_m >= wanted_m] or candidates,
                key=lambda c: (
                    _cost_m(c, ahead) + TURN_COST_M_PER_RAD * abs(c.heading_rad - self._last_rad)
                ),
                default=None,
            )
        if best is None:
            return self._wait(stamp_ns, bearing_rad)
        self._try_start_ns = None
        if ahead[-1, 2] > DIRECT_APPROACH_M:
            best = self._steadied(movement, best)
        self._last_rad = best.heading_rad
        return drive(movement, best, p)

    def _take_detour(self, stamp_ns: int, command: Command) -> Command:
        """Return the command of a detour. Turning without progress counts as a failed try."""
        self._last_rad = command.ahead_rad
        failed = self._has_failed(stamp_ns)
        if self._try_driven_m > MIN_DETOUR_M:
            self._try_start_ns = None
        return replace(command, failed=failed)

    def _follow_wall(
        self, movement: LocalMovement, ahead: NDArray[np.float64], behaviour: str
    ) -> Command | None:
        """Follow the wall that the route was learned along; None if the wall leads elsewhere.

        Only the direction of the route counts: the wall gives the more accurate position.
        """
        direction_rad = _direction_rad(ahead)
        if abs(direction_rad) > (TURN_END_RAD if self._turning else TURN_START_RAD):
            self._turning = True
            return turn(direction_rad, self._p)
        self._turning = False
        side: Behaviour = 'left_wall' if behaviour == 'left_wall' else 'right_wall'
        candidate = movement.along_wall(side, direction_rad, MAX_WALL_DEVIATION_RAD)
        if candidate is None:
            return None
        return drive(movement, self._steadied(movement, candidate), self._p)

    def _steadied(
        self, movement: LocalMovement, wanted: DirectionCandidate
    ) -> DirectionCandidate:
        """Return the direction to drive in: near the last one, unless another one persists.

        Small changes are averaged, so that noise of the laser does not reverse the turn.
        """
        steady, stamp_ns = wanted, movement.scan.stamp_ns
        change_rad = wanted.heading_rad - self._last_rad
        if self._last is not None and self._last[1].behaviour != 'turn':
            is_switch = abs(change_rad) > SWITCH_RAD
            if not is_switch or self._switch_start_ns is None:
                self._switch_start_ns = stamp_ns
            if stamp_ns - self._switch_start_ns < SWITCH_S * 1e9:
                heading_rad = self._last_rad + (0.0 if is_switch else 0.5 * change_rad)
                free_m = movement.free_m(heading_rad)
                if free_m >= min(wanted.free_m, WALL_LOOK_AHEAD_M):
                    steady = replace(wanted, heading_rad=heading_rad, free_m=free_m)
        if steady is wanted:
            self._switch_start_ns = None
        self._last_rad = steady.heading_rad
        return steady

    def _discounted_cost_m(
        self, candidate: DirectionCandidate, ahead: NDArray[np.float64], behaviour: str
    ) -> float:
        """Return the cost of a candidate with the discount for walls, in m."""
        cost_m = _cost_m(candidate, ahead)
        if (
            self._p.path_choice == 'nearest'
            or candidate.behaviour not in WALLS
            or abs(candidate.heading_rad - _direction_rad(ahead)) > MAX_WALL_DEVIATION_RAD
        ):
            return cost_m
        is_learned = candidate.behaviour == behaviour
        return cost_m - (LEARNED_WALL_DISCOUNT_M if is_learned else WALL_DISCOUNT_M)

    def _wait(self, stamp_ns: int, bearing_rad: float) -> Command:
        """Stop and face the route. People move out of the way, but closed doors do not."""
        failed = self._has_failed(stamp_ns)
        return Command(
            0.0, 0.5 * bearing_rad * self._p.turn_rate_radps, 'centreline', failed, bearing_rad
        )

    def _has_failed(self, stamp_ns: int) -> bool:
        """Return whether the current try has timed out, and begin the next try if so."""
        if self._try_start_ns is None:
            self._try_start_ns, self._try_driven_m = stamp_ns, 0.0
        failed = stamp_ns - self._try_start_ns >= TRY_TIMEOUT_S * 1e9
        if failed:
            self._try_start_ns, self._try_driven_m = stamp_ns, 0.0
        return failed


def _approach_speed_mps(route: NDArray[np.float64], p: GoalFollowerParameters) -> float:
    """Return the maximum speed from which the robot can stop at the end of the route."""
    left_m = float(np.hypot(*np.diff(route, axis=0).T).sum()) + math.hypot(*route[0].tolist())
    return 0.1 + math.sqrt(2.0 * p.braking_mps2 * left_m)


def _ahead(route: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return samples of the start of a route, (SAMPLE_COUNT + 1, 3) x, y and arc length."""
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route, axis=0).T))])
    at_m = np.linspace(0.0, min(ROUTE_AHEAD_M, float(along_m[-1])), SAMPLE_COUNT + 1)
    x, y = (np.interp(at_m, along_m, route[:, axis]) for axis in (0, 1))
    return np.stack([x, y, at_m], axis=1)


def _gains(candidate: DirectionCandidate, ahead: NDArray[np.float64], stop_m: float) -> bool:
    """Return whether a candidate can bring the robot closer to the route's lookahead point.

    ``stop_m``: gap to keep to the obstacle at the end of the candidate in m.
    """
    x, y, _ = ahead[-1].tolist()
    away_m = math.hypot(x, y)
    aside_rad = candidate.heading_rad - math.atan2(y, x)
    reach_m = min(max(candidate.free_m - stop_m, 0.0), away_m * max(math.cos(aside_rad), 0.0))
    to_x = reach_m * math.cos(candidate.heading_rad)
    to_y = reach_m * math.sin(candidate.heading_rad)
    return math.hypot(x - to_x, y - to_y) < away_m - min(MIN_GAIN_M, away_m / 2)


def _direction_rad(ahead: NDArray[np.float64]) -> float:
    """Return the initial direction of a route."""
    x, y, _ = (ahead[DIRECTION_SAMPLE] - ahead[0]).tolist()
    return math.atan2(y, x)


def _cost_m(candidate: DirectionCandidate, ahead: NDArray[np.float64]) -> float:
    """Return the mean distance to the route, plus half of the part that it does not reach."""
    wanted_m = max(float(ahead[-1, 2]), MIN_COMPARED_M)
    reach_m = min(candidate.free_m, wanted_m)
    s = np.linspace(0.0, reach_m, SAMPLE_COUNT + 1)[1:]
    x = s[:, None] * math.cos(candidate.heading_rad) - ahead[:, 0]
    y = s[:, None] * math.sin(candidate.heading_rad) - ahead[:, 1]
    away_m = np.hypot(x, y)
    return float(away_m.min(axis=1).mean() + 0.5 * away_m[:, -1].min())


def in_robot_frame(pose: Pose, positions_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, 2) positions on the map in the frame of the robot: x ahead, y to the left."""
    c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    x, y = positions_m[:, 0] - pose.x_m, positions_m[:, 1] - pose.y_m
    return np.stack([c * x + s * y, c * y - s * x], axis=1)


def remaining_route(
    route_m: NDArray[np.float64], x_m: float, y_m: float
) -> NDArray[np.float64]:
    """Return the part of a route ahead of the robot, from the nearest point on.

    Repeated calls on the result never move backwards along the route.

    Args:
        route_m: (n, 2) route in m, n > 0.
        x_m, y_m: position of the robot.
    """
    steps_m = np.diff(route_m, axis=0)
    lengths_m = np.hypot(*steps_m.T)
    starts_m = np.cumsum(lengths_m) - lengths_m
    count = max(int(np.count_nonzero(starts_m < MAX_PASSED_M)), 1)
    if len(steps_m) == 0:
        return route_m
    starts, steps_m, lengths_m = route_m[:count], steps_m[:count], lengths_m[:count]
    along = ((np.array([x_m, y_m]) - starts) * steps_m).sum(axis=1)
    fraction = np.clip(along / np.maximum(lengths_m, 1e-9) ** 2, 0.0, 1.0)[:, None]
    nearest = starts + fraction * steps_m
    segment = int(np.hypot(nearest[:, 0] - x_m, nearest[:, 1] - y_m).argmin())
    return np.concatenate([nearest[segment : segment + 1], route_m[segment + 1 :]])
