# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Geometry of the pose cells: places on a torus with the axes x, y and theta."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

Unwrapped = tuple[float, float]
"""x and y in cells, not wrapped at the edges of the torus."""


class Place(NamedTuple):
    """A place in the pose cells: x, y and theta in cells."""

    x: float
    y: float
    theta: float


class Located(NamedTuple):
    """A place on the torus and its unwrapped position."""

    place: Place
    unwrapped: Unwrapped


@dataclass(frozen=True, slots=True)
class Torus:
    """Extents of the pose cells, in cells."""

    n_x: int
    n_y: int
    n_theta: int

    @property
    def planes_per_rad(self) -> float:
        """Number of heading planes per radian."""
        return self.n_theta / (2.0 * math.pi)

    def distance(self, a: Place, b: Place, planes_per_cell: float = 1.0) -> float:
        """Return the shortest distance of two places on the torus, in heading planes.

        Args:
            a, b: the places.
            planes_per_cell: number of heading planes that a distance of one cell counts as.
        """
        d_x = abs(a.x - b.x) % self.n_x
        d_y = abs(a.y - b.y) % self.n_y
        d_theta = abs(a.theta - b.theta) % self.n_theta
        d_x = min(d_x, self.n_x - d_x)
        d_y = min(d_y, self.n_y - d_y)
        d_theta = min(d_theta, self.n_theta - d_theta)
        d_x *= planes_per_cell
        d_y *= planes_per_cell
        return math.sqrt(d_x * d_x + d_y * d_y + d_theta * d_theta)

    def wrapped(self, position: Unwrapped, theta: float) -> Place:
        """Return the place on the torus of an unwrapped position."""
        return Place(position[0] % self.n_x, position[1] % self.n_y, theta)

    def rescaled(self, located: Located, factor: float) -> Located:
        """Return a place whose unwrapped position is multiplied by a factor."""
        unwrapped = located.unwrapped[0] * factor, located.unwrapped[1] * factor
        return Located(self.wrapped(unwrapped, located.place.theta), unwrapped)

    def displaced(self, origin: Unwrapped, start: Place, end: Place) -> Unwrapped:
        """Add the shortest displacement along x and y from one place to another.

        Args:
            origin: unwrapped position that corresponds to ``start``.
            start: place before the motion.
            end: place after the motion.

        Returns:
            The unwrapped position that corresponds to ``end``.
        """
        d_x, d_y = end.x - start.x, end.y - start.y
        d_x -= self.n_x * round(d_x / self.n_x)
        d_y -= self.n_y * round(d_y / self.n_y)
        return origin[0] + d_x, origin[1] + d_y
