# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Laser scanner of the simulated robot: ranges to walls, obstacles and people."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_simulator.rays import cast, cast_at_discs
from ratslam_simulator.world import PERSON_RADIUS_M, World

CENTRED = Pose(0.0, 0.0, 0.0)
"""Mount of a laser at the centre of the robot that looks ahead."""


@dataclass(frozen=True)
class LaserOptions:
    """Properties of a laser; beams run from right to left of where it looks.

    noise_m: standard deviation of a range. mount: its pose on the robot.
    """

    beams: int = 181
    fov_deg: float = 180.0
    range_max_m: float = 8.0
    noise_m: float = 0.01
    rate_hz: int = 10
    mount: Pose = CENTRED

    @property
    def first_rad(self) -> float:
        """Direction of the first beam in the frame of the laser, counter-clockwise positive."""
        return -math.radians(self.fov_deg) / 2

    @property
    def step_rad(self) -> float:
        """Angle between neighbouring beams, in rad."""
        return math.radians(self.fov_deg) / (self.beams - 1)


class Laser:
    """Scans a world, with Gaussian range noise."""

    def __init__(self, world: World, rng: np.random.Generator, options: LaserOptions) -> None:
        self._world = world
        self._rng = rng
        self._options = options

    def scan(self, x_m: float, y_m: float, heading_rad: float) -> NDArray[np.float32]:
        """Scan from a pose of the robot at which the laser is in a free cell.

        Returns:
            (beams,) float32 ranges in metres, inf beyond the maximum range.
        """
        options, world = self._options, self._world
        if options.mount != CENTRED:
            x_m, y_m, heading_rad = composed(Pose(x_m, y_m, heading_rad), options.mount)
        ranges_m = options.noise_m * self._rng.standard_normal(options.beams)
        _scan(
            world.solid,
            world.plan.cell_m,
            world.people,
            x_m,
            y_m,
            heading_rad + options.first_rad,
            options.step_rad,
            options.range_max_m,
            ranges_m,
        )
        return ranges_m.astype(np.float32)


@njit(cache=True)
def _scan(  # type: ignore[no-untyped-def]
    solid, cell_m, people, x_m, y_m, first_rad, step_rad, range_max_m, ranges_m,
):
    """Add the true ranges to `ranges_m`, which holds the noise."""
    for beam in range(len(ranges_m)):
        direction_rad = first_rad + beam * step_rad
        ray_x, ray_y = math.cos(direction_rad), math.sin(direction_rad)
        wall_m, _, _, _ = cast(solid, cell_m, x_m, y_m, ray_x, ray_y)
        person_m, _ = cast_at_discs(people, PERSON_RADIUS_M, x_m, y_m, ray_x, ray_y)
        distance_m = max(min(wall_m, person_m) + ranges_m[beam], 0.0)
        ranges_m[beam] = distance_m if distance_m <= range_max_m else math.inf
