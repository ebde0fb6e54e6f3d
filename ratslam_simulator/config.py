# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the simulated robot, and the construction of a simulator from them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.config.parameter import Section, parameter
from ratslam_ros.errors import UnusableInput
from ratslam_simulator.camera import CameraOptions
from ratslam_simulator.floor_plan import FloorPlan, load_floor_plan
from ratslam_simulator.laser import LaserOptions
from ratslam_simulator.robot import RobotOptions
from ratslam_simulator.simulation import ObstacleEvent, SimulationOptions, Simulator
from ratslam_simulator.world import WorldOptions

NO_OBSTACLES = 'none'
"""Value of `obstacles` for a floor without obstacles."""

ANY_PLACE = 'any'
"""Value of `start` for the default start of a plan."""

DEFAULT_START = 'S'
"""Place at which the robot starts by default, if the plan has it."""

VARIETY = 4
"""Sets of wall panels: more than in the demo, whose floor is smaller."""

MAX_MOUNT_M = 0.5
"""Largest distance of a sensor from the centre of the robot, whose radius is 0.22 m: further out,
it would often be inside a wall."""

WHEEL_BASE_ERROR_RATIO = 0.01
"""Relative error of the wheel base of a calibrated robot; the demo's robot is not calibrated."""


@dataclass(frozen=True)
class SimulatorParameters(Section):
    """A simulated robot on a floor plan, for `ratslam simulate` and the node `simulator`."""

    plan: str = parameter(
        'university_floor', '', 0, 0,
        'Floor plan: the name of a plan in the package, or a text or PNG file.',
        'set to a plan of your own building', 'keep the default for a first try')  # fmt: skip
    cell_m: float = parameter(
        0.0, 'm; 0: as the plan says', 0.0, 100.0,
        'Side of a cell of the plan, or of a pixel if the plan is a picture.',
        'rooms are too small', 'rooms are too large')  # fmt: skip
    start: str = parameter(
        ANY_PLACE, '', 0, 0,
        'Start of the robot: a place of the plan, `x,y,degrees`, or `any` for the place S or, if '
        'there is none, the first place of the plan.',
        'set to start elsewhere', 'keep the default if the plan has a place S')  # fmt: skip
    seed: int = parameter(
        1, '', 0, 2**31 - 1, 'Seed of the appearance of the walls and of all noise.',
        'you want a different world', 'you want to repeat a run')  # fmt: skip
    people: int = parameter(
        0, '', 0, 1000, 'Number of people who walk about.',
        'the task should be harder', 'the robot waits for people too often')  # fmt: skip
    obstacles: str = parameter(
        NO_OBSTACLES, '', 0, 0,
        'Obstacles and the times at which they are added and removed: '
        '`name,x,y,width,depth,from_s,to_s`, separated by semicolons; without `to_s` an obstacle '
        'stays.',
        'set to close a door temporarily', 'keep the default for a static floor')  # fmt: skip
    noise: float = parameter(
        1.0, 'times', 0.0, 100.0,
        'Noise of wheels, camera and laser, relative to that of a Pioneer.',
        'the task should be harder', 'errors should be separated from noise')  # fmt: skip
    aliasing: float = parameter(
        0.2, '', 0.0, 1.0, 'Fraction of the walls around named places that look alike.',
        'the task should be harder', 'places should be easy to distinguish')  # fmt: skip
    light_change: float = parameter(
        0.1, 'share', 0.0, 1.0, 'Relative change of the light over time.',
        'the task should be harder', 'places should always look the same')  # fmt: skip
    camera_width: int = parameter(
        80, 'px', 8, 4096, 'Width of images.',
        'you want to look at the images', 'the simulation is too slow')  # fmt: skip
    camera_height: int = parameter(
        60, 'px', 8, 4096, 'Height of images.',
        'you want to look at the images', 'the simulation is too slow')  # fmt: skip
    camera_rate_hz: int = parameter(
        4, 'Hz', 1, 40, 'Images per second, taken at steps of 25 ms.',
        'the robot is fast', 'the simulation is too slow')  # fmt: skip
    laser_mount: str = parameter(
        '0,0,0', '', 0, 0,
        "Pose of the laser on the robot: `x,y,degrees` from the robot's centre, ahead, to the "
        'left and counter-clockwise.',
        'the laser of your robot is elsewhere', 'keep the default for a laser at the centre'
    )  # fmt: skip
    laser_fov_deg: int = parameter(
        180, 'deg', 10, 359, 'Field of view of the laser, with one beam for each degree.',
        'your laser sees more', 'your laser sees less')  # fmt: skip
    rear_laser: bool = parameter(
        False, '', 0, 1,
        'A second laser like the first, mounted opposite to it: turned by 180 degrees about the '
        "robot's centre.",
        'your robot has two lasers; then set experience_map.scan_topics to scan,scan_rear',
        'one laser is enough')  # fmt: skip
    rate: float = parameter(
        1.0, 'times real time', 0.01, 100.0,
        'Live only: simulated time per real time; a slow machine may not reach it.',
        'the simulation should be faster', 'the nodes cannot keep up')  # fmt: skip
    cmd_timeout_s: float = parameter(
        1.0, 's', 0.05, 3600.0,
        'Live only: the motors stop when no cmd_vel has arrived for this long in real time.',
        'commands arrive at a low rate', 'the robot should stop sooner')  # fmt: skip

    def options(self) -> SimulationOptions:
        """Return the options of the simulator."""
        robot, camera, default = RobotOptions(), CameraOptions(), LaserOptions()
        laser = LaserOptions(
            beams=self.laser_fov_deg + 1, fov_deg=self.laser_fov_deg,
            noise_m=default.noise_m * self.noise, mount=parse_mount(self.laser_mount),
        )  # fmt: skip
        opposite = composed(Pose(0.0, 0.0, math.pi), laser.mount)
        return SimulationOptions(
            world=WorldOptions(
                aliasing=self.aliasing, light_change=self.light_change, variety=VARIETY
            ),
            camera=CameraOptions(
                width=self.camera_width, height=self.camera_height, rate_hz=self.camera_rate_hz,
                noise_grey=camera.noise_grey * self.noise,
                exposure_spread=camera.exposure_spread * self.noise,
            ),
            laser=laser,
            rear_laser=replace(laser, mount=opposite) if self.rear_laser else None,
            robot=RobotOptions(
                wheel_radius_error=robot.wheel_radius_error * self.noise,
                wheel_base_error=WHEEL_BASE_ERROR_RATIO * self.noise,
                slip_m=robot.slip_m * self.noise,
            ),
        )  # fmt: skip


def make_simulator(p: SimulatorParameters) -> Simulator:
    """Return a simulator with these parameters.

    Raises:
        UnusableInput: the plan, the start or an obstacle is unusable.
    """
    plan = load_floor_plan(p.plan, p.cell_m or None)
    start, obstacle_events = parse_start(p.start, plan), parse_obstacles(p.obstacles)
    return Simulator(plan, start, p.seed, p.options(), obstacle_events, p.people)


def parse_start(text: str, plan: FloorPlan) -> Pose:
    """Return the start pose for the name of a place, for `x,y,degrees` or for `any`.

    Raises:
        UnusableInput: the text is none of these.
    """
    places = plan.places
    if text == ANY_PLACE and places:
        text = DEFAULT_START if DEFAULT_START in places else next(iter(places))
    if text in places:
        return Pose(*places[text], 0.0)
    numbers = _numbers(text.split(','))
    if numbers is None or len(numbers) != 3:
        known = f'one of the places {", ".join(places)}, or ' if places else ''
        raise UnusableInput(f'the start is {text!r}; expected {known}x,y,degrees such as 3.5,2,90')
    x_m, y_m, degrees = numbers
    return Pose(x_m, y_m, math.radians(degrees))


def parse_mount(text: str) -> Pose:
    """Return the pose of a sensor on the robot from `x,y,degrees`.

    Raises:
        UnusableInput: the text has another form, or the sensor is outside the robot.
    """
    numbers = _numbers(text.split(','))
    if numbers is None or len(numbers) != 3 or math.hypot(*numbers[:2]) > MAX_MOUNT_M:
        raise UnusableInput(
            f'laser_mount is {text!r}; expected x,y,degrees such as 0.15,0,180, at most '
            f'{MAX_MOUNT_M:g} m from the centre'
        )
    x_m, y_m, degrees = numbers
    return Pose(x_m, y_m, math.radians(degrees))


def parse_obstacles(text: str) -> list[ObstacleEvent]:
    """Parse `name,x,y,width,depth,from_s,to_s;...` or `none` into obstacle events.

    Raises:
        UnusableInput: the text has another form, or an obstacle is removed before it is added.
    """
    events: list[ObstacleEvent] = []
    for one in [] if text == NO_OBSTACLES else text.split(';'):
        name, *rest = one.split(',')
        numbers = _numbers(rest)
        if not name or numbers is None or len(numbers) not in (5, 6):
            raise UnusableInput(
                f'an obstacle is {one!r}; expected name,x,y,width,depth,from_s,to_s such as '
                'box,7.2,4.9,1,2,600,900'
            )
        x_m, y_m, width_m, depth_m, from_s = numbers[:5]
        events.append(ObstacleEvent(from_s, 'add', name, x_m, y_m, width_m, depth_m))
        if len(numbers) == 6:
            if numbers[5] <= from_s:
                raise UnusableInput(
                    f'the obstacle {name!r} is removed at {numbers[5]:g} s, before it is added '
                    f'at {from_s:g} s'
                )
            events.append(ObstacleEvent(numbers[5], 'remove', name))
    return events


def _numbers(texts: Sequence[str]) -> list[float] | None:
    try:
        numbers = [float(text) for text in texts]
    except ValueError:
        return None
    return numbers if all(math.isfinite(number) for number in numbers) else None
