# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ray casting through the grid and against discs, for the camera and the laser."""

from __future__ import annotations

import math

from numba import njit

WEST, EAST, SOUTH, NORTH = range(4)
"""Sides of a wall cell, named by the side on which the viewer is."""


@njit(cache=True)
def cast(solid, cell_m, x_m, y_m, ray_x, ray_y):  # type: ignore[no-untyped-def]
    """Cast a ray to the first solid cell.

    Returns the length in units of (ray_x, ray_y), the row and column of the cell, and its side.
    """
    column, row = int(x_m / cell_m), int(y_m / cell_m)
    step_x, step_y = (1 if ray_x > 0 else -1), (1 if ray_y > 0 else -1)
    far = 1e12
    gap_x = cell_m / abs(ray_x) if ray_x != 0 else far
    gap_y = cell_m / abs(ray_y) if ray_y != 0 else far
    next_x = ((column + (step_x > 0)) * cell_m - x_m) / ray_x if ray_x != 0 else far
    next_y = ((row + (step_y > 0)) * cell_m - y_m) / ray_y if ray_y != 0 else far
    while True:
        if next_x < next_y:
            length, side = next_x, (WEST if step_x > 0 else EAST)
            next_x += gap_x
            column += step_x
        else:
            length, side = next_y, (SOUTH if step_y > 0 else NORTH)
            next_y += gap_y
            row += step_y
        if solid[row, column]:
            return length, row, column, side


@njit(cache=True)
def cast_at_discs(discs, radius_m, x_m, y_m, ray_x, ray_y):  # type: ignore[no-untyped-def]
    """Cast a ray to the first of the discs, (n, 2 or more) with x and y first, from outside.

    Returns the length in units of (ray_x, ray_y), inf if there is no hit, and the index of the
    disc, -1 if there is none.
    """
    nearest, found = math.inf, -1
    square = ray_x * ray_x + ray_y * ray_y
    for index in range(len(discs)):
        to_x, to_y = discs[index, 0] - x_m, discs[index, 1] - y_m
        along = to_x * ray_x + to_y * ray_y
        inside = along * along - square * (to_x * to_x + to_y * to_y - radius_m * radius_m)
        if along > 0.0 and inside > 0.0:
            length = (along - math.sqrt(inside)) / square
            if 0.0 < length < nearest:
                nearest, found = length, index
    return nearest, found
