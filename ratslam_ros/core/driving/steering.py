# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Steering: a way on, or a turn -> Command, no faster than the robot can stop."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.free_directions import Behaviour, DirectionCandidate, LocalMovement


@dataclass(frozen=True, slots=True)
class Command:
    """What the robot shall do, and the behaviour that says so.

    ``failed``: the behaviour was tried for ``try_timeout_s`` and led nowhere; ``ahead_rad``: the
    direction in which it was tried, in the robot's frame.
    """

    speed_mps: float
    turn_rate_radps: float
    behaviour: Behaviour
    failed: bool = False
    ahead_rad: float = 0.0


def drive(
    movement: LocalMovement, option: DirectionCandidate, p: GoalFollowerParameters,
    most_mps: float = math.inf,
) -> Command:  # fmt: skip
    """Return how to take a way on: towards it, as fast as what is ahead allows."""
    turn_rate = max(-p.turn_rate_radps, min(2.0 * option.heading_rad, p.turn_rate_radps))
    # Ahead counts what the body will reach, whichever way it is about to turn.
    gap_m = min(movement.open_m(0.0, p.robot_radius_m), option.open_m) - p.stop_distance_m
    speed = p.speed_mps * max(math.cos(1.5 * option.heading_rad), 0.0)
    speed = min(speed, most_mps, math.sqrt(2.0 * p.braking_mps2 * max(gap_m, 0.0)))
    if abs(option.heading_rad) > math.pi / 3:
        speed = 0.0
    return Command(speed, turn_rate, option.behaviour, ahead_rad=option.heading_rad)


def turn(bearing_rad: float, p: GoalFollowerParameters) -> Command:
    """Return how to turn on the spot, slower towards the end."""
    rate = max(-p.turn_rate_radps, min(1.5 * bearing_rad, p.turn_rate_radps))
    return Command(0.0, rate, 'turn', ahead_rad=bearing_rad)
