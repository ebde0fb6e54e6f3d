# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Collision of round bodies with solid cells and with each other."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

_ROUNDING_M = 1e-9
"""Penetration depth attributed to rounding."""

_PUSHES_COUNT = 6
"""Largest number of push-outs per move; in a corner, two walls push alternately."""


@njit(cache=True)
def fits(solid, cell_m, x_m, y_m, radius_m):  # type: ignore[no-untyped-def]
    """Return whether a disc overlaps no solid cell."""
    depth_m, _, _ = _deepest_cell(solid, cell_m, x_m, y_m, radius_m)
    return depth_m <= _ROUNDING_M


@njit(cache=True)
def slide(  # type: ignore[no-untyped-def]
    solid, cell_m, discs, disc_radius_m, from_x_m, from_y_m, x_m, y_m, radius_m,
):
    """Move a disc to a nearby point, pushed out of solid cells and other discs on its way.

    Args:
        solid, cell_m: (n_y, n_x) grid and the side of its cells.
        discs: (n, 2 or more), x and y first; the other discs.
        disc_radius_m: radius of the other discs.
        from_x_m, from_y_m: present position, at which the disc must fit.
        x_m, y_m: position to move to.
        radius_m: radius of the disc.

    Returns:
        x_m, y_m and whether the disc touched anything. If pushing out does not converge, the disc
        stays at its present position.
    """
    touched = False
    for _ in range(_PUSHES_COUNT):
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
    """Return the largest penetration of a disc into a solid cell, and the direction out of it."""
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
                    # With its centre inside the cell, the disc has no preferred direction out.
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
    """Return the cells at whose centres a disc of this radius fits, (n_y, n_x) bool."""
    room = np.empty_like(solid)
    _room(solid, cell_m, radius_m, room)
    return room
