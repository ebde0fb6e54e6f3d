# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exploration: scan, odometry -> Command; left wall following and turning back to look."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.free_directions import (
    OPENING_RAD,
    Behaviour,
    DirectionCandidate,
    LocalMovement,
)
from ratslam_ros.core.driving.steering import Command, drive, turn

if TYPE_CHECKING:  # whoever makes an exploration brings its chance
    from numpy.random import Generator

Phase = Literal[
    'on', 'turn_back', 'back', 'turn_again', 'again', 'turn_off', 'off', 'turn_along'
]

_TURNS: dict[Phase, Phase] = {
    'turn_back': 'back', 'turn_again': 'again', 'turn_off': 'off', 'turn_along': 'on'
}  # fmt: skip

ARRIVED_RAD = math.radians(10.0)
"""A turn is done when so much is left."""

WALL_M = 0.4
"""A wall no further away than this beside where it is followed is one that can be followed."""

SEEK_AFTER_RAD = math.radians(300.0)
"""So much turned without a wall beside: there is none here. Go straight on to the next."""

ISLAND_RAD = math.radians(450.0)
"""So far round to the left in all: the wall is that of an island, as of a table. Leave it."""

INTO_M, INTO_WITHIN_RAD = 1.5, math.radians(50.0)
"""An opening that the robot turns into it drives into so far. From the middle of a corridor it
would else, as soon as it faces a door, see the corridor behind as the way on along its wall."""

STUCK_S = 15.0
"""A phase of the look back that takes longer is given up: somebody stands in the way."""


class Exploration:
    """Left wall following, interrupted by turning back to look (seed 001, section IV.D).

    Ours: now and then it goes on along the wall across, and then back along the same wall, as a
    camera that looks ahead knows a way only in the direction in which it was driven.
    """

    def __init__(self, parameters: GoalFollowerParameters, rng: Generator) -> None:
        """``rng``: draws when the robot changes walls, about ``change_wall_every_s`` apart."""
        self._p = parameters
        self._rng = rng
        self._side: Behaviour = 'left_wall'
        self._crossed = False
        self._change_ns: int | None = None
        self.restart()

    def _begin(self, stamp_ns: int, phase: Phase, target_rad: float = 0.0) -> None:
        if phase in ('turn_off', 'off', 'turn_along'):
            self._round_rad = 0.0
        self._phase, self._target_rad = phase, target_rad
        self._driven_m = self._turned_rad = self._into_until_m = self._into_rad = 0.0
        self._since_ns = stamp_ns

    def restart(self) -> None:
        """Begin with following the wall, after something else has moved the robot."""
        self._pose: Pose | None = None
        self._seeking = self._dead_end = False
        self._turn_without_wall = self._round_rad = 0.0
        self._begin(0, 'on')

    def command(self, scan: Scan, pose: Pose) -> Command:
        """Return how to move on.

        ``pose``: by odometry alone; only its changes count.
        """
        self._account(scan.stamp_ns, pose)
        if self._change_ns is None:
            self._change_ns = self._next_change(scan.stamp_ns)
        movement = LocalMovement(self._p, scan)
        self._phase_over(scan.stamp_ns, pose, movement)
        if self._phase in _TURNS:
            return turn(self._left_rad(pose), self._p)
        if self._phase == 'off':
            ahead = DirectionCandidate('centreline', 0.0, movement.open_m(0.0))
            return drive(movement, ahead, self._p)
        other: Behaviour = 'right_wall' if self._side == 'left_wall' else 'left_wall'
        side = other if self._phase == 'back' else self._side
        return self._along_wall(movement, side, pose.heading_rad)

    def _phase_over(self, stamp_ns: int, pose: Pose, movement: LocalMovement) -> None:
        """Go over to the next phase where the present one is done."""
        p = self._p
        stuck = stamp_ns - self._since_ns > STUCK_S * 1e9
        back = self._driven_m >= p.look_back_m or stuck
        if self._phase == 'on':
            turned = abs(self._turned_rad) >= math.radians(p.look_back_turn_deg)
            sign = 1.0 if self._side == 'left_wall' else -1.0
            if sign * self._round_rad > ISLAND_RAD:
                self._begin(stamp_ns, 'turn_off', pose.heading_rad - sign * math.pi / 2)
            elif self._driven_m >= p.look_back_every_m * (0.5 if turned else 1.0):
                self._begin(stamp_ns, 'turn_back', pose.heading_rad + math.pi)
        elif self._phase in _TURNS:
            if abs(self._left_rad(pose)) < ARRIVED_RAD or stuck:
                following = _TURNS[self._phase]
                assert self._change_ns is not None
                if following == 'back' and stamp_ns >= self._change_ns:
                    following = 'on'
                    self._change(stamp_ns)
                self._begin(stamp_ns, following)
        elif self._phase == 'back' and back:
            self._begin(stamp_ns, 'turn_again', pose.heading_rad + math.pi)
        elif self._phase == 'again':
            if back:
                self._begin(stamp_ns, 'on')
        elif movement.open_m(0.0) < p.wall_look_ahead_m or stuck:
            # The other way it would have the island beside it again.
            sign = 1.0 if self._side == 'left_wall' else -1.0
            self._begin(stamp_ns, 'turn_along', pose.heading_rad - sign * math.pi / 2)

    def _change(self, stamp_ns: int) -> None:
        """Go on along the wall across, and the next time back along the same wall."""
        self._round_rad = 0.0
        self._crossed = not self._crossed
        if not self._crossed:
            self._side = 'right_wall' if self._side == 'left_wall' else 'left_wall'
        self._change_ns = self._next_change(stamp_ns)

    def _next_change(self, stamp_ns: int) -> int:
        # No two parts of a floor should take turns with the same walls for ever.
        period_s = self._p.change_wall_every_s * self._rng.uniform(0.8, 1.2)
        return stamp_ns + round(period_s * 1e9)

    def _left_rad(self, pose: Pose) -> float:
        """Return what is left of a turn: away from the wall first, and back the same way.

        So both turns' errors of odometry cancel out, and the robot looks away from the wall.
        """
        left_rad = wrap(self._target_rad - pose.heading_rad)
        if (self._phase == 'turn_again') == (self._side == 'left_wall'):
            return left_rad if left_rad > -math.pi / 2 else left_rad + math.tau
        return left_rad if left_rad < math.pi / 2 else left_rad - math.tau

    def _account(self, stamp_ns: int, pose: Pose) -> None:
        if self._pose is not None:
            self._driven_m += math.hypot(pose.x_m - self._pose.x_m, pose.y_m - self._pose.y_m)
            turned = wrap(pose.heading_rad - self._pose.heading_rad)
            self._turned_rad += turned
            if self._phase == 'on':
                self._round_rad += turned
            self._turn_without_wall += abs(turned)
        else:
            self._since_ns = stamp_ns
        self._pose = pose

    def _along_wall(
        self, movement: LocalMovement, side: Behaviour, heading_rad: float
    ) -> Command:
        p = self._p
        sign = 1.0 if side == 'left_wall' else -1.0
        beside = movement.points[sign * movement.points[:, 1] > 0.0]
        wall_m = float(np.hypot(*beside.T).min()) if len(beside) else math.inf
        if wall_m < max(p.wall_distance_m, p.wall_distance_most_m) + WALL_M:
            self._turn_without_wall, self._seeking = 0.0, False
        elif self._turn_without_wall > SEEK_AFTER_RAD:
            self._seeking = True
        straight_m = movement.open_m(0.0, p.wall_distance_m)
        if self._seeking and straight_m > p.wall_look_ahead_m:
            return drive(movement, DirectionCandidate('centreline', 0.0, straight_m), p)
        option = None
        if self._driven_m < self._into_until_m:
            option = movement.wall(side, wrap(self._into_rad - heading_rad), INTO_WITHIN_RAD)
        if option is None:
            option = movement.wall(side, 0.0, math.pi / 2)
            self._into_until_m = 0.0
            if option is not None and sign * option.heading_rad > OPENING_RAD:
                self._into_rad = heading_rad + option.heading_rad
                self._into_until_m = self._driven_m + INTO_M
        if self._dead_end and option is not None and abs(option.heading_rad) >= ARRIVED_RAD * 5:
            option = None  # by what opens beside it, it would turn to and fro for ever
        self._dead_end = option is None
        if option is None:  # turn away from the wall until something opens
            return turn(-sign * math.pi / 2, p)
        return drive(movement, option, p)
