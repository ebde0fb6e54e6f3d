# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the goal follower: how the robot moves by its laser, and explores."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.inputs import LiveInput
from ratslam_ros.core.config.parameter import parameter


@dataclass(frozen=True)
class GoalFollowerParameters(LiveInput):
    """What moves the robot: local movement by the laser, and the choice between its ways on."""

    robot_radius_m: float = parameter(
        0.25, 'm', 0.01, 10.0, 'Radius of the circle that the robot turns in.',
        'the robot touches things', 'it refuses doors that it fits through')  # fmt: skip
    margin_m: float = parameter(
        0.06, 'm', 0.0, 10.0, 'Room to keep on each side while passing between things.',
        'the robot brushes door frames', 'it refuses doors that it fits through')  # fmt: skip
    wall_distance_m: float = parameter(
        0.42, 'm', 0.05, 10.0,
        "Distance of the robot's middle to a wall that it follows; doors must be twice as wide.",
        'walls are rough or the odometry poor', 'doors are missed')  # fmt: skip
    wall_distance_most_m: float = parameter(
        1.0, 'm', 0.05, 10.0,
        'Where there is room walls are followed at this distance, or in the middle of a passage.',
        'passages are wider than twice this: ways to and fro shall be the same',
        'doors along the wall are missed')  # fmt: skip
    wall_look_ahead_m: float = parameter(
        0.8, 'm', 0.05, 10.0, 'A way along a wall must be open this far.',
        'the robot swings while it follows a wall', 'it cuts across small recesses')  # fmt: skip
    speed_mps: float = parameter(
        0.6, 'm/s', 0.01, 10.0, 'Speed where the way is straight and open.',
        'the robot could safely be faster', 'it is late to stop, or images blur')  # fmt: skip
    turn_rate_radps: float = parameter(
        1.5, 'rad/s', 0.05, 10.0, 'Fastest turn.',
        'turning back takes too long', 'views change too quickly to be recognised')  # fmt: skip
    braking_mps2: float = parameter(
        0.3, 'm/s^2', 0.01, 10.0, 'Slowing down that the robot can rely on.',
        'it slows down too early', 'it stops too late')  # fmt: skip
    stop_distance_m: float = parameter(
        0.12, 'm', 0.0, 10.0, 'Safety: gap between the body and whatever is ahead that must stay.',
        'the robot stops too close', 'it stops where it could pass')  # fmt: skip
    scan_timeout_s: float = parameter(
        0.5, 's', 0.05, 60.0, 'Safety: without a scan for this long the robot stands still.',
        'the laser is slow', 'the robot should stop sooner when its laser fails')  # fmt: skip
    route_ahead_m: float = parameter(
        1.2, 'm', 0.1, 100.0, 'Ways on are compared with this much of the route.',
        'the robot swings about the route', 'it cuts corners')  # fmt: skip
    try_timeout_s: float = parameter(
        3.0, 's', 0.1, 600.0,
        'Where no way on follows the route for this long, the transition has failed once.',
        'people in the way make it forget routes', 'it waits too long at a closed door',
    )  # fmt: skip
    look_back_every_m: float = parameter(
        8.0, 'm', 0.1, 1e6, 'Exploring: turn back and look after driving this far.',
        'exploring takes too long', 'places are not recognised from the other side')  # fmt: skip
    look_back_turn_deg: float = parameter(
        200.0, 'deg', 1.0, 1e6,
        'Exploring: and after half of that, having turned this far since the last look.',
        'exploring takes too long', 'corners are not recognised from the other side')  # fmt: skip
    look_back_m: float = parameter(
        1.0, 'm', 0.0, 1e6, 'Exploring: how far the robot goes back to look.',
        'places are not recognised from the other side', 'exploring takes too long')  # fmt: skip
    change_wall_every_s: float = parameter(
        900.0, 's', 1.0, 1e6,
        'Exploring: about this often the robot, once turned, goes on: along the wall across, and '
        'the next time back along the same wall.',
        'it leaves parts of the floor before it knows them',
        'the floor is small, or there is less than an hour to explore it')  # fmt: skip
    explore: bool = parameter(
        False, '', 0, 1, 'Live only: explore while there is no goal.',
        'the robot shall make its map by itself', 'somebody else drives it about')  # fmt: skip
    explore_seed: int = parameter(
        1, '', 0, 2**31 - 1, 'Live only: of what exploring draws by lot.',
        'it should explore in another order', 'it should explore as it did before')  # fmt: skip
