# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Worlds of landmarks, a vehicle that drives through them, and a sensor that observes them.

They simulate the experiments of Kahn and Mazor (2002), section V (docs/landmarks.md): bars as in
figure 1, or the walls and corners of a floor plan.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.landmarks.features import MAX_OBSERVATION_COUNT, Observations
from ratslam_ros.errors import UnusableInput
from ratslam_simulator.drive import PATH_SPACING_M, rounded_path
from ratslam_simulator.floor_plan import FloorPlan
from ratslam_simulator.rays import EAST, NORTH, SOUTH, WEST, cast
from ratslam_simulator.robot import after_arc
from ratslam_simulator.world import wall_stretches

_ALONG_RAD = {SOUTH: 0.0, EAST: math.pi / 2, NORTH: math.pi, WEST: -math.pi / 2}
"""Side of a wall -> direction from its left to its right end, as seen from that side."""

_CLEARANCE_CELLS = 0.05
"""Distance to a wall at which the line of sight to it ends, so that the wall does not block it."""

SHORTEST_WALL_M = 0.5
"""Shorter walls of a floor plan are no landmarks."""

_SUBSTEPS_COUNT = 10
"""Parts of a step of the vehicle, each with noise of its own, so that the noise of the heading
bends the path."""


@dataclass(frozen=True)
class LandmarkWorld:
    """True landmarks; the identifier of a landmark is its index.

    Attributes:
        bars: (n, 4) x and y in m, direction in rad, length in m; the length of a corner is 0.
        size_m: extents along x and y; all landmarks are within (0, 0) and these.
        plan: floor plan whose walls block the view, or None.
    """

    bars: NDArray[np.float64]
    size_m: tuple[float, float]
    plan: FloorPlan | None = None

    def __len__(self) -> int:
        """Return the number of landmarks."""
        return len(self.bars)

    def look_alike_count(self, difference_m: float) -> float:
        """Return the mean number of landmarks whose length differs by at most ``difference_m``.

        The landmark itself is included.
        """
        lengths_m = self.bars[:, 3]
        alike = np.abs(lengths_m[:, None] - lengths_m) <= difference_m
        return float(alike.sum()) / len(self)


@dataclass(frozen=True)
class BarOptions:
    """Scattered bars; the spread of their lengths determines how distinctive they are.

    count: number of bars and corners
    size_m: extents of the world. Two random places of the default differ by the standard
        deviations of the paper's table 1: 20.7 m along x and 26.7 m along y.
    corner_share: fraction, 0 to 1, of corners, which have the length 0
    shortest_m, longest_m: the lengths of the bars are distributed uniformly between these
    separation_m: smallest distance between two bars or corners
    """

    count: int = 100
    size_m: tuple[float, float] = (50.0, 65.0)
    corner_share: float = 0.0
    shortest_m: float = 1.0
    longest_m: float = 5.5
    separation_m: float = 1.0


NORMAL = BarOptions()
"""About ten bars pass the length test of an observation with a standard deviation of 0.1 m."""

DISTINCT = BarOptions(corner_share=0.4, longest_m=16.0)
"""Corners and walls: one to three walls pass the length test, and no corner that of a wall."""


@dataclass(frozen=True)
class LandmarkSensor:
    """Sensor that measures landmarks in all directions, with independent Gaussian noise.

    Noise never makes a range or length negative: its magnitude is limited to the true value, which
    keeps the measurement unbiased.

    min_range_m, max_range_m: landmarks at other distances are not seen
    range_sd_m, bearing_sd_rad, direction_sd_rad, length_sd_m: standard deviations of the noise
    max_count: observations at one moment; if more landmarks are in view, these many are drawn
    """

    min_range_m: float = 1.0
    max_range_m: float = 12.0
    range_sd_m: float = 0.1
    bearing_sd_rad: float = math.radians(1.0)
    direction_sd_rad: float = math.radians(2.0)
    length_sd_m: float = 0.1
    max_count: int = MAX_OBSERVATION_COUNT

    def with_noise(self, factor: float) -> LandmarkSensor:
        """Return this sensor with all standard deviations multiplied by a factor."""
        return replace(
            self,
            range_sd_m=factor * self.range_sd_m,
            bearing_sd_rad=factor * self.bearing_sd_rad,
            direction_sd_rad=factor * self.direction_sd_rad,
            length_sd_m=factor * self.length_sd_m,
        )


@dataclass(frozen=True)
class Vehicle:
    """Vehicle that drives along a planned path at constant speed.

    Its odometry is the commanded motion, from which the true motion differs by Gaussian noise. The
    variances grow in proportion to the distance and to the angle.

    step_m: distance per step
    look_ahead_m: path length to the point that the vehicle steers at
    position_sd_m: standard deviation of each coordinate after 1 m
    drift_sd_rad: standard deviation of the heading after 1 m
    turn_sd_rad: standard deviation of the heading after a turn of 1 rad
    """

    step_m: float = 1.0
    look_ahead_m: float = 2.0
    position_sd_m: float = 0.05
    drift_sd_rad: float = 0.02
    turn_sd_rad: float = 0.05


@dataclass(frozen=True)
class Step:
    """One step of a vehicle.

    Attributes:
        planned: pose on the planned path.
        pose: true pose at the end of the step.
        motion: odometry of the step: forward and left in m, and turn in rad.
        observations: what the sensor measures at the end of the step.
    """

    planned: Pose
    pose: Pose
    motion: tuple[float, float, float]
    observations: Observations


def scattered_bars(rng: np.random.Generator, options: BarOptions = NORMAL) -> LandmarkWorld:
    """Scatter bars and corners with random directions, as in the paper's figure 1.

    Raises:
        UnusableInput: they do not fit into the world at their smallest distance.
    """
    width_m, depth_m = options.size_m
    places: list[tuple[float, float]] = []
    for _ in range(100 * options.count):
        if len(places) == options.count:
            break
        place = float(rng.uniform(0.0, width_m)), float(rng.uniform(0.0, depth_m))
        if all(math.dist(place, other) >= options.separation_m for other in places):
            places.append(place)
    if len(places) < options.count:
        raise UnusableInput(
            f'only {len(places)} of {options.count} landmarks fit into {width_m:g} x {depth_m:g} '
            f'm at distances of {options.separation_m:g} m: use a larger world or fewer landmarks'
        )
    bars = np.zeros((options.count, 4))
    bars[:, :2] = places
    bars[:, 2] = rng.uniform(-math.pi, math.pi, options.count)
    bars[:, 3] = rng.uniform(options.shortest_m, options.longest_m, options.count)
    bars[: round(options.corner_share * options.count), 3] = 0.0
    return LandmarkWorld(bars, options.size_m)


def floor_plan_landmarks(plan: FloorPlan) -> LandmarkWorld:
    """Convert the walls of a floor plan to bars, and the corners to bars of length 0.

    A wall begins at its left end as seen from the free floor. The direction of a corner bisects
    it and points to the free floor. Walls below `SHORTEST_WALL_M` are left out.
    """
    cell_m = plan.cell_m
    found: list[tuple[float, float, float, float]] = []
    for side, cells in wall_stretches(plan.solid):
        length_m = len(cells) * cell_m
        if length_m < SHORTEST_WALL_M:
            continue
        row, column = cells[0]
        x = column + (side in (EAST, NORTH))
        y = row + (side in (NORTH, WEST))
        found.append((x * cell_m, y * cell_m, _ALONG_RAD[side], length_m))
    found += [
        (x * cell_m, y * cell_m, math.atan2(free_y, free_x), 0.0)
        for x, y, free_x, free_y in _corners(plan.solid)
    ]
    return LandmarkWorld(np.array(found).reshape(-1, 4), plan.size_m, plan)


def observe(
    world: LandmarkWorld, pose: Pose, sensor: LandmarkSensor, rng: np.random.Generator
) -> Observations:
    """Measure the landmarks in view, in random order, with their identifiers.

    In a floor plan, a landmark is in view if no wall blocks the lines of sight to both its ends.
    """
    dx_m, dy_m = world.bars[:, 0] - pose.x_m, world.bars[:, 1] - pose.y_m
    ranges_m = np.hypot(dx_m, dy_m)
    in_range = (ranges_m >= sensor.min_range_m) & (ranges_m <= sensor.max_range_m)
    visible = [int(i) for i in np.flatnonzero(in_range) if _in_sight(world, pose, int(i))]
    seen = rng.permutation(np.array(visible, np.int64))[: sensor.max_count]
    n = len(seen)
    bearings_rad = np.arctan2(dy_m[seen], dx_m[seen]) - pose.heading_rad
    directions_rad = world.bars[seen, 2] - pose.heading_rad
    values = (
        _with_noise(ranges_m[seen], sensor.range_sd_m, rng),
        _wrapped(bearings_rad + sensor.bearing_sd_rad * rng.standard_normal(n)),
        _wrapped(directions_rad + sensor.direction_sd_rad * rng.standard_normal(n)),
        _with_noise(world.bars[seen, 3], sensor.length_sd_m, rng),
    )
    return Observations(np.stack(values, axis=1), seen)


def drive(
    world: LandmarkWorld,
    tour: Sequence[tuple[float, float]],
    sensor: LandmarkSensor,
    rng: np.random.Generator,
    vehicle: Vehicle = Vehicle(),
) -> tuple[Pose, list[Step]]:
    """Drive along straight lines between places, with rounded corners, at constant speed.

    The vehicle steers by its true pose, so that the estimate does not influence the drive.

    Returns:
        The true pose at the start, and the steps.
    """
    path = rounded_path(tour, vehicle.look_ahead_m)
    stride = max(round(vehicle.step_m / PATH_SPACING_M), 1)
    ahead = round(vehicle.look_ahead_m / PATH_SPACING_M)
    step_m = stride * PATH_SPACING_M
    start = pose = _path_pose(path, 0)
    steps = []
    for index in range(0, len(path) - stride, stride):
        x_m, y_m = path[min(index + ahead, len(path) - 1)]
        bearing_rad = math.atan2(y_m - pose.y_m, x_m - pose.x_m) - pose.heading_rad
        # Curvature of the arc through the point ahead.
        distance_m = max(math.hypot(x_m - pose.x_m, y_m - pose.y_m), step_m)
        turn_rad = 2.0 * math.sin(bearing_rad) / distance_m * step_m
        motion = after_arc(Pose(0.0, 0.0, 0.0), step_m, turn_rad)
        pose = _moved(pose, step_m, turn_rad, vehicle, rng)
        steps.append(
            Step(
                _path_pose(path, index + stride),
                pose,
                (motion.x_m, motion.y_m, turn_rad),
                observe(world, pose, sensor, rng),
            )
        )
    return start, steps


def lap(world: LandmarkWorld, margin_m: float, laps: float = 1.0) -> list[tuple[float, float]]:
    """Return the places of a rectangular tour, counter-clockwise from the middle of the south.

    Args:
        world: the world.
        margin_m: distance of the tour from the edge of the world.
        laps: number of laps, a multiple of 1/4.
    """
    width_m, depth_m = world.size_m
    left_m, right_m = margin_m, width_m - margin_m
    low_m, high_m = margin_m, depth_m - margin_m
    x_m, y_m = width_m / 2, depth_m / 2
    sides = ((x_m, low_m), (right_m, y_m), (x_m, high_m), (left_m, y_m))
    corners = ((right_m, low_m), (right_m, high_m), (left_m, high_m), (left_m, low_m))
    count = round(4 * laps)
    return [sides[0], *(corners[i % 4] for i in range(count)), sides[count % 4]]


def random_pose(world: LandmarkWorld, rng: np.random.Generator, margin_m: float = 0.0) -> Pose:
    """Draw a pose on the free floor, at a distance from the edge of the world."""
    width_m, depth_m = world.size_m
    while True:
        x_m = float(rng.uniform(margin_m, width_m - margin_m))
        y_m = float(rng.uniform(margin_m, depth_m - margin_m))
        heading_rad = float(rng.uniform(-math.pi, math.pi))
        if world.plan is None or not world.plan.is_solid(x_m, y_m):
            return Pose(x_m, y_m, heading_rad)


def _corners(solid: NDArray[np.bool_]) -> list[tuple[int, int, float, float]]:
    """Return the corners: x and y in cells, and the direction to the free floor as a vector."""
    free = (~solid).astype(np.int64)
    # The cells around each inner point of the grid: south-west, south-east, and so on.
    sw, se, nw, ne = free[:-1, :-1], free[:-1, 1:], free[1:, :-1], free[1:, 1:]
    to_x, to_y = se + ne - sw - nw, nw + ne - sw - se
    rows, columns = np.nonzero((to_x != 0) & (to_y != 0))
    return [
        (int(column) + 1, int(row) + 1, float(to_x[row, column]), float(to_y[row, column]))
        for row, column in zip(rows, columns, strict=True)
    ]


def _in_sight(world: LandmarkWorld, pose: Pose, index: int) -> bool:
    """Return whether no wall blocks the lines of sight to both ends of a landmark."""
    if world.plan is None:
        return True
    x_m, y_m, direction_rad, length_m = world.bars[index].tolist()
    gap_m = _CLEARANCE_CELLS * world.plan.cell_m
    c, s = math.cos(direction_rad), math.sin(direction_rad)
    if length_m == 0.0:
        return _sees(world.plan, pose, x_m + gap_m * c, y_m + gap_m * s)
    # The free floor is on the right of a wall. Its ends are approached from within.
    side_x, side_y = gap_m * s, -gap_m * c
    return all(
        _sees(world.plan, pose, x_m + along_m * c + side_x, y_m + along_m * s + side_y)
        for along_m in (gap_m, length_m - gap_m)
    )


def _sees(plan: FloorPlan, pose: Pose, x_m: float, y_m: float) -> bool:
    ray = x_m - pose.x_m, y_m - pose.y_m
    return bool(cast(plan.solid, plan.cell_m, pose.x_m, pose.y_m, *ray)[0] >= 1.0)


def _moved(
    pose: Pose, distance_m: float, turn_rad: float, vehicle: Vehicle, rng: np.random.Generator
) -> Pose:
    """Drive an arc with noise."""
    part_m, part_rad = distance_m / _SUBSTEPS_COUNT, turn_rad / _SUBSTEPS_COUNT
    xy_sd_m = vehicle.position_sd_m * math.sqrt(part_m)
    heading_sd_rad = math.sqrt(
        vehicle.drift_sd_rad**2 * part_m + vehicle.turn_sd_rad**2 * abs(part_rad)
    )
    for _ in range(_SUBSTEPS_COUNT):
        forward_m, left_m, drift_rad = rng.standard_normal(3).tolist()
        pose = composed(
            after_arc(pose, part_m, part_rad),
            Pose(xy_sd_m * forward_m, xy_sd_m * left_m, heading_sd_rad * drift_rad),
        )
    return pose


def _path_pose(path: NDArray[np.float64], index: int) -> Pose:
    """Return a point of a path with the direction of the path."""
    before, after = path[max(index - 1, 0)], path[min(index + 1, len(path) - 1)]
    x_m, y_m = path[index].tolist()
    return Pose(x_m, y_m, math.atan2(after[1] - before[1], after[0] - before[0]))


def _with_noise(
    values_m: NDArray[np.float64], sd_m: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    noise_m = sd_m * rng.standard_normal(len(values_m))
    return values_m + np.clip(noise_m, -values_m, values_m)


def _wrapped(angles_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([wrap(angle_rad) for angle_rad in angles_rad.tolist()])
