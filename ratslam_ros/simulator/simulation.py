# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One run in the simulated office: world, robot, camera and driver in lock-step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.errors import UnusableParameter
from ratslam_ros.simulator.camera import Camera, CameraOptions
from ratslam_ros.simulator.drive import DriveOptions, Driver, path_length_m
from ratslam_ros.simulator.floor_plan import OFFICE_CIRCUIT, OFFICE_START, office
from ratslam_ros.simulator.robot import Odometry, Pose, Robot, RobotOptions, WheelOdometry
from ratslam_ros.simulator.world import WorldOptions, build_world

# A fixed date (2026-01-01): a run must not depend on when it was made.
START_STAMP_NS = 1_767_225_600 * 10**9
# The robot moves in steps of 25 ms: odometry is 20 Hz, a camera any whole number of steps.
STEPS_PER_S = 40
STEP_NS = 10**9 // STEPS_PER_S
ODOMETRY_STEPS = 2
# How long the robot stays at rest at the end of its tour.
LAST_REST_S = 1.0


@dataclass(frozen=True)
class SimulationOptions:
    """Everything about a run but its seed.

    circuits: how often the tour of the office is driven, unless a duration is asked for
    """

    circuits: int = 3
    world: WorldOptions = field(default_factory=WorldOptions)
    camera: CameraOptions = field(default_factory=CameraOptions)
    robot: RobotOptions = field(default_factory=RobotOptions)
    drive: DriveOptions = field(default_factory=DriveOptions)


@dataclass(frozen=True)
class OdometrySample:
    """A report of the wheel odometry, with the truth at the same stamp."""

    stamp_ns: int
    odometry: Odometry
    truth: Pose


@dataclass(frozen=True)
class ImageSample:
    """A picture, (height, width) uint8, and the pose it was taken from."""

    stamp_ns: int
    image: NDArray[np.uint8]
    truth: Pose


Sample = OdometrySample | ImageSample


class Simulation:
    """A run: its world to look at, and its samples to iterate over once."""

    def __init__(
        self,
        seed: int,
        duration_s: float | None = None,
        options: SimulationOptions | None = None,
    ) -> None:
        options = options or SimulationOptions()
        if options.camera.rate_hz not in (1, 2, 4, 5, 8, 10, 20, 40):
            raise UnusableParameter(
                f'a simulated camera cannot take {options.camera.rate_hz} images a second: '
                f'choose a whole number that divides {STEPS_PER_S}'
            )
        # Streams of their own: how the robot slips must not change what hangs on the walls.
        decorating, wandering, slipping, filming = np.random.Generator(
            np.random.PCG64(seed)
        ).spawn(4)
        self._duration_s = duration_s
        self._camera_steps = STEPS_PER_S // options.camera.rate_hz
        self.plan = office()
        self.world = build_world(self.plan, decorating, options.world)
        self._driver = Driver(self._tour(duration_s, options), wandering, options.drive)
        self._robot = Robot(self._driver.start, slipping, options.robot)
        self._odometry = WheelOdometry(options.robot)
        self._camera = Camera(self.world, filming, options.camera)

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

    def __iter__(self) -> Iterator[Sample]:
        """Yield samples in order of their stamps, odometry before an image of the same stamp."""
        step, rest_steps = 0, 0
        while rest_steps <= LAST_REST_S * STEPS_PER_S:
            if self._duration_s is not None and step > self._duration_s * STEPS_PER_S:
                return
            stamp_ns = START_STAMP_NS + step * STEP_NS
            truth = self._robot.pose
            if step % ODOMETRY_STEPS == 0:
                period_s = ODOMETRY_STEPS / STEPS_PER_S
                odometry = self._odometry.update(self._robot.encoder_counts(), period_s)
                yield OdometrySample(stamp_ns, odometry, truth)
            if step % self._camera_steps == 0:
                image = self._camera.take(truth.x_m, truth.y_m, truth.heading_rad)
                yield ImageSample(stamp_ns, image, truth)
            if step % ODOMETRY_STEPS == 0:
                # Speeds hold between two reports, so that a report is an exact arc.
                self._robot.command(*self._driver.command(truth, period_s), period_s)
            self._robot.move(1 / STEPS_PER_S)
            rest_steps = rest_steps + 1 if self._driver.finished else 0
            step += 1


def simulate(
    seed: int, duration_s: float | None = None, options: SimulationOptions | None = None
) -> Iterator[Sample]:
    """Yield the samples of a run: the same seed gives the same samples, whatever the machine does.

    duration_s: robot time; None drives the whole tour, about seven minutes
    """
    return iter(Simulation(seed, duration_s, options))
