# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled loops of the occupancy grid: rays of one scan, and rows of probabilities."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled

LIMIT_CELLS = 2048
"""Cells of a grid along each axis; a power of two. The cell (x, y) of the map is kept as cell
(x % LIMIT_CELLS, y % LIMIT_CELLS), so that the grid can grow to all sides."""

_MASK = LIMIT_CELLS - 1
_TILE_BITS, _TILE_MASK = 6, 63
_ROW_BITS = 11 - _TILE_BITS

HIT, MISS = math.log(0.7 / 0.3), math.log(0.4 / 0.6)
"""Log odds that a beam that ends in a cell, or passes it, adds: Hornung et al. (2013), OctoMap."""

LOWEST, HIGHEST = math.log(0.12 / 0.88), math.log(0.97 / 0.03)
"""Bounds of the log odds that are shown, of the same source."""


@compiled
def _index(x: int, y: int) -> int:
    """Return where a cell is kept: in tiles of 64 x 64, as a scan touches memory of few tiles."""
    column, row = x & _MASK, y & _MASK
    tile = ((row >> _TILE_BITS) << _ROW_BITS) | (column >> _TILE_BITS)
    return (tile << (2 * _TILE_BITS)) | ((row & _TILE_MASK) << _TILE_BITS) | (column & _TILE_MASK)


@compiled
def cast(
    hits: NDArray[np.int32], misses: NDArray[np.int32], marks: NDArray[np.int32], mark: int,
    sign: int, pose: tuple[float, float, float], points: NDArray[np.float32], cell_m: float,
    range_m: float,
) -> tuple[int, int, int, int]:
    """Add a scan to the counts of the cells, or remove it; each cell counts once.

    Args:
        hits, misses: numbers of scans that end in each cell, and that pass it, of
            LIMIT_CELLS * LIMIT_CELLS cells; changed.
        marks: last scan that has changed each cell; changed.
        mark: number of this scan, above all in ``marks``.
        sign: 1 to add the scan, -1 to remove it.
        pose: x and y in m, and heading in rad.
        points: (n, 2) end points of the beams in m in the frame of the pose.
        cell_m: size of a cell.
        range_m: length of a beam after which it is ignored.

    Returns:
        Smallest x and y, and largest x and y, of the cells that were changed.
    """
    x_m, y_m, heading = pose
    cos, sin = math.cos(heading), math.sin(heading)
    from_x, from_y = math.floor(x_m / cell_m), math.floor(y_m / cell_m)
    low_x = high_x = from_x
    low_y = high_y = from_y
    ends = np.empty((len(points), 2), np.int64)
    for i in range(len(points)):
        a, b = float(points[i, 0]), float(points[i, 1])
        length = math.sqrt(a * a + b * b)
        is_end = length < range_m
        scale = 1.0 if is_end else range_m / length
        ends[i, 0] = math.floor((x_m + (cos * a - sin * b) * scale) / cell_m)
        ends[i, 1] = math.floor((y_m + (sin * a + cos * b) * scale) / cell_m)
        low_x, high_x = min(low_x, ends[i, 0]), max(high_x, ends[i, 0])
        low_y, high_y = min(low_y, ends[i, 1]), max(high_y, ends[i, 1])
        at = _index(ends[i, 0], ends[i, 1])
        if is_end and marks[at] != mark:
            marks[at] = mark
            hits[at] += sign
    for i in range(len(points)):
        x, y = from_x, from_y
        d_x, d_y = abs(ends[i, 0] - x), abs(ends[i, 1] - y)
        step_x = 1 if ends[i, 0] > x else -1
        step_y = 1 if ends[i, 1] > y else -1
        error = d_x - d_y  # Bresenham's line (1965)
        while x != ends[i, 0] or y != ends[i, 1]:
            at = _index(x, y)
            if marks[at] != mark:
                marks[at] = mark
                misses[at] += sign
            twice = 2 * error
            if twice > -d_y:
                error -= d_y
                x += step_x
            if twice < d_x:
                error += d_x
                y += step_y
    return low_x, low_y, high_x, high_y


@compiled
def write_rows(
    hits: NDArray[np.int32], misses: NDArray[np.int32], x: int, y: int, out: NDArray[np.int8]
) -> None:
    """Write the probabilities that cells are occupied, in percent; -1 if they were never seen.

    Args:
        hits, misses: counts of the cells.
        x, y: cell of ``out[0, 0]``.
        out: (rows, columns); changed.
    """
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            at = _index(x + k, y + i)
            hit, miss = hits[at], misses[at]
            if hit + miss == 0:
                out[i, k] = -1
            else:
                odds = min(max(hit * HIT + miss * MISS, LOWEST), HIGHEST)
                out[i, k] = np.int8(round(100.0 / (1.0 + math.exp(-odds))))
