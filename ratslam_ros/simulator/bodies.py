# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Round bodies on the floor: where they fit, and how far they get before they touch something."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

# What a position may lie inside another body by rounding.
_ROUNDING_M = 1e-9
# In a corner a body is pushed off one wall and then off the other; a few times settle it.
_PUSHES = 6


@njit(cache=True)
def fits(solid, cell_m, x_m, y_m, radius_m):  # type: ignore[no-untyped-def]
    """Say whether a disc touches no solid cell."""
    depth_m, _, _ = _deepest_cell(solid, cell_m, x_m, y_m, radius_m)
    return depth_m <= _ROUNDING_M


@njit(cache=True)
def slide(  # type: ignore[no-untyped-def]
    solid, cell_m, discs, disc_radius_m, from_x_m, from_y_m, x_m, y_m, radius_m,
):  # fmt: skip
    """Move a disc towards a point nearby without entering solid cells or other discs.

    discs: rows of x, y and more, all of one radius; the disc must fit where it comes from
    Returns x_m, y_m and whether it touched: pushed off along what it met, or where it was
    """
    touched = False
    for _ in range(_PUSHES):
        depth_m, away_x, away_y = _deepest_cell(solid, cell_m, x_m, y_m, radius_m)
        for index in range(len(discs)):
            dx, dy = x_m - discs[index, 0], y_m - discs[index, 1]
            distance_m = math.hypot(dx, dy)
            inside_m = radius_m + disc_radius_m - distance_m
            if inside_m > depth_m and distance_m > 0.0:
                depth_m, away_x, away_y = inside_m, dx / distance_m, dy / distance_m
        if depth_m <= _ROUNDING_M:
            return x_m, y_m, touched
        touched = True
        x_m += depth_m * away_x
        y_m += depth_m * away_y
    return from_x_m, from_y_m, True


@njit(cache=True)
def _deepest_cell(solid, cell_m, x_m, y_m, radius_m):  # type: ignore[no-untyped-def]
    """Find how deep a disc is in solid cells, and the direction that leads out of the deepest."""
    n_y, n_x = solid.shape
    deepest_m, away_x, away_y = 0.0, 0.0, 0.0
    first_row, last_row = int((y_m - radius_m) / cell_m), int((y_m + radius_m) / cell_m)
    first_column, last_column = int((x_m - radius_m) / cell_m), int((x_m + radius_m) / cell_m)
    for row in range(max(first_row, 0), min(last_row, n_y - 1) + 1):
        dy = y_m - min(max(y_m, row * cell_m), (row + 1) * cell_m)
        for column in range(max(first_column, 0), min(last_column, n_x - 1) + 1):
            if solid[row, column]:
                dx = x_m - min(max(x_m, column * cell_m), (column + 1) * cell_m)
                distance_m = math.hypot(dx, dy)
                if radius_m - distance_m > deepest_m:
                    deepest_m = radius_m - distance_m
                    # The middle itself inside: no way out is better than another.
                    scale = 1.0 / distance_m if distance_m > 0.0 else 0.0
                    away_x, away_y = dx * scale, dy * scale
    return deepest_m, away_x, away_y


@njit(cache=True)
def _room(solid, cell_m, radius_m, room):  # type: ignore[no-untyped-def]
    for row in range(solid.shape[0]):
        for column in range(solid.shape[1]):
            room[row, column] = not solid[row, column] and fits(
                solid, cell_m, (column + 0.5) * cell_m, (row + 0.5) * cell_m, radius_m
            )


def room_for(solid: NDArray[np.bool_], cell_m: float, radius_m: float) -> NDArray[np.bool_]:
    """Find the cells in whose middle a disc of this radius fits, (n_y, n_x) bool."""
    room = np.empty_like(solid)
    _room(solid, cell_m, radius_m, room)
    return room
