# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Floor plans as text: what is wall, what is free, and the named places that a tour visits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.errors import UnusableInput

# Two loops that share the whole left half. Corridors are three cells wide, so that a place named
# in the middle row lies on the centre line; alcoves, a lobby and its pillars tell them apart.
OFFICE = """
###########################
#.........................#
#.D..........F..........C.#
#.........................#
#...##...###...########...#
#...##...###...########...#
#...########...#####......#
#...########...#####.#....#
#...########....####......#
#...########....####.#....#
#...########...###...##...#
#...########...###...##...#
#.........................#
#.A..........E..........B.#
#.........................#
###########################
"""
OFFICE_CELL_M = 0.7
# Once round the building, then round its left wing, always counter-clockwise: a camera that looks
# ahead recognises a place only in the direction in which it learned it.
OFFICE_START, OFFICE_CIRCUIT = 'E', 'BCDAEFDAE'

WALL = '#'


@dataclass(frozen=True)
class FloorPlan:
    """A grid of wall and free cells with named places.

    solid: (n_y, n_x) bool, True where there is wall; row 0 is the southernmost
    cell_m: side of a cell
    places: letter -> (x_m, y_m), the centre of the cell that carries the letter
    """

    solid: NDArray[np.bool_]
    cell_m: float
    places: dict[str, tuple[float, float]]

    @property
    def size_m(self) -> tuple[float, float]:
        """Width along x and depth along y."""
        n_y, n_x = self.solid.shape
        return n_x * self.cell_m, n_y * self.cell_m

    def clearance_m(self, x_m: float, y_m: float) -> float:
        """Distance from a point to the nearest wall, 0 inside one."""
        rows, columns = np.nonzero(self.solid)
        # To the nearest point of each wall cell, which is a square.
        dx = np.maximum(np.abs(x_m - (columns + 0.5) * self.cell_m) - self.cell_m / 2, 0.0)
        dy = np.maximum(np.abs(y_m - (rows + 0.5) * self.cell_m) - self.cell_m / 2, 0.0)
        return float(np.sqrt(np.min(dx * dx + dy * dy)))


def parse_floor_plan(text: str, cell_m: float) -> FloorPlan:
    """Read a plan drawn with `#` for wall, letters for named places and anything else for free.

    The first line is the north side. The outer cells must be wall, so that no ray leaves the plan.
    """
    lines = text.strip('\n').splitlines()
    if len({len(line) for line in lines}) != 1:
        raise UnusableInput(
            'the lines of a floor plan must be equally long, '
            f'these have {sorted({len(line) for line in lines})} characters'
        )
    grid = np.array([list(line) for line in reversed(lines)])
    solid = grid == WALL
    if not (solid[0].all() and solid[-1].all() and solid[:, 0].all() and solid[:, -1].all()):
        raise UnusableInput('a floor plan must be closed: draw # all around its edge')
    places = {
        str(grid[row, column]): ((column + 0.5) * cell_m, (row + 0.5) * cell_m)
        for row, column in np.argwhere(np.char.isalpha(grid)).tolist()
    }
    return FloorPlan(solid, cell_m, places)


def office() -> FloorPlan:
    """Return the built-in office floor."""
    return parse_floor_plan(OFFICE, OFFICE_CELL_M)
