# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exploration: wall following, interrupted by turning back to see places from both sides."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.free_directions import (
    OPENING_RAD,
    WALL_DISTANCE_MOST_M,
    WALL_LOOK_AHEAD_M,
    Behaviour,
    DirectionCandidate,
    LocalMovement,
)
from ratslam_ros.core.driving.steering import Command, drive, turn

if TYPE_CHECKING:  # the caller creates the generator
    from numpy.random import Generator

Phase = Literal[
    'follow', 'turn_back', 'look_back', 'turn_again', 'return', 'turn_off', 'leave', 'turn_along'
]
"""The main phase is ``follow``. A look back is ``turn_back``, ``look_back``, ``turn_again`` and
``return``. An island is left by ``turn_off``, ``leave`` and ``turn_along``."""

_AFTER_TURN: dict[Phase, Phase] = {
    'turn_back': 'look_back', 'turn_again': 'return', 'turn_off': 'leave', 'turn_along': 'follow'
}
"""Phase that follows each turn."""

TURN_TOLERANCE_RAD = math.radians(10.0)
"""Remaining angle at which a turn is complete."""

WALL_TOLERANCE_M = 0.4
"""Distance of a wall that can be followed, beyond the distance to follow it at, in m."""

NO_WALL_TURN_RAD = math.radians(300.0)
"""Total turn without a wall beside the robot after which it drives straight on to the next."""

ISLAND_RAD = math.radians(450.0)
"""Net turn towards the wall after which it is taken for an island, such as a table."""

ENTER_M = 1.5
"""Distance that the robot drives into an opening before other directions count, in m. Otherwise,
after turning to a door from the middle of a corridor, it would follow its wall back into the
corridor."""

ENTER_TOLERANCE_RAD = math.radians(50.0)
"""Maximum angle between the opening and the direction of driving while the robot enters it."""

PHASE_TIMEOUT_S = 15.0
"""Duration after which a blocked phase other than ``follow`` ends, in s."""


@dataclass(frozen=True)
class LookBacks:
    """When the robot turns back, to see places from the other side; the defaults are for hours.

    Attributes:
        every_m: distance after which it turns back.
        turn_deg: half of this distance suffices once it has turned by this angle since then.
        back_m: distance that it drives back.
        change_wall_every_s: mean time after which it does not resume its direction, but changes to
            the opposite wall or reverses: long enough to map the floor before.
    """

    every_m: float = 8.0
    turn_deg: float = 200.0
    back_m: float = 1.0
    change_wall_every_s: float = 900.0


class Exploration:
    """Left wall following with look-backs after Milford et al. (2005), section IV.D.

    Additionally, about every ``LookBacks.change_wall_every_s`` the robot continues along the
    opposite wall, and the next time back along the same wall: a forward-looking camera recognises
    a path only in the direction in which it was driven.
    """

    def __init__(
        self, parameters: GoalFollowerParameters, rng: Generator,
        look_backs: LookBacks = LookBacks(),
    ) -> None:
        """``rng``: randomises the intervals between changes of the wall."""
        self._p, self._look_backs = parameters, look_backs
        self._rng = rng
        self._side: Behaviour = 'left_wall'
        self._crossed = False
        self._change_ns: int | None = None
        self.restart()

    def _begin(self, stamp_ns: int, phase: Phase, target_rad: float = 0.0) -> None:
        if phase in ('turn_off', 'leave', 'turn_along'):
            self._net_turn_rad = 0.0
        self._phase, self._target_rad = phase, target_rad
        self._driven_m = self._turned_rad = self._enter_until_m = self._enter_rad = 0.0
        self._since_ns = stamp_ns

    def restart(self) -> None:
        """Restart with wall following, after the robot was moved by other commands."""
        self._pose: Pose | None = None
        self._seeking = self._dead_end = False
        self._no_wall_turn_rad = self._net_turn_rad = 0.0
        self._begin(0, 'follow')

    def command(self, scan: Scan, pose: Pose) -> Command:
        """Return the next command.

        Args:
            scan: the current scan.
            pose: dead reckoning; only its changes count.
        """
        self._account_for_motion(scan.stamp_ns, pose)
        if self._change_ns is None:
            self._change_ns = self._next_change(scan.stamp_ns)
        movement = LocalMovement(self._p, scan)
        self._update_phase(scan.stamp_ns, pose, movement)
        if self._phase in _AFTER_TURN:
            return turn(self._remaining_turn_rad(pose), self._p)
        if self._phase == 'leave':
            ahead = DirectionCandidate('centreline', 0.0, movement.free_m(0.0))
            return drive(movement, ahead, self._p)
        other: Behaviour = 'right_wall' if self._side == 'left_wall' else 'left_wall'
        side = other if self._phase == 'look_back' else self._side
        return self._along_wall(movement, side, pose.heading_rad)

    def _update_phase(self, stamp_ns: int, pose: Pose, movement: LocalMovement) -> None:
        """Begin the next phase if the current one is complete."""
        looks = self._look_backs
        timed_out = stamp_ns - self._since_ns > PHASE_TIMEOUT_S * 1e9
        has_driven_back = self._driven_m >= looks.back_m or timed_out
        sign = 1.0 if self._side == 'left_wall' else -1.0
        if self._phase == 'follow':
            turned = abs(self._turned_rad) >= math.radians(looks.turn_deg)
            if sign * self._net_turn_rad > ISLAND_RAD:
                self._begin(stamp_ns, 'turn_off', pose.heading_rad - sign * math.pi / 2)
            elif self._driven_m >= looks.every_m * (0.5 if turned else 1.0):
                self._begin(stamp_ns, 'turn_back', pose.heading_rad + math.pi)
        elif self._phase in _AFTER_TURN:
            if abs(self._remaining_turn_rad(pose)) < TURN_TOLERANCE_RAD or timed_out:
                following = _AFTER_TURN[self._phase]
                assert self._change_ns is not None
                if following == 'look_back' and stamp_ns >= self._change_ns:
                    following = 'follow'
                    self._change_wall(stamp_ns)
                self._begin(stamp_ns, following)
        elif self._phase == 'look_back' and has_driven_back:
            self._begin(stamp_ns, 'turn_again', pose.heading_rad + math.pi)
        elif self._phase == 'return':
            if has_driven_back:
                self._begin(stamp_ns, 'follow')
        elif movement.free_m(0.0) < WALL_LOOK_AHEAD_M or timed_out:
            # A turn to the other side would put the island beside the robot again.
            self._begin(stamp_ns, 'turn_along', pose.heading_rad - sign * math.pi / 2)

    def _change_wall(self, stamp_ns: int) -> None:
        """Continue along the opposite wall, and the next time back along the same wall."""
        self._net_turn_rad = 0.0
        self._crossed = not self._crossed
        if not self._crossed:
            self._side = 'right_wall' if self._side == 'left_wall' else 'left_wall'
        self._change_ns = self._next_change(stamp_ns)

    def _next_change(self, stamp_ns: int) -> int:
        # A fixed interval could match a cycle on the floor, so that some walls are never followed.
        period_s = self._look_backs.change_wall_every_s * self._rng.uniform(0.8, 1.2)
        return stamp_ns + round(period_s * 1e9)

    def _remaining_turn_rad(self, pose: Pose) -> float:
        """Return the remaining angle of a turn, with its sense of rotation.

        The first turn leads away from the wall and the second one back, so that the odometry
        errors of both cancel and the robot views the room.
        """
        left_rad = wrap(self._target_rad - pose.heading_rad)
        if (self._phase == 'turn_again') == (self._side == 'left_wall'):
            return left_rad if left_rad > -math.pi / 2 else left_rad + math.tau
        return left_rad if left_rad < math.pi / 2 else left_rad - math.tau

    def _account_for_motion(self, stamp_ns: int, pose: Pose) -> None:
        """Add the motion since the last command to distances and turns."""
        if self._pose is not None:
            self._driven_m += math.hypot(pose.x_m - self._pose.x_m, pose.y_m - self._pose.y_m)
            turned = wrap(pose.heading_rad - self._pose.heading_rad)
            self._turned_rad += turned
            if self._phase == 'follow':
                self._net_turn_rad += turned
            self._no_wall_turn_rad += abs(turned)
        else:
            self._since_ns = stamp_ns
        self._pose = pose

    def _along_wall(
        self, movement: LocalMovement, side: Behaviour, heading_rad: float
    ) -> Command:
        """Return the command for following a wall, for seeking one, or for turning."""
        p = self._p
        sign = 1.0 if side == 'left_wall' else -1.0
        beside = movement.points[sign * movement.points[:, 1] > 0.0]
        wall_m = float(np.hypot(*beside.T).min()) if len(beside) else math.inf
        if wall_m < max(p.wall_distance_m, WALL_DISTANCE_MOST_M) + WALL_TOLERANCE_M:
            self._no_wall_turn_rad, self._seeking = 0.0, False
        elif self._no_wall_turn_rad > NO_WALL_TURN_RAD:
            self._seeking = True
        straight_m = movement.free_m(0.0, p.wall_distance_m)
        if self._seeking and straight_m > WALL_LOOK_AHEAD_M:
            return drive(movement, DirectionCandidate('centreline', 0.0, straight_m), p)
        candidate = None
        if self._driven_m < self._enter_until_m:
            about_rad = wrap(self._enter_rad - heading_rad)
            candidate = movement.along_wall(side, about_rad, ENTER_TOLERANCE_RAD)
        if candidate is None:
            candidate = movement.along_wall(side, 0.0, math.pi / 2)
            self._enter_until_m = 0.0
            if candidate is not None and sign * candidate.heading_rad > OPENING_RAD:
                self._enter_rad = heading_rad + candidate.heading_rad
                self._enter_until_m = self._driven_m + ENTER_M
        if self._dead_end and candidate and abs(candidate.heading_rad) >= TURN_TOLERANCE_RAD * 5:
            candidate = None  # turning to each opening at the side would oscillate
        self._dead_end = candidate is None
        if candidate is None:  # turn away from the wall until a direction is free
            return turn(-sign * math.pi / 2, p)
        return drive(movement, candidate, p)
