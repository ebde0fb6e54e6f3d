# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated world: a floor plan with textured walls, lighting, obstacles and people."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.errors import UnusableInput
from ratslam_simulator.bodies import fits
from ratslam_simulator.floor_plan import FloorPlan
from ratslam_simulator.rays import EAST, NORTH, SOUTH, WEST
from ratslam_simulator.textures import PANEL_WIDTH_M, PanelLibrary, paint_library

PERSON_RADIUS_M, PERSON_HEIGHT_M = 0.25, 1.75

_STEPS = {WEST: (0, -1), EAST: (0, 1), SOUTH: (-1, 0), NORTH: (1, 0)}
"""Side of a cell -> step in row and column to the cell from which it is seen."""

_LIGHT_WAVES_COUNT = 4
"""Waves in the sum that makes the light vary from place to place."""


@dataclass(frozen=True)
class WorldOptions:
    """How a floor plan is decorated and lit.

    aliasing: fraction, 0 to 1, of the walls around named places that are in the house style, a
        short repeating sequence of panels, so that such places look alike
    variety: number of sets of unique panels; with more sets, fewer walls look alike
    corner_m: radius around a named place within which its walls may be in the house style
    light_spread: relative variation of the light from place to place
    light_change: relative variation of the light over time; 0 for constant light
    """

    aliasing: float = 1.0
    variety: int = 1
    corner_m: float = 1.8
    light_spread: float = 0.15
    light_change: float = 0.0


@dataclass
class World:
    """The present state of everything that sensors can see.

    panel: (n_y, n_x, 4) int16, index of the panel on each side of each solid cell
    panel_u_m: (n_y, n_x, 4) float32, offset on its panel of the left end of the cell's side
    light: (n_y, n_x) float32, brightness of each cell, about 1
    solid: (n_y, n_x) bool, walls and obstacles
    people: (n, 4) float64, x_m, y_m, heading in rad, index of the panel of the clothes
    obstacles: name -> (k, 2) row and column of the cells that it covers
    """

    plan: FloorPlan
    library: PanelLibrary
    panel: NDArray[np.int16]
    panel_u_m: NDArray[np.float32]
    light: NDArray[np.float32]
    solid: NDArray[np.bool_] = field(init=False)
    people: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 4)))
    obstacles: dict[str, NDArray[np.intp]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.solid = self.plan.solid.copy()

    def obstacle_cells(
        self, x_m: float, y_m: float, width_m: float, depth_m: float
    ) -> NDArray[np.intp]:
        """Return the free cells whose centres lie in a rectangle, (k, 2) row and column.

        Args:
            x_m, y_m: centre of the rectangle.
            width_m, depth_m: its extent along x and y.

        Raises:
            UnusableInput: there are none.
        """
        rows, columns = np.nonzero(~self.solid)
        dx = np.abs((columns + 0.5) * self.plan.cell_m - x_m)
        dy = np.abs((rows + 0.5) * self.plan.cell_m - y_m)
        within = (dx <= width_m / 2) & (dy <= depth_m / 2)
        if not within.any():
            raise UnusableInput(
                f'an obstacle of {width_m:g} x {depth_m:g} m at ({x_m:g}, {y_m:g}) covers no free '
                f'cell: cells are {self.plan.cell_m:g} m, make it larger or move it'
            )
        return np.stack([rows[within], columns[within]], axis=1)

    def require_room(self, who: str, x_m: float, y_m: float, radius_m: float) -> None:
        """Raise UnusableInput if a round body, such as 'a person', does not fit at a point."""
        width_m, depth_m = self.plan.size_m
        inside = 0.0 < x_m < width_m and 0.0 < y_m < depth_m
        if not inside or not fits(self.solid, self.plan.cell_m, x_m, y_m, radius_m):
            raise UnusableInput(
                f'{who} of radius {radius_m:g} m does not fit at ({x_m:g}, {y_m:g}) on a floor of '
                f'{width_m:g} x {depth_m:g} m: choose a free place'
            )

    def add_obstacle(self, name: str, cells: NDArray[np.intp]) -> None:
        """Fill cells from floor to ceiling with an obstacle that looks like cardboard boxes.

        Raises:
            UnusableInput: there is an obstacle of this name.
        """
        if name in self.obstacles:
            raise UnusableInput(f'there is an obstacle {name!r} already: remove it first')
        rows, columns = cells.T
        self.solid[rows, columns] = True
        self.panel[rows, columns] = self.library.cardboard
        # Panels continue from cell to cell, left to right as seen from outside.
        for side, (_, step_x) in _STEPS.items():
            along = rows if step_x else columns
            along = -along if side in (WEST, NORTH) else along
            self.panel_u_m[rows, columns, side] = (along * self.plan.cell_m) % PANEL_WIDTH_M
        self.obstacles[name] = cells

    def remove_obstacle(self, name: str) -> None:
        """Remove an obstacle.

        Raises:
            UnusableInput: there is no obstacle of this name.
        """
        if name not in self.obstacles:
            known = ', '.join(self.obstacles) or 'none'
            raise UnusableInput(f'there is no obstacle {name!r} to remove (there are: {known})')
        rows, columns = self.obstacles.pop(name).T
        self.solid[rows, columns] = False


def build_world(
    plan: FloorPlan, rng: np.random.Generator, options: WorldOptions | None = None
) -> World:
    """Decorate and light a floor plan at random."""
    options = options or WorldOptions()
    library = paint_library(rng, options.variety)
    house_style = _house_style_sides(plan, rng, options)
    panel = np.zeros((*plan.solid.shape, 4), np.int16)
    panel_u_m = np.zeros((*plan.solid.shape, 4), np.float32)
    for side, wall in wall_stretches(plan.solid):
        panel_of = _panels_along(len(wall) * plan.cell_m, library, rng)
        for index, (row, column) in enumerate(wall):
            start_m = index * plan.cell_m
            place = int(start_m / PANEL_WIDTH_M + 1e-9)
            repeated = library.house_style[place % len(library.house_style)]
            own = panel_of[place]
            panel[row, column, side] = repeated if house_style[row, column, side] else own
            panel_u_m[row, column, side] = start_m - place * PANEL_WIDTH_M
    return World(plan, library, panel, panel_u_m, _lighting(plan, rng, options))


def wall_stretches(solid: NDArray[np.bool_]) -> list[tuple[int, list[tuple[int, int]]]]:
    """Return the straight stretches of wall: side, and cells from left to right as seen."""
    n_y, n_x = solid.shape
    walls: list[tuple[int, list[tuple[int, int]]]] = []
    for side, (step_y, step_x) in _STEPS.items():
        along_x = side in (SOUTH, NORTH)
        for line in range(n_y if along_x else n_x):
            stretch: list[tuple[int, int]] = []
            places = range(n_x if along_x else n_y)
            for place in reversed(places) if side in (WEST, NORTH) else places:
                row, column = (line, place) if along_x else (place, line)
                beside = (row + step_y, column + step_x)
                inside = 0 <= beside[0] < n_y and 0 <= beside[1] < n_x
                if solid[row, column] and inside and not solid[beside]:
                    stretch.append((row, column))
                elif stretch:
                    walls.append((side, stretch))
                    stretch = []
            if stretch:
                walls.append((side, stretch))
    return walls


def _panels_along(length_m: float, library: PanelLibrary, rng: np.random.Generator) -> list[int]:
    """Draw panels for a wall, never the same one twice in a row."""
    n_panels = library.on_walls
    chosen = [int(rng.integers(n_panels))]
    for _ in range(int(length_m / PANEL_WIDTH_M) + 1):
        chosen.append((chosen[-1] + int(rng.integers(1, n_panels))) % n_panels)
    return chosen


def _house_style_sides(
    plan: FloorPlan, rng: np.random.Generator, options: WorldOptions
) -> NDArray[np.bool_]:
    """Draw the sides of cells that are in the house style, (n_y, n_x, 4) bool."""
    rows, columns = np.indices(plan.solid.shape)
    x_m, y_m = (columns + 0.5) * plan.cell_m, (rows + 0.5) * plan.cell_m
    chosen = np.zeros((*plan.solid.shape, 4), bool)
    walls = [(place, side) for place in plan.places.values() for side in _STEPS]
    for index in rng.permutation(len(walls))[: round(options.aliasing * len(walls))]:
        (place_x_m, place_y_m), side = walls[index]
        near = np.hypot(x_m - place_x_m, y_m - place_y_m) <= options.corner_m
        chosen[..., side] |= near
    return chosen


def _lighting(
    plan: FloorPlan, rng: np.random.Generator, options: WorldOptions
) -> NDArray[np.float32]:
    """Return the light of each cell, (n_y, n_x): a sum of waves, so that it varies smoothly."""
    n_y, n_x = plan.solid.shape
    x_m = (np.arange(n_x) + 0.5)[None, :] * plan.cell_m
    y_m = (np.arange(n_y) + 0.5)[:, None] * plan.cell_m
    light = np.ones((n_y, n_x))
    for _ in range(_LIGHT_WAVES_COUNT):
        direction_rad, phase_rad = rng.uniform(0, 2 * np.pi, 2)
        length_m = rng.uniform(8.0, 25.0)
        along_m = x_m * np.cos(direction_rad) + y_m * np.sin(direction_rad)
        light += options.light_spread / 2 * np.sin(2 * np.pi * along_m / length_m + phase_rad)
    return light.astype(np.float32)
