# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated world: a floor plan whose walls carry panels and whose rooms are lit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.simulator.floor_plan import FloorPlan
from ratslam_ros.simulator.textures import PANEL_WIDTH_M, PanelLibrary, paint_library

# Sides of a wall cell, named by where the viewer stands.
WEST, EAST, SOUTH, NORTH = range(4)
_STEPS = {WEST: (0, -1), EAST: (0, 1), SOUTH: (-1, 0), NORTH: (1, 0)}


@dataclass(frozen=True)
class WorldOptions:
    """How a floor plan is decorated.

    aliasing: share of the walls at corners and junctions, 0..1, that are in the house style,
        which repeats the same few panels: such places look alike, however far apart they are
    corner_m: what still counts as at a corner, from the middle of the corridor
    light_spread: how much the lighting differs from place to place, as a share
    """

    aliasing: float = 1.0
    corner_m: float = 1.8
    light_spread: float = 0.15


@dataclass(frozen=True)
class World:
    """Everything that a sensor can see.

    panel: (n_y, n_x, 4) int16, the panel on each side of each wall cell
    panel_u_m: (n_y, n_x, 4) float32, where on its panel the cell's side begins, from its left
    light: (n_y, n_x) float32, brightness of each cell, about 1
    """

    plan: FloorPlan
    library: PanelLibrary
    panel: NDArray[np.int16]
    panel_u_m: NDArray[np.float32]
    light: NDArray[np.float32]


def build_world(
    plan: FloorPlan, rng: np.random.Generator, options: WorldOptions | None = None
) -> World:
    """Decorate a floor plan from a seed."""
    options = options or WorldOptions()
    library = paint_library(rng)
    house_style = _house_style_sides(plan, rng, options)
    panel = np.zeros((*plan.solid.shape, 4), np.int16)
    panel_u_m = np.zeros((*plan.solid.shape, 4), np.float32)
    for side, wall in _walls(plan.solid):
        panel_of = _panels_along(len(wall) * plan.cell_m, library, rng)
        for index, (row, column) in enumerate(wall):
            start_m = index * plan.cell_m
            place = int(start_m / PANEL_WIDTH_M + 1e-9)
            repeated = library.house_style[place % len(library.house_style)]
            own = panel_of[place]
            panel[row, column, side] = repeated if house_style[row, column, side] else own
            panel_u_m[row, column, side] = start_m - place * PANEL_WIDTH_M
    return World(plan, library, panel, panel_u_m, _lighting(plan, rng, options))


def _walls(solid: NDArray[np.bool_]) -> list[tuple[int, list[tuple[int, int]]]]:
    """Collect straight stretches of wall, each from left to right as its viewer sees it."""
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
    """Draw panels for a wall, never the same twice running."""
    n_panels = library.textures.shape[1]
    chosen = [int(rng.integers(n_panels))]
    for _ in range(int(length_m / PANEL_WIDTH_M) + 1):
        chosen.append((chosen[-1] + int(rng.integers(1, n_panels))) % n_panels)
    return chosen


def _house_style_sides(
    plan: FloorPlan, rng: np.random.Generator, options: WorldOptions
) -> NDArray[np.bool_]:
    """Choose walls around the named places, (n_y, n_x, 4): the wanted share of them, by lot."""
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
    """Sum a few waves, so that the light changes smoothly from place to place."""
    n_y, n_x = plan.solid.shape
    x_m = (np.arange(n_x) + 0.5)[None, :] * plan.cell_m
    y_m = (np.arange(n_y) + 0.5)[:, None] * plan.cell_m
    light = np.ones((n_y, n_x))
    for _ in range(4):
        direction_rad, phase_rad = rng.uniform(0, 2 * np.pi, 2)
        length_m = rng.uniform(8.0, 25.0)
        along_m = x_m * np.cos(direction_rad) + y_m * np.sin(direction_rad)
        light += options.light_spread / 2 * np.sin(2 * np.pi * along_m / length_m + phase_rad)
    return light.astype(np.float32)
