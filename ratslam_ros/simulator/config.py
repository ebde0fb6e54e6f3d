# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of a simulated robot, and the simulator that they make."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter
from ratslam_ros.errors import UnusableInput
from ratslam_ros.simulator.camera import CameraOptions
from ratslam_ros.simulator.floor_plan import FloorPlan, load_floor_plan
from ratslam_ros.simulator.laser import LaserOptions
from ratslam_ros.simulator.robot import Pose, RobotOptions
from ratslam_ros.simulator.simulation import Happening, SimulationOptions, Simulator
from ratslam_ros.simulator.world import WorldOptions

NONE = 'none'
ANY_PLACE = 'any'
USUAL_START = 'S'

VARIETY = 4
"""Sets of wall panels: a floor of 1000 square metres has more to show than the demo's."""

WHEEL_BASE_ERROR = 0.01
"""Of a robot whose turns were once compared with the floor; the demo's was not."""


@dataclass(frozen=True)
class SimulatorParameters(Section):
    """A robot in a floor plan: `ratslam simulate`, and the node that takes a robot's place."""

    plan: str = parameter(
        'university_floor', '', 0, 0,
        'Floor plan: the name of one that comes with the package, or a text or PNG file.',
        'set to a plan of your own building', 'leave as it is to try things out')  # fmt: skip
    cell_m: float = parameter(
        0.0, 'm; 0: as the plan says', 0.0, 100.0,
        'Side of a cell: of a pixel, where the plan is a picture.',
        'rooms come out too small', 'rooms come out too large')  # fmt: skip
    start: str = parameter(
        ANY_PLACE, '', 0, 0,
        'Where the robot starts: a place of the plan, `x,y,degrees`, or `any`: S, or the first '
        'place that the plan names.',
        'set to begin elsewhere', 'leave as it is where the plan has a place S')  # fmt: skip
    seed: int = parameter(
        1, '', 0, 2**31 - 1, 'Of what walls look like, and of all noise.',
        'you want another world', 'you want the same world again')  # fmt: skip
    people: int = parameter(
        0, '', 0, 1000, 'How many people walk about.',
        'it should be harder', 'the robot waits for people too often')  # fmt: skip
    obstacles: str = parameter(
        NONE, '', 0, 0,
        'What is put up and taken away: `name,x,y,width,depth,from_s,to_s`, several of them '
        'with semicolons between; without `to_s` it stays.',
        'set to close a door for a while', 'leave as it is where nothing changes')  # fmt: skip
    noise: float = parameter(
        1.0, 'times', 0.0, 100.0,
        'Noise of wheels, camera and laser, against those of a Pioneer.',
        'it should be harder', 'errors should be told apart from noise')  # fmt: skip
    aliasing: float = parameter(
        0.2, '', 0.0, 1.0, 'Share of the corners that look alike, wherever they are.',
        'it should be harder', 'places should be easy to tell apart')  # fmt: skip
    light_change: float = parameter(
        0.1, 'share', 0.0, 1.0, 'How much the light changes with time.',
        'it should be harder', 'places should look the same at any time')  # fmt: skip
    camera_width: int = parameter(
        80, 'px', 8, 4096, 'Width of images.',
        'you want to look at them', 'simulating is too slow')  # fmt: skip
    camera_height: int = parameter(
        60, 'px', 8, 4096, 'Height of images.',
        'you want to look at them', 'simulating is too slow')  # fmt: skip
    camera_rate_hz: int = parameter(
        4, 'Hz; a divisor of 40', 1, 40, 'Images a second.',
        'the robot is fast', 'simulating is too slow')  # fmt: skip
    rate: float = parameter(
        1.0, 'times real time', 0.01, 100.0,
        'Live only: speed of time; lower than this where the machine is too slow.',
        'you do not want to wait', 'the nodes cannot keep up')  # fmt: skip
    cmd_timeout_s: float = parameter(
        1.0, 's', 0.05, 3600.0,
        'Live only: without cmd_vel for this long (on the wall) the motors stop.',
        'whatever drives it is slow', 'it should stop sooner')  # fmt: skip

    def options(self) -> SimulationOptions:
        """Return what the simulator takes of them."""
        robot, camera, laser = RobotOptions(), CameraOptions(), LaserOptions()
        return SimulationOptions(
            world=WorldOptions(
                aliasing=self.aliasing, light_change=self.light_change, variety=VARIETY
            ),
            camera=CameraOptions(
                width=self.camera_width, height=self.camera_height, rate_hz=self.camera_rate_hz,
                noise_grey=camera.noise_grey * self.noise,
                exposure_spread=camera.exposure_spread * self.noise,
            ),
            laser=LaserOptions(noise_m=laser.noise_m * self.noise),
            robot=RobotOptions(
                wheel_radius_error=robot.wheel_radius_error * self.noise,
                wheel_base_error=WHEEL_BASE_ERROR * self.noise,
                slip_m=robot.slip_m * self.noise,
            ),
        )  # fmt: skip


def make_simulator(p: SimulatorParameters, happenings: Sequence[Happening] = ()) -> Simulator:
    """Return the simulator that is asked for; ``happenings`` besides the obstacles.

    Raises:
        UnusableInput: there is no such plan, start or obstacle.
        UnusableParameter: the camera's rate does not fit.
    """
    plan = load_floor_plan(p.plan, p.cell_m or None)
    return Simulator(
        plan, start_of(p.start, plan), p.seed, p.options(),
        [*obstacles_of(p.obstacles), *happenings], p.people,
    )  # fmt: skip


def start_of(text: str, plan: FloorPlan) -> Pose:
    """Return where to start: a place of the plan, `x,y,degrees`, or any place.

    Raises:
        UnusableInput: it is neither.
    """
    places = plan.places
    if text == ANY_PLACE and places:
        text = USUAL_START if USUAL_START in places else next(iter(places))
    if text in places:
        return Pose(*places[text], 0.0)
    numbers = _numbers(text.split(','))
    if numbers is None or len(numbers) != 3:
        known = f'one of the places {", ".join(places)}, or ' if places else ''
        raise UnusableInput(f'the start is {text!r}; expected {known}x,y,degrees such as 3.5,2,90')
    x_m, y_m, degrees = numbers
    return Pose(x_m, y_m, math.radians(degrees))


def obstacles_of(text: str) -> list[Happening]:
    """Return what happens to obstacles: `name,x,y,width,depth,from_s,to_s;...`, or none.

    Raises:
        UnusableInput: it is not that.
    """
    happenings: list[Happening] = []
    for one in [] if text == NONE else text.split(';'):
        name, *rest = one.split(',')
        numbers = _numbers(rest)
        if not name or numbers is None or len(numbers) not in (5, 6):
            raise UnusableInput(
                f'an obstacle is {one!r}; expected name,x,y,width,depth,from_s,to_s such as '
                'box,7.2,4.9,1,2,600,900'
            )
        x_m, y_m, width_m, depth_m, from_s = numbers[:5]
        happenings.append(Happening(from_s, 'put', name, x_m, y_m, width_m, depth_m))
        if len(numbers) == 6:
            if numbers[5] <= from_s:
                raise UnusableInput(
                    f'the obstacle {name!r} is taken away at {numbers[5]:g} s, before it is put '
                    f'up at {from_s:g} s'
                )
            happenings.append(Happening(numbers[5], 'take', name))
    return happenings


def _numbers(texts: Sequence[str]) -> list[float] | None:
    try:
        numbers = [float(text) for text in texts]
    except ValueError:
        return None
    return numbers if all(math.isfinite(number) for number in numbers) else None
