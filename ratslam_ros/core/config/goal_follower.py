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
        0.25, 'Radius of the circle that the robot occupies when it turns.',
        unit='m', low=0.01, high=10.0,
        raise_if='the robot touches obstacles', lower_if='it refuses doors that it fits through',
    )
    margin_m: float = parameter(
        0.06, 'Clearance to keep on each side when passing between obstacles.',
        unit='m', low=0.0, high=10.0,
        raise_if='the robot brushes door frames', lower_if='it refuses doors that it fits through',
    )
    speed_mps: float = parameter(
        0.6, 'Speed on a straight path without obstacles.', unit='m/s', low=0.01, high=10.0,
        raise_if='the robot could safely be faster', lower_if='it stops too late, or images blur',
    )
    turn_rate_radps: float = parameter(
        1.5, 'Maximum turn rate.', unit='rad/s', low=0.05, high=10.0,
        raise_if='turning back takes too long',
        lower_if='views change too quickly to be recognised',
    )
    braking_mps2: float = parameter(
        0.3, 'Deceleration that the robot achieves reliably.', unit='m/s^2', low=0.01, high=10.0,
        raise_if='it slows down too early', lower_if='it stops too late',
    )
    stop_distance_m: float = parameter(
        0.12, 'Safety: minimum gap between the body and an obstacle ahead.',
        unit='m', low=0.0, high=10.0,
        raise_if='the robot stops too close', lower_if='it stops although it could pass',
    )
    scan_timeout_s: float = parameter(
        0.5, 'Safety: the robot stops if it receives no scan for this long.',
        unit='s', low=0.05, high=60.0,
        raise_if='the laser is slow', lower_if='the robot should stop sooner when its laser fails',
    )
    path_choice: str = parameter(
        'learned_wall',
        'Choice among the free directions. learned_wall: along the wall that the route was '
        'learned along, else the one closest to the route, with a discount for those along '
        'walls. nearest: the one closest to the route, as in Milford et al. (2006), section IV.C.',
        choices=('learned_wall', 'nearest'),
        raise_if='leave at learned_wall', lower_if='set to nearest to compare with the paper',
    )
    steer_by: str = parameter(
        'route',
        'Live only: what leads to the goals. route: the route on the map, experience_map/route. '
        'goal_memory: the direction on the pose cells, pose_cells/goal_memory, as in Milford et '
        'al. (2005).',
        choices=('route', 'goal_memory'),
        raise_if='leave at route',
        lower_if='set to goal_memory, with goal_memory.goal_memory, to drive without the map',
    )
    explore_by: str = parameter(
        'walls',
        'In `ratslam simulate` and benchmarks only: how the robot explores. walls: along walls. '
        'exits: also to the nearest exit of a known place that was never taken.',
        choices=('walls', 'exits'),
        raise_if='the robot has a laser on its map, and should see the whole floor soon',
        lower_if='the map is built by the camera alone',
    )
    explore: bool = parameter(
        False, 'Live only: explore while there is no goal.',
        raise_if='the robot should map its environment on its own',
        lower_if='the robot is driven by an operator or another node', runtime='at once',
    )

    @property
    def wall_distance_m(self) -> float:
        """Smallest distance from the centre of the robot to a wall that it follows, in m.

        The clearance for rough walls and poor odometry grows with the robot.
        """
        return 1.68 * self.robot_radius_m
