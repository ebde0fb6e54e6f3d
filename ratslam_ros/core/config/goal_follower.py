# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the goal follower: local obstacle avoidance with the laser, and exploration."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter


@dataclass(frozen=True)
class GoalFollowerParameters(Section):
    """The local planner: obstacle avoidance with the laser, route following and exploration."""

    robot_radius_m: float = parameter(
        0.25, 'm', 0.01, 10.0, 'Radius of the circle that the robot occupies when it turns.',
        'the robot touches obstacles', 'it refuses doors that it fits through')  # fmt: skip
    margin_m: float = parameter(
        0.06, 'm', 0.0, 10.0, 'Clearance to keep on each side when passing between obstacles.',
        'the robot brushes door frames', 'it refuses doors that it fits through')  # fmt: skip
    speed_mps: float = parameter(
        0.6, 'm/s', 0.01, 10.0, 'Speed on a straight path without obstacles.',
        'the robot could safely be faster', 'it stops too late, or images blur')  # fmt: skip
    turn_rate_radps: float = parameter(
        1.5, 'rad/s', 0.05, 10.0, 'Maximum turn rate.',
        'turning back takes too long', 'views change too quickly to be recognised')  # fmt: skip
    braking_mps2: float = parameter(
        0.3, 'm/s^2', 0.01, 10.0, 'Deceleration that the robot achieves reliably.',
        'it slows down too early', 'it stops too late')  # fmt: skip
    stop_distance_m: float = parameter(
        0.12, 'm', 0.0, 10.0, 'Safety: minimum gap between the body and an obstacle ahead.',
        'the robot stops too close', 'it stops although it could pass')  # fmt: skip
    scan_timeout_s: float = parameter(
        0.5, 's', 0.05, 60.0, 'Safety: the robot stops if it receives no scan for this long.',
        'the laser is slow', 'the robot should stop sooner when its laser fails')  # fmt: skip
    path_choice: str = parameter(
        'learned_wall', '', 0, 0,
        'Choice among the free directions. learned_wall: along the wall that the route was '
        'learned along, else the one closest to the route, with a discount for those along walls. '
        'nearest: the one closest to the route, as in Milford et al. (2006), section IV.C.',
        'leave at learned_wall', 'set to nearest to compare with the paper',
        choices=('learned_wall', 'nearest'),
    )  # fmt: skip
    explore: bool = parameter(
        False, '', 0, 1, 'Live only: explore while there is no goal.',
        'the robot should map its environment on its own',
        'the robot is driven by an operator or another node',
        runtime='at once',
    )  # fmt: skip

    @property
    def wall_distance_m(self) -> float:
        """Smallest distance from the centre of the robot to a wall that it follows, in m.

        The clearance for rough walls and poor odometry grows with the robot.
        """
        return 1.68 * self.robot_radius_m
