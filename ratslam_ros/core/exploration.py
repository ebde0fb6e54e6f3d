# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exploration: scan, odometry -> Command; left wall following and turning back to look."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from ratslam_ros.core.angles import wrap
from ratslam_ros.core.goal_follower import Command, drive, turn
from ratslam_ros.core.local_movement import Behaviour, LocalMovement, Option, Scan
from ratslam_ros.core.movement_config import GoalFollowerParameters
from ratslam_ros.core.odometry import Pose

Phase = Literal['on', 'turn_back', 'back', 'turn_again', 'again']

WALL_M = 1.0
"""A wall nearer than this is one that can be followed."""

SEEK_AFTER_RAD = math.radians(300.0)
"""So much turned without a wall beside: there is none here. Go straight on to the next."""

STUCK_S = 15.0
"""A phase of the look back that takes longer is given up: somebody stands in the way."""


class Exploration:
    """Left wall following, interrupted by turning back to look (seed 001, section IV.D)."""

    def __init__(self, parameters: GoalFollowerParameters, rng: np.random.Generator) -> None:
        """``rng``: draws after which looks the robot goes on along the other wall."""
        self._p = parameters
        self._rng = rng
        self._pose: Pose | None = None
        self._phase: Phase = 'on'
        self._begin(0)
        self._target_rad = 0.0
        self._turn_without_wall = 0.0
        self._seeking = False

    def _begin(self, stamp_ns: int) -> None:
        self._driven_m = self._turned_rad = 0.0
        self._since_ns = stamp_ns

    def restart(self) -> None:
        """Begin with following the wall, after something else has moved the robot."""
        self._phase, self._pose, self._seeking = 'on', None, False
        self._turn_without_wall = 0.0
        self._begin(0)

    def __call__(self, scan: Scan, pose: Pose) -> Command:
        """Return how to move on.

        ``pose``: by odometry alone; only its changes count.
        """
        p = self._p
        self._account(scan.stamp_ns, pose)
        movement = LocalMovement(p, scan)
        stuck = scan.stamp_ns - self._since_ns > STUCK_S * 1e9
        if self._phase == 'on':
            looked = (
                self._driven_m >= p.look_back_every_m
                or (abs(self._turned_rad) >= math.radians(p.look_back_turn_deg)
                and self._driven_m >= p.look_back_m)
            )
            if looked:
                self._turn_round(scan.stamp_ns, pose, 'turn_back')
        elif self._phase in ('turn_back', 'turn_again'):
            left_rad = wrap(self._target_rad - pose.heading_rad)
            if abs(left_rad) > math.radians(10.0) and not stuck:
                return turn(left_rad, p)
            if self._phase == 'turn_again':
                self._phase = 'again'
            else:
                on = self._rng.random() < p.change_wall_share
                self._phase = 'on' if on else 'back'
            self._begin(scan.stamp_ns)
        elif self._phase == 'back' and (self._driven_m >= p.look_back_m or stuck):
            self._turn_round(scan.stamp_ns, pose, 'turn_again')
        elif self._phase == 'again' and (self._driven_m >= p.look_back_m or stuck):
            self._phase = 'on'
            self._begin(scan.stamp_ns)
        if self._phase in ('turn_back', 'turn_again'):
            return turn(wrap(self._target_rad - pose.heading_rad), p)
        return self._along_wall(movement, 'right_wall' if self._phase == 'back' else 'left_wall')

    def _turn_round(self, stamp_ns: int, pose: Pose, phase: Phase) -> None:
        self._phase = phase
        self._target_rad = wrap(pose.heading_rad + math.pi)
        self._begin(stamp_ns)

    def _account(self, stamp_ns: int, pose: Pose) -> None:
        if self._pose is not None:
            self._driven_m += math.hypot(pose.x_m - self._pose.x_m, pose.y_m - self._pose.y_m)
            turned = wrap(pose.heading_rad - self._pose.heading_rad)
            self._turned_rad += turned
            self._turn_without_wall += abs(turned)
        else:
            self._since_ns = stamp_ns
        self._pose = pose

    def _along_wall(self, movement: LocalMovement, side: Behaviour) -> Command:
        p = self._p
        sign = 1.0 if side == 'left_wall' else -1.0
        beside = movement.points[sign * movement.points[:, 1] > 0.0]
        wall_m = float(np.hypot(*beside.T).min()) if len(beside) else math.inf
        if wall_m < WALL_M:
            self._turn_without_wall, self._seeking = 0.0, False
        elif self._turn_without_wall > SEEK_AFTER_RAD:
            self._seeking = True
        straight_m = movement.open_m(0.0, p.wall_distance_m)
        if self._seeking and straight_m > p.wall_look_ahead_m:
            return drive(movement, Option('centreline', 0.0, straight_m), p)
        found = [option for option in movement.options() if option.behaviour == side]
        if not found:  # a dead end: turn away from the wall until something opens
            return turn(-sign * math.pi / 2, p)
        return drive(movement, found[0], p)
