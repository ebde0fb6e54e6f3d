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
    wall_distance_m: float = parameter(
        0.42, 'm', 0.05, 10.0,
        'Smallest distance from the centre of the robot to a wall that it follows; doors must be '
        'at least twice as wide.',
        'walls are rough or the odometry is poor', 'doors are missed')  # fmt: skip
    wall_distance_most_m: float = parameter(
        1.0, 'm', 0.05, 10.0,
        'Largest distance from a wall that the robot follows. In passages narrower than twice '
        'this, it drives in the middle.',
        'passages are wider than twice this, and both directions should use the same path',
        'doors along the wall are missed')  # fmt: skip
    wall_look_ahead_m: float = parameter(
        0.8, 'm', 0.05, 10.0,
        'Free distance ahead that a direction along a wall must have to be considered.',
        'the robot oscillates while it follows a wall', 'it cuts across small recesses',
    )  # fmt: skip
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
    route_ahead_m: float = parameter(
        1.2, 'm', 0.1, 100.0,
        'Length of the route ahead that candidate directions are compared with.',
        'the robot oscillates about the route', 'it cuts corners')  # fmt: skip
    try_timeout_s: float = parameter(
        3.0, 's', 0.1, 600.0,
        'A transition counts as failed once if no free direction follows the route for this long.',
        'routes are removed because people stand in the way',
        'the robot waits too long at a closed door',
    )  # fmt: skip
    look_back_every_m: float = parameter(
        8.0, 'm', 0.1, 1e6,
        'Exploration: distance after which the robot turns back, to see places from the other '
        'side.',
        'exploration takes too long', 'places are not recognised from the other side',
    )  # fmt: skip
    look_back_turn_deg: float = parameter(
        200.0, 'deg', 1.0, 1e6,
        'Exploration: half of look_back_every_m suffices once the robot has turned by this angle '
        'since it last turned back.',
        'exploration takes too long', 'corners are not recognised from the other side',
    )  # fmt: skip
    look_back_m: float = parameter(
        1.0, 'm', 0.0, 1e6, 'Exploration: distance that the robot drives back.',
        'places are not recognised from the other side', 'exploration takes too long',
    )  # fmt: skip
    change_wall_every_s: float = parameter(
        900.0, 's', 1.0, 1e6,
        'Exploration: mean time after which the robot, when it has turned back, does not resume '
        'its direction. It alternately continues along the opposite wall, and back along the '
        'same wall.',
        'it leaves parts of the floor before it has mapped them',
        'the floor is small, or there is less than an hour to explore it')  # fmt: skip
    explore: bool = parameter(
        False, '', 0, 1, 'Live only: explore while there is no goal.',
        'the robot should map its environment on its own',
        'the robot is driven by an operator or another node',
        runtime='at once',
    )  # fmt: skip
    explore_seed: int = parameter(
        1, '', 0, 2**31 - 1, 'Live only: seed of the random numbers used in exploration.',
        'it should explore in another order', 'it should explore as it did before')  # fmt: skip
