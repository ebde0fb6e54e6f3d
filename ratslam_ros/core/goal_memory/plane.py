# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The plane of the goal memory's cells: the pose cells without their headings, on a torus."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

from ratslam_ros.core.pose_cells.torus import Place


class Plane(NamedTuple):
    """Cells numbered by y * n_x + x; distances are in cells, around the torus."""

    n_x: int
    n_y: int

    def place(self, cell: Any) -> Place:
        """Return the place of a cell, or those of an array of cells."""
        y, x = divmod(cell, self.n_x)
        return Place(x, y, 0.0)

    def offset(self, start: Place, end: Place) -> tuple[Any, Any]:
        """Return the shortest displacement from one place to another along x and y."""
        n_x, n_y = self
        return (
            (end.x - start.x + 0.5 * n_x) % n_x - 0.5 * n_x,
            (end.y - start.y + 0.5 * n_y) % n_y - 0.5 * n_y,
        )

    def distance(self, a: Place, b: Place) -> float:
        """Return the shortest distance of two places along x and y."""
        dx, dy = self.offset(a, b)
        return math.sqrt(dx * dx + dy * dy)

    def around(
        self, place: Place, radius_cells: float
    ) -> Iterator[tuple[float, float, float, int]]:
        """Yield the cells within a radius, nearest first.

        On a torus smaller than the radius each cell is yielded once, at its shortest distance.

        Yields:
            Distance, x and y relative to the place, and cell number.
        """
        n_x, n_y = self
        radius = math.ceil(radius_cells)
        middle_x, middle_y = math.floor(place.x + 0.5), math.floor(place.y + 0.5)
        found = []
        for j in range(-min(radius, (n_y - 1) // 2), min(radius, n_y // 2) + 1):
            for i in range(-min(radius, (n_x - 1) // 2), min(radius, n_x // 2) + 1):
                dx, dy = middle_x + i - place.x, middle_y + j - place.y
                distance = math.sqrt(dx * dx + dy * dy)
                if distance <= radius_cells:
                    found.append(
                        (distance, dx, dy, (middle_y + j) % n_y * n_x + (middle_x + i) % n_x)
                    )
        yield from sorted(found)
