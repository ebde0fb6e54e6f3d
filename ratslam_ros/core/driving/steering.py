# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Steering: velocity commands for a direction or a turn, limited by the braking distance."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.free_directions import Behaviour, DirectionCandidate, LocalMovement


@dataclass(frozen=True, slots=True)
class Command:
    """A velocity command and the behaviour it results from.

    Attributes:
        speed_mps: forward speed in m/s.
        turn_rate_radps: turn rate in rad/s, positive to the left.
        behaviour: the chosen behaviour.
        failed: whether the behaviour has timed out without progress.
        ahead_rad: intended direction in the frame of the robot.
    """

    speed_mps: float
    turn_rate_radps: float
    behaviour: Behaviour
    failed: bool = False
    ahead_rad: float = 0.0


def drive(
    movement: LocalMovement, candidate: DirectionCandidate, p: GoalFollowerParameters
) -> Command:
    """Return the command for a direction, as fast as the free distance allows."""
    turn_rate = max(-p.turn_rate_radps, min(2.0 * candidate.heading_rad, p.turn_rate_radps))
    # The body reaches what is straight ahead, whatever the direction of the next turn.
    gap_m = min(movement.free_m(0.0, p.robot_radius_m), candidate.free_m) - p.stop_distance_m
    speed = p.speed_mps * max(math.cos(1.5 * candidate.heading_rad), 0.0)
    speed = min(speed, math.sqrt(2.0 * p.braking_mps2 * max(gap_m, 0.0)))
    if abs(candidate.heading_rad) > math.pi / 3:
        speed = 0.0
    return Command(speed, turn_rate, candidate.behaviour, ahead_rad=candidate.heading_rad)


def turn(bearing_rad: float, p: GoalFollowerParameters) -> Command:
    """Return the command for a turn on the spot, slower towards its end."""
    rate = max(-p.turn_rate_radps, min(1.5 * bearing_rad, p.turn_rate_radps))
    return Command(0.0, rate, 'turn', ahead_rad=bearing_rad)
