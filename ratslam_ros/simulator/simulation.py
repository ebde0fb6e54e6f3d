# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The simulator: world, robot and sensors in lock-step; and the demo's tour of the office."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.odometry import Pose
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.simulator.bodies import fits, slide
from ratslam_ros.simulator.camera import Camera, CameraOptions
from ratslam_ros.simulator.drive import DriveOptions, Driver, path_length_m
from ratslam_ros.simulator.floor_plan import OFFICE_CIRCUIT, OFFICE_START, FloorPlan, office
from ratslam_ros.simulator.laser import Laser, LaserOptions
from ratslam_ros.simulator.light import LightDrift
from ratslam_ros.simulator.people import People
from ratslam_ros.simulator.robot import OdometryReading, Robot, RobotOptions, WheelOdometry
from ratslam_ros.simulator.world import PERSON_RADIUS_M, WorldOptions, build_world

# A fixed date (2026-01-01): a run must not depend on when it was made.
START_STAMP_NS = 1_767_225_600 * 10**9
# The robot moves in steps of 25 ms: odometry is 20 Hz, a camera any whole number of steps.
STEPS_PER_S = 40
STEP_NS = 10**9 // STEPS_PER_S
ODOMETRY_STEPS = 2
# How long the robot stays at rest at the end of its tour.
LAST_REST_S = 1.0
# A robot that scrapes along a wall touches it once: what counts is to begin anew after half a
# second without.
TOUCH_STEPS = STEPS_PER_S // 2


@dataclass(frozen=True)
class SimulationOptions:
    """Everything about a run but its seed.

    circuits: how often the tour of the office is driven, unless a duration is asked for
    camera, laser: None where the robot has none
    """

    circuits: int = 3
    world: WorldOptions = field(default_factory=WorldOptions)
    camera: CameraOptions | None = field(default_factory=CameraOptions)
    laser: LaserOptions | None = field(default_factory=LaserOptions)
    robot: RobotOptions = field(default_factory=RobotOptions)
    drive: DriveOptions = field(default_factory=DriveOptions)


@dataclass(frozen=True)
class OdometrySample:
    """A report of the wheel odometry, with the truth at the same stamp."""

    stamp_ns: int
    odometry: OdometryReading
    truth: Pose


@dataclass(frozen=True)
class ScanSample:
    """Distances from right to left, (beams,) float32 metres, infinite where there is nothing."""

    stamp_ns: int
    ranges_m: NDArray[np.float32]
    truth: Pose


@dataclass(frozen=True)
class ImageSample:
    """A picture, (height, width) uint8, and the pose it was taken from."""

    stamp_ns: int
    image: NDArray[np.uint8]
    truth: Pose


Sample = OdometrySample | ScanSample | ImageSample


@dataclass(frozen=True)
class Happening:
    """An obstacle that is put up or taken away so long after the start; all lengths in metres.

    what: 'put' or 'take'; x_m, y_m: the middle; width_m along x, depth_m along y
    """

    at_s: float
    what: str
    name: str
    x_m: float = 0.0
    y_m: float = 0.0
    width_m: float = 0.0
    depth_m: float = 0.0

    def __post_init__(self) -> None:
        if self.what not in ('put', 'take'):
            raise UnusableInput(
                f'what happens to an obstacle is "put" or "take", not {self.what!r}'
            )


class Simulator:
    """A robot in a world, moved on step by step by whoever commands it.

    The same seed, commands and happenings give the same samples. Raises UnusableInput where the
    robot would stand inside something or there is no room for so many people, UnusableParameter
    for a sensor's rate that does not fit the steps.

    plan: the floor without obstacles; world: what is to be seen at the moment
    collisions: how often the robot has begun to touch something
    odometer_m: how far it has really come
    watchers: called with every sample, before whoever makes the steps gets it
    """

    def __init__(
        self,
        plan: FloorPlan,
        start: Pose,
        seed: int,
        options: SimulationOptions | None = None,
        happenings: Sequence[Happening] = (),
        people: int = 0,
    ) -> None:
        options = options or SimulationOptions()
        streams = _Streams.of(seed)
        self.options = options
        self.plan = plan
        self.world = build_world(plan, streams.decorating, options.world)
        self._robot = Robot(start, streams.slipping, options.robot)
        self._require_room(start)
        self._odometry = WheelOdometry(options.robot)
        self._camera = self._laser = None
        if options.camera is not None:
            self._camera_steps = _steps_between('camera', 'images', options.camera.rate_hz)
            self._camera = Camera(self.world, streams.filming, options.camera)
        if options.laser is not None:
            self._laser_steps = _steps_between('laser', 'scans', options.laser.rate_hz)
            self._laser = Laser(self.world, streams.scanning, options.laser)
        self._people = None
        if people:
            radius_m = options.robot.body_radius_m
            self._people = People(self.world, people, streams.walking, start, radius_m)
        self._light = LightDrift(self.world, streams.lighting, options.world.light_change)
        self._happenings = sorted(happenings, key=lambda happening: happening.at_s, reverse=True)
        self._step = 0
        self._command = (0.0, 0.0)
        self._touched_step = -TOUCH_STEPS
        self.collisions = 0
        self.odometer_m = 0.0
        self.watchers: list[Callable[[Sample], None]] = []

    @property
    def stamp_ns(self) -> int:
        """The present."""
        return START_STAMP_NS + self._step * STEP_NS

    @property
    def elapsed_s(self) -> float:
        """Time since the start."""
        return self._step / STEPS_PER_S

    @property
    def truth(self) -> Pose:
        """Where the robot is."""
        return self._robot.pose

    @property
    def odometry_due(self) -> bool:
        """Whether the coming step reports odometry, and takes up a new command."""
        return self._step % ODOMETRY_STEPS == 0

    def command(self, speed_mps: float, turn_rate_radps: float) -> None:
        """Set the speeds that the motors try to reach, until the next command."""
        if not (math.isfinite(speed_mps) and math.isfinite(turn_rate_radps)):
            raise UnusableInput(
                f'a robot cannot drive at {speed_mps} m/s and {turn_rate_radps} rad/s: '
                'command finite speeds'
            )
        self._command = (speed_mps, turn_rate_radps)

    def step(self) -> list[Sample]:
        """Sense what is due at the present stamp, then move on by STEP_NS.

        Returns odometry before a scan before an image
        """
        while self._happenings and self._happenings[-1].at_s <= self.elapsed_s:
            self._happen(self._happenings.pop())
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
        """Lift the robot and set it down elsewhere, which its wheels do not notice."""
        self._require_room(pose)
        self._robot.pose = pose
        if self._people is not None:
            self._people.make_way(pose)

    def put_obstacle(
        self, name: str, x_m: float, y_m: float, width_m: float, depth_m: float
    ) -> None:
        """Put a box around x, y, as wide along x and deep along y as the free cells there allow.

        Raises UnusableInput where it would stand on the robot or on no free cell at all, or where
        there is another of its name
        """
        cells = self.world.obstacle_cells(x_m, y_m, width_m, depth_m)
        box = np.zeros_like(self.world.solid)
        box[tuple(cells.T)] = True
        at, radius_m = self.truth, self.options.robot.body_radius_m
        if not fits(box, self.plan.cell_m, at.x_m, at.y_m, radius_m):
            raise UnusableInput(
                f'the obstacle {name!r} would stand on the robot at ({at.x_m:.2f}, {at.y_m:.2f}): '
                'put it elsewhere or when the robot has left'
            )
        self.world.put(name, cells)
        self._floor_changed()

    def take_obstacle(self, name: str) -> None:
        """Take an obstacle away; raises UnusableInput where there is none of this name."""
        self.world.take(name)
        self._floor_changed()

    def _floor_changed(self) -> None:
        if self._people is not None:
            self._people.make_way(self.truth)
            self._people.floor_changed()

    def _happen(self, happening: Happening) -> None:
        if happening.what == 'put':
            self.put_obstacle(
                happening.name,
                happening.x_m,
                happening.y_m,
                happening.width_m,
                happening.depth_m,
            )
        else:
            self.take_obstacle(happening.name)

    def _sense(self) -> list[Sample]:
        samples: list[Sample] = []
        stamp_ns, truth = self.stamp_ns, self.truth
        if self.odometry_due:
            counts = self._robot.encoder_counts()
            odometry = self._odometry.update(counts, ODOMETRY_STEPS / STEPS_PER_S)
            samples.append(OdometrySample(stamp_ns, odometry, truth))
        if self._laser is not None and self._step % self._laser_steps == 0:
            samples.append(ScanSample(stamp_ns, self._laser.take(*truth), truth))
        if self._camera is not None and self._step % self._camera_steps == 0:
            samples.append(ImageSample(stamp_ns, self._camera.take(*truth), truth))
        return samples

    def _move(self) -> None:
        robot, world = self._robot, self.world
        if self.odometry_due:
            # Speeds hold between two reports, so that a report is an exact arc.
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
            # The wheels have turned all the same: on the floor, they slip.
            robot.pose = Pose(x_m, y_m, wanted.heading_rad)
            if self._step - self._touched_step >= TOUCH_STEPS:
                self.collisions += 1
            self._touched_step = self._step
        self.odometer_m += math.hypot(x_m - before.x_m, y_m - before.y_m)
        if self._people is not None:
            self._people.walk(robot.pose, 1 / STEPS_PER_S)

    def _require_room(self, pose: Pose) -> None:
        world, radius_m = self.world, self.options.robot.body_radius_m
        width_m, depth_m = self.plan.size_m
        inside = 0.0 < pose.x_m < width_m and 0.0 < pose.y_m < depth_m
        if not inside or not fits(
            world.solid, self.plan.cell_m, pose.x_m, pose.y_m, radius_m
        ):
            raise UnusableInput(
                f'a robot of radius {radius_m:g} m does not fit at ({pose.x_m:g}, {pose.y_m:g}) '
                f'on a floor of {width_m:g} x {depth_m:g} m: choose a free place'
            )


@dataclass(frozen=True)
class _Streams:
    """Randomness, a stream for each use: how a robot slips must not change what walls look like.

    New ones come last, which leaves the others as they are.
    """

    decorating: np.random.Generator
    wandering: np.random.Generator
    slipping: np.random.Generator
    filming: np.random.Generator
    scanning: np.random.Generator
    walking: np.random.Generator
    lighting: np.random.Generator

    @classmethod
    def of(cls, seed: int) -> _Streams:
        return cls(*np.random.Generator(np.random.PCG64(seed)).spawn(len(fields(cls))))


def _steps_between(sensor: str, what: str, rate_hz: int) -> int:
    if rate_hz not in (1, 2, 4, 5, 8, 10, 20, 40):
        raise UnusableParameter(
            f'a simulated {sensor} cannot take {rate_hz} {what} a second: '
            f'choose a whole number that divides {STEPS_PER_S}'
        )
    return STEPS_PER_S // rate_hz


class Simulation:
    """The demo's run: a tour of the office, to look at its world and to iterate over once."""

    def __init__(
        self,
        seed: int,
        duration_s: float | None = None,
        options: SimulationOptions | None = None,
    ) -> None:
        options = options or SimulationOptions()
        self._duration_s = duration_s
        self.plan = office()
        self._driver = Driver(
            self._tour(duration_s, options), _Streams.of(seed).wandering, options.drive
        )
        # Somebody drives it by hand: it needs no laser.
        self._simulator = Simulator(
            self.plan, self._driver.start, seed, replace(options, laser=None)
        )
        self.world = self._simulator.world

    def _tour(
        self, duration_s: float | None, options: SimulationOptions
    ) -> list[tuple[float, float]]:
        """Name enough places to drive past for the whole duration."""
        places = self.plan.places
        circuits = options.circuits
        if duration_s is not None:
            loop = [places[name] for name in OFFICE_START + OFFICE_CIRCUIT]
            circuits = 1 + int(duration_s * options.drive.speed_mps / path_length_m(loop))
        return [places[name] for name in OFFICE_START + OFFICE_CIRCUIT * circuits]

    def __iter__(self) -> Iterator[OdometrySample | ImageSample]:
        """Yield samples in order of their stamps, odometry before an image of the same stamp."""
        simulator, driver, rest_steps = self._simulator, self._driver, 0
        while rest_steps <= LAST_REST_S * STEPS_PER_S:
            if self._duration_s is not None and simulator.elapsed_s > self._duration_s:
                return
            if simulator.odometry_due:
                period_s = ODOMETRY_STEPS / STEPS_PER_S
                simulator.command(*driver.command(simulator.truth, period_s))
            for sample in simulator.step():
                if not isinstance(sample, ScanSample):
                    yield sample
            rest_steps = rest_steps + 1 if driver.finished else 0


def simulate(
    seed: int, duration_s: float | None = None, options: SimulationOptions | None = None
) -> Iterator[OdometrySample | ImageSample]:
    """Yield the samples of a run: the same seed gives the same samples, whatever the machine does.

    duration_s: robot time; None drives the whole tour, about seven minutes
    """
    return iter(Simulation(seed, duration_s, options))
