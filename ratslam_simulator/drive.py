# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Driver that steers the robot by its true pose along a smoothed tour of places."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose

PATH_SPACING_M = 0.05
"""Spacing of path points."""

_SEARCH_POINTS_COUNT = 20
"""Path points ahead among which the nearest one is searched, so that crossings are not cut."""


@dataclass(frozen=True)
class DriveOptions:
    """Properties of the driver.

    speed_mps, corner_speed_mps: speed on straight and on curved stretches
    slow_down_mps2: deceleration before corners and at the end
    corner_radius_m: radius by which corners are rounded
    lane_spread_m: standard deviation of the lateral offset from the straight path
    look_ahead_m: path length to the point that the driver steers at
    rest_every_m, rest_s: mean path length between stops, and mean duration of a stop
    """

    speed_mps: float = 0.6
    corner_speed_mps: float = 0.45
    slow_down_mps2: float = 0.25
    corner_radius_m: float = 0.9
    lane_spread_m: float = 0.05
    look_ahead_m: float = 0.6
    rest_every_m: float = 60.0
    rest_s: float = 3.0


class Driver:
    """Follows a path by pure pursuit, with stops."""

    def __init__(
        self, tour: Sequence[tuple[float, float]], rng: np.random.Generator, options: DriveOptions
    ) -> None:
        self._options = options
        path = rounded_path(tour, options.corner_radius_m)
        self._path, self._limit_mps = _wander(path, rng, options)
        self._index = 0
        self._rests = _rests(len(self._path) * PATH_SPACING_M, rng, options)
        self._rest_left_s = 0.0

    @property
    def start(self) -> Pose:
        """Pose at the start of the path, facing along it."""
        (x_m, y_m), (next_x_m, next_y_m) = self._path[0], self._path[1]
        return Pose(float(x_m), float(y_m), math.atan2(next_y_m - y_m, next_x_m - x_m))

    @property
    def finished(self) -> bool:
        """Whether the robot has reached the end of the path."""
        return self._index >= len(self._path) - 1

    def command(self, pose: Pose, duration_s: float) -> tuple[float, float]:
        """Return the speed in m/s and turn rate in rad/s for the coming ``duration_s``."""
        options = self._options
        self._advance(pose)
        along_m = self._index * PATH_SPACING_M
        if self._rests and along_m >= self._rests[0][0]:
            self._rest_left_s = self._rests.pop(0)[1]
        if self._rest_left_s > 0.0 or self.finished:
            self._rest_left_s -= duration_s
            return 0.0, 0.0
        ahead = self._index + round(options.look_ahead_m / PATH_SPACING_M)
        ahead = min(ahead, len(self._path) - 1)
        dx_m, dy_m = self._path[ahead] - (pose.x_m, pose.y_m)
        bearing_rad = math.remainder(math.atan2(dy_m, dx_m) - pose.heading_rad, math.tau)
        # Curvature of the arc through the look-ahead point.
        curvature = 2.0 * math.sin(bearing_rad) / max(math.hypot(dx_m, dy_m), PATH_SPACING_M)
        speed_mps = float(self._limit_mps[self._index])
        return speed_mps, speed_mps * curvature

    def _advance(self, pose: Pose) -> None:
        """Advance to the nearest path point within the search window."""
        window = self._path[self._index : self._index + _SEARCH_POINTS_COUNT]
        distance_m = np.hypot(window[:, 0] - pose.x_m, window[:, 1] - pose.y_m)
        self._index += int(np.argmin(distance_m))


def path_length_m(tour: Sequence[tuple[float, float]]) -> float:
    """Return the sum of the straight distances along a tour, in metres."""
    return sum(math.dist(a, b) for a, b in pairwise(tour))


def rounded_path(
    tour: Sequence[tuple[float, float]], corner_radius_m: float
) -> NDArray[np.float64]:
    """Connect places by straight lines with rounded corners.

    Returns:
        (n, 2) points in metres, equally spaced.
    """
    points = [np.array(place, float) for place in tour]
    pieces = [points[0][None]]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        in_direction = (corner - before) / np.linalg.norm(corner - before)
        out_direction = (after - corner) / np.linalg.norm(after - corner)
        turn_rad = math.atan2(
            in_direction[0] * out_direction[1] - in_direction[1] * out_direction[0],
            float(in_direction @ out_direction),
        )
        cut_m = corner_radius_m * math.tan(abs(turn_rad) / 2)
        inward = math.copysign(1.0, turn_rad) * np.array([-in_direction[1], in_direction[0]])
        centre = corner - cut_m * in_direction + corner_radius_m * inward
        angles_rad = np.linspace(0.0, turn_rad, 2 + int(abs(turn_rad) * 20))
        cos, sin = np.cos(angles_rad), np.sin(angles_rad)
        x, y = -corner_radius_m * inward
        pieces.append(centre + np.stack([cos * x - sin * y, sin * x + cos * y], axis=1))
    corners = np.concatenate([*pieces, points[-1][None]])
    return _resample(corners)


def _resample(points: NDArray[np.float64]) -> NDArray[np.float64]:
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    even_m = np.arange(0.0, along_m[-1], PATH_SPACING_M)
    return np.stack([np.interp(even_m, along_m, points[:, axis]) for axis in (0, 1)], axis=1)


def _wander(
    path: NDArray[np.float64], rng: np.random.Generator, options: DriveOptions
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Offset a path laterally by slow waves; return it and the speed limits at its points."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.hypot(*tangent.T)[:, None]
    heading_rad = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    curvature = np.gradient(heading_rad) / PATH_SPACING_M
    along_m = np.arange(len(path)) * PATH_SPACING_M
    offset_m = np.zeros(len(path))
    # Random wavelengths, so that the offset differs from lap to lap.
    for length_m in rng.uniform(6.0, 20.0, 4):
        phase_rad = rng.uniform(0.0, math.tau)
        offset_m += np.sin(math.tau * along_m / length_m + phase_rad)
    offset_m *= options.lane_spread_m / math.sqrt(2.0)
    lane = path + offset_m[:, None] * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    limit_mps = np.where(np.abs(curvature) > 0.2, options.corner_speed_mps, options.speed_mps)
    limit_mps[-1] = 0.05
    # Braking distance: v^2 = v_next^2 + 2 a d, from the end backwards.
    for i in range(len(limit_mps) - 2, -1, -1):
        reachable = math.sqrt(limit_mps[i + 1] ** 2 + 2 * options.slow_down_mps2 * PATH_SPACING_M)
        limit_mps[i] = min(limit_mps[i], reachable)
    return lane, limit_mps


def _rests(
    length_m: float, rng: np.random.Generator, options: DriveOptions
) -> list[tuple[float, float]]:
    """Draw the stops: path length in metres and duration in seconds of each."""
    rests: list[tuple[float, float]] = []
    along_m = options.rest_every_m * rng.uniform(0.4, 0.8)
    while along_m < length_m - 5.0:
        rests.append((along_m, options.rest_s * rng.uniform(0.7, 1.3)))
        along_m += options.rest_every_m * rng.uniform(0.7, 1.3)
    return rests
