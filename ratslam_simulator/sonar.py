# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sonars of the simulated robot: wide beams, for which smooth walls are mirrors.

Rays of each beam are followed as by Wilkes et al. (1990), with the reflectors of Kuc and Siegel
(1987): a wall returns an echo along its normal only, and reflects all other rays; corners, edges
and people return echoes to all directions. A reflected ray that meets one of these gives an echo
that comes later; otherwise the echo is lost. Amplitudes and crosstalk are not simulated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_simulator.rays import EAST, SOUTH, WEST, cast, cast_at_discs
from ratslam_simulator.world import PERSON_RADIUS_M, World

_LEFT = (0.075, 0.130, 90.0), (0.115, 0.115, 50.0), (0.150, 0.080, 30.0), (0.170, 0.025, 10.0)

PIONEER = (
    *(Pose(x_m, y_m, math.radians(degrees)) for x_m, y_m, degrees in _LEFT),
    *(Pose(x_m, -y_m, -math.radians(degrees)) for x_m, y_m, degrees in reversed(_LEFT)),
)
"""Poses on the robot of the front sonars of a Pioneer 2DX, from left to right, as in pioneer.inc
of the simulator Stage."""

RAY_STEP_RAD = math.radians(2.0)
"""Largest angle between rays of a beam: a wall returns an echo to a ray within half of it of its
normal."""

CORNER_M = 0.1
"""Distance from the end of a wall within which a ray meets the corner or edge: at 3 m, rays are as
far apart."""


@dataclass(frozen=True)
class SonarOptions:
    """Properties of a ring of sonars, all of which measure at once.

    Attributes:
        mounts: their poses on the robot.
        cone_deg: width of a beam; Moravec and Elfes (1985) give it for Polaroid's transducers.
        range_min_m, range_max_m: as for a Pioneer 3DX in pioneer.inc of Stage.
        noise_ratio: standard deviation of a range, relative to it; Moravec and Elfes (1985).
        rate_hz: a Pioneer fires a sonar every 40 ms, one after another.
    """

    mounts: tuple[Pose, ...] = PIONEER
    cone_deg: float = 30.0
    range_min_m: float = 0.1
    range_max_m: float = 5.0
    noise_ratio: float = 0.01
    rate_hz: int = 3


class Sonars:
    """Measures the nearest echoes in a world, with Gaussian range noise."""

    def __init__(self, world: World, rng: np.random.Generator, options: SonarOptions) -> None:
        self._world, self._rng, self._options = world, rng, options

    def ranges_m(self, robot: Pose) -> NDArray[np.float32]:
        """Measure from a pose of the robot.

        Returns:
            (sonars,) float32 ranges in metres, inf without an echo within the maximum range.
        """
        options, world = self._options, self._world
        cone_rad = math.radians(options.cone_deg)
        count = 1 + math.ceil(cone_rad / RAY_STEP_RAD)
        ranges_m = np.array([
            _nearest_echo_m(
                world.solid, world.plan.cell_m, world.people, *composed(robot, mount), cone_rad,
                count, options.range_max_m,
            )
            for mount in options.mounts
        ])
        ranges_m *= 1.0 + options.noise_ratio * self._rng.standard_normal(len(ranges_m))
        ranges_m[ranges_m > options.range_max_m] = math.inf
        ranges: NDArray[np.float32] = np.maximum(ranges_m, options.range_min_m).astype(np.float32)
        return ranges


@njit(cache=True)
def _nearest_echo_m(  # type: ignore[no-untyped-def]
    solid, cell_m, people, x_m, y_m, heading_rad, cone_rad, count, range_max_m,
):
    """Return the length of the shortest path to a reflector, over at most one mirror."""
    nearest_m = math.inf
    aligned = math.cos(0.5 * cone_rad / (count - 1))
    for ray in range(count):
        direction_rad = heading_rad + cone_rad * (ray / (count - 1) - 0.5)
        from_x, from_y, path_m = x_m, y_m, 0.0
        ray_x, ray_y = math.cos(direction_rad), math.sin(direction_rad)
        for _ in range(2):
            wall_m, row, column, side = cast(solid, cell_m, from_x, from_y, ray_x, ray_y)
            person_m, _ = cast_at_discs(people, PERSON_RADIUS_M, from_x, from_y, ray_x, ray_y)
            path_m += min(wall_m, person_m)
            if path_m > min(nearest_m, range_max_m):
                break
            # Slightly before the wall, so that a reflected ray starts in the free cell.
            from_x += (wall_m - 1e-6) * ray_x
            from_y += (wall_m - 1e-6) * ray_y
            is_across_x = side in (WEST, EAST)
            normal = abs(ray_x) if is_across_x else abs(ray_y)
            if person_m < wall_m or normal >= aligned or _is_corner(
                solid, cell_m, row, column, side, from_y if is_across_x else from_x
            ):
                nearest_m = path_m
                break
            if is_across_x:
                ray_x = -ray_x
            else:
                ray_y = -ray_y
    return nearest_m


@njit(cache=True)
def _is_corner(solid, cell_m, row, column, side, along_m):  # type: ignore[no-untyped-def]
    """Return whether a wall ends within CORNER_M of a place along it, at a corner or an edge."""
    is_across_x = side in (WEST, EAST)
    cell = row if is_across_x else column
    front = -1 if side in (WEST, SOUTH) else 1
    for step in (-1, 1):
        gap_m = along_m - cell * cell_m if step < 0 else (cell + 1) * cell_m - along_m
        if gap_m < CORNER_M:
            beside = (row + step, column) if is_across_x else (row, column + step)
            before = (beside[0], column + front) if is_across_x else (row + front, beside[1])
            if not solid[beside] or solid[before]:
                return True
    return False
