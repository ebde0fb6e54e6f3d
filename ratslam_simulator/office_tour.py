# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The demo's run: a tour of the built-in office along a fixed sequence of places."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from ratslam_simulator.drive import DriveOptions, Driver, path_length_m
from ratslam_simulator.floor_plan import FloorPlan, office
from ratslam_simulator.random_streams import RandomStreams
from ratslam_simulator.samples import ImageSample, OdometrySample, ScanSample, SonarSample
from ratslam_simulator.simulation import ODOMETRY_STEPS, STEPS_PER_S, SimulationOptions, Simulator

START = 'E'
"""Place of the office where the tour starts."""

CIRCUIT = 'BCDAEFDAE'
"""Places of one circuit: once round the building, then once round its left wing.

Both loops are driven counter-clockwise, because a forward-looking camera recognises a place only
in the direction in which it was learned.
"""

CIRCUITS_COUNT = 3
"""Circuits in a tour of unlimited duration."""

FINAL_REST_S = 1.0
"""Time for which the robot stands still at the end of the tour."""


class OfficeTour:
    """A simulated tour of the office, which yields its samples and can be iterated over once.

    The same seed gives the same samples on every machine.

    Attributes:
        plan: the floor plan of the office.
        world: the decorated office that the camera sees.
    """

    def __init__(
        self,
        seed: int,
        duration_s: float | None = None,
        options: SimulationOptions | None = None,
    ) -> None:
        """Prepare the tour.

        Args:
            seed: seed of the world, the driver and all noise.
            duration_s: simulated time; None drives the whole tour, about seven minutes.
            options: robot, camera and world; the laser is left out.
        """
        self._duration_s = duration_s
        self.plan = office()
        drive = DriveOptions()
        waypoints = _waypoints(self.plan, duration_s, drive.speed_mps)
        self._driver = Driver(waypoints, RandomStreams.from_seed(seed).driving, drive)
        # The driver steers by the true pose and needs no laser.
        options = replace(options or SimulationOptions(), laser=None, rear_laser=None)
        self._simulator = Simulator(self.plan, self._driver.start, seed, options)
        self.world = self._simulator.world

    @property
    def elapsed_s(self) -> float:
        """Simulated time in s."""
        return self._simulator.elapsed_s

    def __iter__(self) -> Iterator[OdometrySample | ImageSample]:
        """Yield samples in stamp order, odometry before an image of the same stamp."""
        simulator, driver, rest_steps = self._simulator, self._driver, 0
        while rest_steps <= FINAL_REST_S * STEPS_PER_S:
            if self._duration_s is not None and simulator.elapsed_s > self._duration_s:
                return
            if simulator.odometry_due:
                period_s = ODOMETRY_STEPS / STEPS_PER_S
                simulator.command(*driver.command(simulator.truth, period_s))
            for sample in simulator.step():
                if not isinstance(sample, ScanSample | SonarSample):
                    yield sample
            rest_steps = rest_steps + 1 if driver.finished else 0


def usual_duration_s() -> float:
    """Return about how long a whole tour takes, by its length."""
    speed_mps = DriveOptions().speed_mps
    return path_length_m(_waypoints(office(), None, speed_mps)) / speed_mps


def _waypoints(
    plan: FloorPlan, duration_s: float | None, speed_mps: float
) -> list[tuple[float, float]]:
    """Return the places to drive past, enough of them for the whole duration."""
    circuits = CIRCUITS_COUNT
    if duration_s is not None:
        first_circuit = [plan.places[name] for name in START + CIRCUIT]
        circuits = 1 + int(duration_s * speed_mps / path_length_m(first_circuit))
    return [plan.places[name] for name in START + CIRCUIT * circuits]
