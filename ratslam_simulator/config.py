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
from ratslam_simulator.people import Walk
from ratslam_simulator.robot import RobotOptions
from ratslam_simulator.simulation import ObstacleEvent, SimulationOptions, Simulator
from ratslam_simulator.sonar import SonarOptions
from ratslam_simulator.world import WorldOptions

NONE = 'none'
"""Value of `walks`, `obstacles` and `carries` for none of them."""

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
        'university_floor',
        'Floor plan: the name of a plan in the package, or a text or PNG file.',
        raise_if='set to a plan of your own building', lower_if='keep the default for a first try',
    )
    cell_m: float = parameter(
        0.0, 'Side of a cell of the plan, or of a pixel if the plan is a picture.',
        unit='m; 0: as the plan says', low=0.0, high=100.0,
        raise_if='rooms are too small', lower_if='rooms are too large',
    )
    start: str = parameter(
        ANY_PLACE,
        'Start of the robot: a place of the plan, `x,y,degrees`, or `any` for the place S or, if '
        'there is none, the first place of the plan.',
        low=0, high=0,
        raise_if='set to start elsewhere', lower_if='keep the default if the plan has a place S',
    )
    seed: int = parameter(
        1, 'Seed of the appearance of the walls and of all noise.', low=0, high=2**31 - 1,
        raise_if='you want a different world', lower_if='you want to repeat a run',
    )
    people: int = parameter(
        0, 'Number of people who walk about at random.', low=0, high=1000,
        raise_if='the task should be harder', lower_if='the robot waits for people too often',
    )
    walks: str = parameter(
        NONE,
        'People who come, walk along points, back and forth, and go: `x,y,x,y,...,from_s,to_s`, '
        'separated by semicolons. At a single point a person stands; without `to_s` the person '
        'stays. A person who is blocked for a few seconds turns round.',
        low=0, high=0,
        raise_if='set to let people stand in the way or walk along the route of the robot',
        lower_if='keep the default for a floor without them',
    )
    obstacles: str = parameter(
        NONE,
        'Obstacles and the times at which they are added and removed: '
        '`name,x,y,width,depth,from_s,to_s`, separated by semicolons; without `to_s` an obstacle '
        'stays.',
        low=0, high=0,
        raise_if='set to close a door temporarily', lower_if='keep the default for a static floor',
    )
    carries: str = parameter(
        NONE,
        'Times at which the robot is carried, and the poses to which it is: `x,y,degrees,at_s`, '
        'separated by semicolons. Its wheels do not turn.',
        low=0, high=0,
        raise_if='set to kidnap the robot, also on its way to a goal',
        lower_if='keep the default for a robot that only drives',
    )
    noise: float = parameter(
        1.0, 'Noise of wheels, camera, laser and sonars, relative to that of a Pioneer.',
        unit='times', low=0.0, high=100.0,
        raise_if='the task should be harder', lower_if='errors should be separated from noise',
    )
    aliasing: float = parameter(
        0.2, 'Fraction of the walls around named places that look alike.', low=0.0, high=1.0,
        raise_if='the task should be harder', lower_if='places should be easy to distinguish',
    )
    light_change: float = parameter(
        0.1, 'Relative change of the light over time.', unit='share', low=0.0, high=1.0,
        raise_if='the task should be harder', lower_if='places should always look the same',
    )
    camera_width: int = parameter(
        80, 'Width of images.', unit='px', low=8, high=4096,
        raise_if='you want to look at the images', lower_if='the simulation is too slow',
    )
    camera_height: int = parameter(
        60, 'Height of images.', unit='px', low=8, high=4096,
        raise_if='you want to look at the images', lower_if='the simulation is too slow',
    )
    camera_rate_hz: int = parameter(
        4, 'Images per second, taken at steps of 25 ms.', unit='Hz', low=1, high=40,
        raise_if='the robot is fast', lower_if='the simulation is too slow',
    )
    laser_mount: str = parameter(
        '0,0,0',
        "Pose of the laser on the robot: `x,y,degrees` from the robot's centre, ahead, to the "
        'left and counter-clockwise.',
        raise_if='the laser of your robot is elsewhere',
        lower_if='keep the default for a laser at the centre',
    )
    laser_fov_deg: int = parameter(
        180, 'Field of view of the laser, with one beam for each degree.',
        unit='deg', low=10, high=359,
        raise_if='your laser sees more', lower_if='your laser sees less',
    )
    rear_laser: bool = parameter(
        False,
        'A second laser like the first, mounted opposite to it: turned by 180 degrees about the '
        "robot's centre.",
        raise_if='your robot has two lasers; then set experience_map.scan_topics to '
        'scan,scan_rear',
        lower_if='one laser is enough',
    )
    sonars: bool = parameter(
        False,
        'Eight sonars with wide beams, as on the front of a Pioneer 2DX; smooth walls at an angle '
        'return no echo, or a late one.',
        raise_if='you want the robot of Milford et al. (2005)', lower_if='the laser is enough',
    )
    rate: float = parameter(
        1.0, 'Live only: simulated time per real time; a slow machine may not reach it.',
        unit='times real time', low=0.01, high=100.0,
        raise_if='the simulation should be faster', lower_if='the nodes cannot keep up',
    )
    cmd_timeout_s: float = parameter(
        1.0, 'Live only: the motors stop when no cmd_vel has arrived for this long in real time.',
        unit='s', low=0.05, high=3600.0,
        raise_if='commands arrive at a low rate', lower_if='the robot should stop sooner',
    )

    def options(self) -> SimulationOptions:
        """Return the options of the simulator."""
        robot, camera, default = RobotOptions(), CameraOptions(), LaserOptions()
        laser = LaserOptions(
            beams=self.laser_fov_deg + 1, fov_deg=self.laser_fov_deg,
            noise_m=default.noise_m * self.noise, mount=parse_mount(self.laser_mount),
        )
        sonars = SonarOptions()
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
            sonars=replace(
                sonars, noise_ratio=sonars.noise_ratio * self.noise
            ) if self.sonars else None,
            robot=RobotOptions(
                wheel_radius_error=robot.wheel_radius_error * self.noise,
                wheel_base_error=WHEEL_BASE_ERROR_RATIO * self.noise,
                slip_m=robot.slip_m * self.noise,
            ),
        )


def make_simulator(p: SimulatorParameters) -> Simulator:
    """Return a simulator with these parameters.

    Raises:
        UnusableInput: the plan, the start, an obstacle, a walk or a carry is unusable.
    """
    plan = load_floor_plan(p.plan, p.cell_m or None)
    start, obstacle_events = parse_start(p.start, plan), parse_obstacles(p.obstacles)
    return Simulator(
        plan, start, p.seed, p.options(), obstacle_events, p.people,
        carries=parse_carries(p.carries), walks=parse_walks(p.walks),
    )


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
    for one in [] if text == NONE else text.split(';'):
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


def parse_walks(text: str) -> list[Walk]:
    """Parse `x,y,x,y,...,from_s,to_s;...` or `none` into walks.

    Raises:
        UnusableInput: the text has another form, or a person goes before coming.
    """
    walks: list[Walk] = []
    for one in [] if text == NONE else text.split(';'):
        numbers = _numbers(one.split(','))
        if numbers is None or len(numbers) < 3:
            raise UnusableInput(
                f'a walk is {one!r}; expected x,y,x,y,...,from_s,to_s such as '
                '7.2,4.9,12,4.9,600,900'
            )
        to_s = numbers.pop() if len(numbers) % 2 == 0 else math.inf
        from_s = numbers.pop()
        if to_s <= from_s:
            raise UnusableInput(
                f'the person of the walk {one!r} goes at {to_s:g} s, before coming at {from_s:g} s'
            )
        walks.append(Walk(list(zip(numbers[::2], numbers[1::2], strict=True)), from_s, to_s))
    return walks


def parse_carries(text: str) -> list[tuple[float, Pose]]:
    """Parse `x,y,degrees,at_s;...` or `none` into times in s and poses.

    Raises:
        UnusableInput: the text has another form.
    """
    carries: list[tuple[float, Pose]] = []
    for one in [] if text == NONE else text.split(';'):
        numbers = _numbers(one.split(','))
        if numbers is None or len(numbers) != 4:
            raise UnusableInput(
                f'a carry is {one!r}; expected x,y,degrees,at_s such as 7.2,4.9,90,600'
            )
        x_m, y_m, degrees, at_s = numbers
        carries.append((at_s, Pose(x_m, y_m, math.radians(degrees))))
    return carries


def _numbers(texts: Sequence[str]) -> list[float] | None:
    try:
        numbers = [float(text) for text in texts]
    except ValueError:
        return None
    return numbers if all(math.isfinite(number) for number in numbers) else None
