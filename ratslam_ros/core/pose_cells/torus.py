# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Places in the pose cells: x, y and theta in cells, each axis closed to a circle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple


class Place(NamedTuple):
    """A place in cells along x, y and theta."""

    x: float
    y: float
    theta: float


@dataclass(frozen=True, slots=True)
class Torus:
    """The pose cells' extents, in cells."""

    n_x: int
    n_y: int
    n_theta: int

    @property
    def planes_per_rad(self) -> float:
        """Heading planes in one radian."""
        return self.n_theta / (2.0 * math.pi)

    def distance(self, a: Place, b: Place) -> float:
        """Return the distance of two places in cells, the shortest way round each circle."""
        d_x = abs(a.x - b.x) % self.n_x
        d_y = abs(a.y - b.y) % self.n_y
        d_theta = abs(a.theta - b.theta) % self.n_theta
        d_x = min(d_x, self.n_x - d_x)
        d_y = min(d_y, self.n_y - d_y)
        d_theta = min(d_theta, self.n_theta - d_theta)
        return math.sqrt(d_x * d_x + d_y * d_y + d_theta * d_theta)

    def step(self, start: Place, end: Place) -> tuple[float, float]:
        """Return the way from one place to another in cells, the shortest along x and along y."""
        d_x, d_y = end.x - start.x, end.y - start.y
        return d_x - self.n_x * round(d_x / self.n_x), d_y - self.n_y * round(d_y / self.n_y)

    def moved(self, place: Place, chord_cells: float, turn_planes: float) -> Place:
        """Return a place after a motion: ahead along the chord of an arc, and turned."""
        direction = (place.theta + 0.5 * turn_planes) / self.planes_per_rad
        return Place(
            place.x + chord_cells * math.cos(direction),
            place.y + chord_cells * math.sin(direction),
            place.theta + turn_planes,
        )
