# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Agreement of a laser scan with the scans that were stored around a place.

The stored scans make a small occupancy grid: cells that beams crossed are free, cells in which
they ended are occupied. A beam of another scan matches if it ends near an occupied cell. It
contradicts the place if it crosses an occupied cell, or ends in the middle of free ones. Beams
that end in unseen cells count neither way, so that a robot that looks round a corner contradicts
nothing. Grid and ray model after Moravec and Elfes (1985), without their probabilities: the scans
of one place are few and precise.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.pose import Pose

CELL_M = 0.1
"""Side of a cell."""

HALF_CELLS = 100
"""Half of the side of the grid, in cells: the range of scan matching and two metres more."""

TOLERANCE_CELLS = 2
"""Largest distance between the end of a beam and an occupied cell that match."""

CLEARANCE_M = 0.35
"""Part of a beam before its end that neither marks nor crosses cells: beams that touch a wall at
a small angle pass through the cells of the wall."""

_FREE, _OCCUPIED = 1, 2


class Agreement(NamedTuple):
    """Numbers of beams that match a place, contradict it, and end where nothing was seen."""

    matching: int
    contradicting: int
    unknown: int

    @property
    def share(self) -> float:
        """Share of matching beams among those that match or contradict; 1 if there are none."""
        known = self.matching + self.contradicting
        return self.matching / known if known else 1.0

    @property
    def known_share(self) -> float:
        """Share of beams that match or contradict; 0 if there are no beams."""
        known = self.matching + self.contradicting
        return known / (known + self.unknown) if known else 0.0

    def plus(self, other: Agreement) -> Agreement:
        """Return the numbers of both."""
        return Agreement(*(a + b for a, b in zip(self, other, strict=True)))


NO_BEAMS = Agreement(0, 0, 0)
"""Agreement of an empty scan."""


class PlaceGrid:
    """Free and occupied cells around a place."""

    def __init__(
        self, scans: Iterable[tuple[Pose, NDArray[np.floating[Any]]]], x_m: float, y_m: float
    ) -> None:
        """Mark the cells of stored scans.

        Args:
            scans: pose of each scan, and its (n, 2) points in m in the frame of that pose.
            x_m, y_m: centre of the grid.
        """
        self._left_m = x_m - HALF_CELLS * CELL_M
        self._bottom_m = y_m - HALF_CELLS * CELL_M
        self._cells = np.zeros((2 * HALF_CELLS, 2 * HALF_CELLS), np.int8)
        for pose, points in scans:
            seen = np.asarray(points, np.float64)
            _mark(self._cells, seen, *pose, self._left_m, self._bottom_m)

    def agreement(self, points: NDArray[np.float64], pose: Pose) -> Agreement:
        """Compare a scan with the place.

        Args:
            points: (n, 2) m, in the robot's frame.
            pose: of the robot, in the frame of the stored scans' poses.
        """
        return Agreement(*_compared(self._cells, points, *pose, self._left_m, self._bottom_m))


@compiled
def _mark(
    cells: NDArray[np.int8], points: NDArray[np.float64], x: float, y: float, heading: float,
    left_m: float, bottom_m: float,
) -> None:
    """Mark the cells of a scan: those that were ever occupied are occupied."""
    side = len(cells)
    c, s = math.cos(heading), math.sin(heading)
    for i in range(len(points)):
        d_x = c * points[i, 0] - s * points[i, 1]
        d_y = s * points[i, 0] + c * points[i, 1]
        length = math.hypot(d_x, d_y)
        for k in range(int((length - CLEARANCE_M) / (0.5 * CELL_M))):
            part = k * 0.5 * CELL_M / length
            column = math.floor((x + part * d_x - left_m) / CELL_M)
            row = math.floor((y + part * d_y - bottom_m) / CELL_M)
            if 0 <= column < side and 0 <= row < side and cells[row, column] != _OCCUPIED:
                cells[row, column] = _FREE
        column = math.floor((x + c * points[i, 0] - s * points[i, 1] - left_m) / CELL_M)
        row = math.floor((y + s * points[i, 0] + c * points[i, 1] - bottom_m) / CELL_M)
        if 0 <= column < side and 0 <= row < side:
            cells[row, column] = _OCCUPIED


@compiled
def _compared(
    cells: NDArray[np.int8], points: NDArray[np.float64], x: float, y: float, heading: float,
    left_m: float, bottom_m: float,
) -> tuple[int, int, int]:
    """Return the numbers of matching, contradicting and other beams."""
    side = len(cells)
    c, s = math.cos(heading), math.sin(heading)
    matching = contradicting = 0
    for i in range(len(points)):
        d_x = c * points[i, 0] - s * points[i, 1]
        d_y = s * points[i, 0] + c * points[i, 1]
        length = math.hypot(d_x, d_y)
        crosses = False
        for k in range(int((length - CLEARANCE_M) / (0.5 * CELL_M))):
            part = k * 0.5 * CELL_M / length
            column = math.floor((x + part * d_x - left_m) / CELL_M)
            row = math.floor((y + part * d_y - bottom_m) / CELL_M)
            if 0 <= column < side and 0 <= row < side and cells[row, column] == _OCCUPIED:
                crosses = True
                break
        if crosses:
            contradicting += 1
            continue
        column = math.floor((x + d_x - left_m) / CELL_M)
        row = math.floor((y + d_y - bottom_m) / CELL_M)
        if not (0 <= column < side and 0 <= row < side):
            continue
        if _is_near_occupied(cells, row, column):
            matching += 1
        elif cells[row, column] == _FREE:
            contradicting += 1
    return matching, contradicting, len(points) - matching - contradicting


@compiled
def _is_near_occupied(cells: NDArray[np.int8], row: int, column: int) -> bool:
    side = len(cells)
    for i in range(max(row - TOLERANCE_CELLS, 0), min(row + TOLERANCE_CELLS + 1, side)):
        for j in range(max(column - TOLERANCE_CELLS, 0), min(column + TOLERANCE_CELLS + 1, side)):
            near = (i - row) ** 2 + (j - column) ** 2 <= TOLERANCE_CELLS**2
            if near and cells[i, j] == _OCCUPIED:
                return True
    return False
