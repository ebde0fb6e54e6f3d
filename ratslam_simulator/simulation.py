# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated robot in its world: moves, senses and collides in fixed time steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_simulator.bodies import fits, slide
from ratslam_simulator.camera import Camera, CameraOptions
from ratslam_simulator.floor_plan import FloorPlan
from ratslam_simulator.laser import Laser, LaserOptions
from ratslam_simulator.light import LightDrift
from ratslam_simulator.people import People, Walk
from ratslam_simulator.random_streams import RandomStreams
from ratslam_simulator.robot import Robot, RobotOptions, WheelOdometry
from ratslam_simulator.samples import (
    ImageSample,
    OdometrySample,
    Sample,
    ScanSample,
    SonarSample,
)
from ratslam_simulator.sonar import SonarOptions, Sonars
from ratslam_simulator.world import PERSON_RADIUS_M, WorldOptions, build_world

START_STAMP_NS = 1_767_225_600 * 10**9
"""Stamp of the first step, 2026-01-01: a fixed date, so that runs are reproducible."""

STEPS_PER_S = 40
"""Simulation steps per second of simulated time."""

STEP_NS = 10**9 // STEPS_PER_S
"""Duration of a simulation step, in ns."""

ODOMETRY_STEPS = 2
"""Simulation steps per odometry sample, which makes odometry 20 Hz."""

TOUCH_STEPS = STEPS_PER_S // 2
"""Steps without contact after which the next contact counts as a new collision.

A robot that scrapes along a wall thereby collides once.
"""


@dataclass(frozen=True)
class SimulationOptions:
    """Properties of the world, the robot and its sensors.

    camera, laser, rear_laser, sonars: None if the robot has none
    """

    world: WorldOptions = field(default_factory=WorldOptions)
    camera: CameraOptions | None = field(default_factory=CameraOptions)
    laser: LaserOptions | None = field(default_factory=LaserOptions)
    robot: RobotOptions = field(default_factory=RobotOptions)
    rear_laser: LaserOptions | None = None
    sonars: SonarOptions | None = None

    @property
    def lasers(self) -> list[LaserOptions]:
        """Lasers in the order of their numbers."""
        return [laser for laser in (self.laser, self.rear_laser) if laser is not None]


@dataclass(frozen=True)
class ObstacleEvent:
    """An obstacle that is added or removed at a given time after the start; lengths in metres.

    action: 'add' or 'remove'; x_m, y_m: centre of the obstacle; width_m along x, depth_m along y
    """

    at_s: float
    action: str
    name: str
    x_m: float = 0.0
    y_m: float = 0.0
    width_m: float = 0.0
    depth_m: float = 0.0

    def __post_init__(self) -> None:
        if self.action not in ('add', 'remove'):
            raise UnusableInput(
                f'the action of an obstacle event is {self.action!r}; expected "add" or "remove"'
            )


class Simulator:
    """A robot in a world, advanced in steps of STEP_NS under velocity commands.

    The same seed, commands and obstacle events give the same samples.

    Attributes:
        plan: the floor without obstacles.
        world: the present state of everything that sensors can see.
        collisions: number of times the robot has started to touch something.
        odometer_m: true distance driven, in metres.
        watchers: functions called with every sample before `step` returns it.
    """

    def __init__(
        self,
        plan: FloorPlan,
        start: Pose,
        seed: int,
        options: SimulationOptions | None = None,
        obstacle_events: Sequence[ObstacleEvent] = (),
        people: int = 0,
        appearance_seed: int | None = None,
        carries: Sequence[tuple[float, Pose]] = (),
        walks: Sequence[Walk] = (),
    ) -> None:
        """Build the world, and place the robot and the people who walk about in it.

        Args:
            plan: floor plan.
            start: pose at which the robot starts.
            seed: seed of the world and of all noise.
            options: world, robot and sensors; None for the defaults.
            obstacle_events: obstacles to add and remove during the run, in any order.
            people: number of people who walk about at random.
            appearance_seed: seed of the appearance of the walls, to return to a world on another
                day; None: `seed`.
            carries: times in s at which the robot is carried, and the poses to which it is.
            walks: people who come, stand or walk along points, and go, in any order.

        Raises:
            UnusableInput: the robot does not fit at its start or where it is carried to, or the
                people do not all fit.
            UnusableParameter: a sensor's rate is above the step rate or below 1.
        """
        options = options or SimulationOptions()
        streams = RandomStreams.from_seed(seed)
        self.options = options
        self.plan = plan
        decoration = streams.decoration
        if appearance_seed is not None:
            decoration = RandomStreams.from_seed(appearance_seed).decoration
        self.world = build_world(plan, decoration, options.world)
        self._robot = Robot(start, streams.wheel_slip, options.robot)
        self._require_room(start)
        self._odometry = WheelOdometry(options.robot)
        self._camera = None
        if options.camera is not None:
            _check_rate('camera', 'images', options.camera.rate_hz)
            self._camera = Camera(self.world, streams.camera, options.camera)
        rngs = streams.laser, streams.rear_laser
        self._lasers = []
        for laser, rng in zip(options.lasers, rngs, strict=False):
            _check_rate('laser', 'scans', laser.rate_hz)
            self._lasers.append((laser.rate_hz, Laser(self.world, rng, laser)))
        self._sonars = None
        if options.sonars is not None:
            _check_rate('sonar', 'ranges', options.sonars.rate_hz)
            self._sonars = Sonars(self.world, streams.sonars, options.sonars)
        self._people = People(
            self.world, people, streams.people, start, options.robot.body_radius_m
        )
        self._light = LightDrift(self.world, streams.light, options.world.light_change)
        # Latest first: the next event is popped from the end.
        self._obstacle_events = sorted(
            obstacle_events, key=lambda event: event.at_s, reverse=True
        )
        self._carries = sorted(carries, reverse=True)
        self._walks = sorted(walks, key=lambda walk: walk.from_s, reverse=True)
        # Walls do not change: what does not fit between them is refused before the simulation.
        for _, pose in self._carries:
            self._require_room(pose)
        for walk in self._walks:
            self._people.check(walk)
        self._step = 0
        self._command = (0.0, 0.0)
        self._touched_step = -TOUCH_STEPS
        self.collisions = 0
        self.odometer_m = 0.0
        self.watchers: list[Callable[[Sample], None]] = []

    @property
    def stamp_ns(self) -> int:
        """Stamp of the coming step, in ns."""
        return START_STAMP_NS + self._step * STEP_NS

    @property
    def elapsed_s(self) -> float:
        """Simulated time since the start, in seconds."""
        return self._step / STEPS_PER_S

    @property
    def truth(self) -> Pose:
        """True pose of the robot."""
        return self._robot.pose

    @property
    def odometry_due(self) -> bool:
        """Whether the coming step samples odometry and applies a new command."""
        return self._step % ODOMETRY_STEPS == 0

    def command(self, speed_mps: float, turn_rate_radps: float) -> None:
        """Set the target speeds of the motors, which hold until the next command.

        Raises:
            UnusableInput: a speed is not finite.
        """
        if not (math.isfinite(speed_mps) and math.isfinite(turn_rate_radps)):
            raise UnusableInput(
                f'the command is {speed_mps} m/s and {turn_rate_radps} rad/s; '
                'expected finite speeds'
            )
        self._command = (speed_mps, turn_rate_radps)

    def step(self) -> list[Sample]:
        """Sample the sensors that are due, then advance by STEP_NS.

        Returns:
            The samples of this step: odometry, then the scans, the sonars and the image.
        """
        while self._obstacle_events and self._obstacle_events[-1].at_s <= self.elapsed_s:
            self._apply(self._obstacle_events.pop())
        while self._carries and self._carries[-1][0] <= self.elapsed_s:
            self.carry(self._carries.pop()[1])
        while self._walks and self._walks[-1].from_s <= self.elapsed_s:
            self.add_person(self._walks.pop())
        self._people.remove_until(self.elapsed_s)
        if self.options.world.light_change > 0.0 and self._step % STEPS_PER_S == 0:
            self._light.update(self.elapsed_s)
        samples = self._sense()
        for watch in self.watchers:
            for sample in samples:
                watch(sample)
        self._move()
        self._step += 1
        return samples

    def carry(self, pose: Pose) -> None:
        """Move the robot to another pose without turning its wheels (a kidnapped robot).

        Raises:
            UnusableInput: the robot does not fit there.
        """
        self._require_room(pose)
        self._robot.pose = pose
        self._people.make_way(pose)

    def add_person(self, walk: Walk) -> None:
        """Let a person come now, and go when the walk ends.

        Raises:
            UnusableInput: a person does not fit at one of the points.
        """
        self._people.add(walk, self.truth)

    def add_obstacle(
        self, name: str, x_m: float, y_m: float, width_m: float, depth_m: float
    ) -> None:
        """Fill the free cells whose centres lie in a rectangle.

        Args:
            name: name by which the obstacle can be removed.
            x_m, y_m: centre of the rectangle.
            width_m, depth_m: its extent along x and y.

        Raises:
            UnusableInput: it overlaps the robot, covers no free cell, or its name is taken.
        """
        cells = self.world.obstacle_cells(x_m, y_m, width_m, depth_m)
        box = np.zeros_like(self.world.solid)
        box[tuple(cells.T)] = True
        robot, radius_m = self.truth, self.options.robot.body_radius_m
        if not fits(box, self.plan.cell_m, robot.x_m, robot.y_m, radius_m):
            raise UnusableInput(
                f'the obstacle {name!r} would stand on the robot at ({robot.x_m:.2f}, '
                f'{robot.y_m:.2f}): place it elsewhere or when the robot has left'
            )
        self.world.add_obstacle(name, cells)
        self._floor_changed()

    def remove_obstacle(self, name: str) -> None:
        """Remove an obstacle by its name.

        Raises:
            UnusableInput: there is no obstacle of this name.
        """
        self.world.remove_obstacle(name)
        self._floor_changed()

    def _floor_changed(self) -> None:
        self._people.make_way(self.truth)
        self._people.floor_changed()

    def _apply(self, event: ObstacleEvent) -> None:
        if event.action == 'add':
            self.add_obstacle(event.name, event.x_m, event.y_m, event.width_m, event.depth_m)
        else:
            self.remove_obstacle(event.name)

    def _sense(self) -> list[Sample]:
        samples: list[Sample] = []
        stamp_ns, truth = self.stamp_ns, self.truth
        if self.odometry_due:
            counts = self._robot.encoder_counts()
            odometry = self._odometry.update(counts, ODOMETRY_STEPS / STEPS_PER_S)
            samples.append(OdometrySample(stamp_ns, odometry, truth))
        for number, (rate_hz, laser) in enumerate(self._lasers):
            if self._is_due(rate_hz):
                samples.append(ScanSample(stamp_ns, laser.scan(*truth), truth, number))
        sonars = self.options.sonars
        if self._sonars is not None and sonars is not None and self._is_due(sonars.rate_hz):
            samples.append(SonarSample(stamp_ns, self._sonars.ranges_m(truth), truth))
        camera = self.options.camera
        if self._camera is not None and camera is not None and self._is_due(camera.rate_hz):
            samples.append(ImageSample(stamp_ns, self._camera.take(*truth), truth))
        return samples

    def _is_due(self, rate_hz: int) -> bool:
        """Return whether a sensor samples at this step, the first one after each period."""
        return self._step * rate_hz % STEPS_PER_S < rate_hz

    def _move(self) -> None:
        robot, world = self._robot, self.world
        if self.odometry_due:
            # Speeds are constant between two odometry samples, so that each covers an exact arc.
            robot.command(*self._command, ODOMETRY_STEPS / STEPS_PER_S)
        before = robot.pose
        robot.move(1 / STEPS_PER_S)
        wanted = robot.pose
        x_m, y_m, touched = slide(
            world.solid,
            self.plan.cell_m,
            world.people,
            PERSON_RADIUS_M,
            before.x_m,
            before.y_m,
            wanted.x_m,
            wanted.y_m,
            self.options.robot.body_radius_m,
        )
        if touched:
            # The wheels have turned by the full step: in contact they slip.
            robot.pose = Pose(x_m, y_m, wanted.heading_rad)
            if self._step - self._touched_step >= TOUCH_STEPS:
                self.collisions += 1
            self._touched_step = self._step
        self.odometer_m += math.hypot(x_m - before.x_m, y_m - before.y_m)
        if len(world.people):
            self._people.walk(robot.pose, 1 / STEPS_PER_S)

    def _require_room(self, pose: Pose) -> None:
        radius_m = self.options.robot.body_radius_m
        self.world.require_room('a robot', pose.x_m, pose.y_m, radius_m)


def _check_rate(sensor: str, what: str, rate_hz: int) -> None:
    if not 1 <= rate_hz <= STEPS_PER_S:
        raise UnusableParameter(
            f'a simulated {sensor} cannot take {rate_hz} {what} a second: '
            f'choose a whole number from 1 to {STEPS_PER_S}'
        )
