# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detour: scan, route -> the way round what stands on the route."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.free_directions import DirectionCandidate, LocalMovement

CELL_M, BACK_M, FRONT_M, ASIDE_M = 0.1, 1.0, 4.0, 2.5
"""The cells in which a detour is looked for: how wide, and how far around the robot they lie."""

ROWS, COLUMNS = round(2 * ASIDE_M / CELL_M) + 1, round((BACK_M + FRONT_M) / CELL_M) + 1

TIGHT, ROOM_M, UNSEEN = 4.0, 0.3, 2.0
"""Times that a way counts where the robot only just fits, less with room beside it up to so much;
and where its laser does not see."""

MOST_M = 4.0
"""What counts for so much more than the route is no detour: the way is closed."""

LOOK_AHEAD_M = 0.8
"""The robot heads for a place of the detour that is up to so far away."""

STEADY, FIRST_M = 0.5, 0.5
"""So much more, for a radian, the beginning of a detour counts in another direction than the last:
of two ways round as long the robot would take the one and the other in turns."""


def plan_detour(
    movement: LocalMovement, route: NDArray[np.float64], p: GoalFollowerParameters,
    last_rad: float = 0.0,
) -> DirectionCandidate | None:  # fmt: skip
    """Return how the shortest way round what stands on the route begins, None for no way.

    It leads to that place of the route behind it from which way and detour together are shortest.

    Args:
        movement: what the scan leaves free.
        route: (n, 2) m, in the robot's frame, from the robot's place on it.
        p: how wide the robot is, and what gaps it keeps.
        last_rad: where it was heading before.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    scan = movement.scan
    costs = _costs(
        movement.points, scan.ranges_m, scan.angle_min_rad, scan.angle_increment_rad,
        p.robot_radius_m, last_rad,
    )  # fmt: skip
    along_m, cells = _cells_of(route)
    barred = np.flatnonzero(~np.isfinite(costs[cells]))
    behind = slice(barred[0] if len(barred) else -1, None)
    along_m, cells = along_m[behind], cells[behind]
    grid = _grid()
    weights = grid.lengths_m * 0.5 * (costs[grid.sources] + costs[grid.targets])
    graph = csr_array((weights, grid.targets, grid.starts), shape=(ROWS * COLUMNS,) * 2)
    ways_m, before = dijkstra(graph, indices=_cell(0.0, 0.0), return_predecessors=True)
    more_m = ways_m[cells] - along_m
    if len(cells) == 0 or not more_m.min() < MOST_M:
        return None
    way = [int(cells[more_m.argmin()])]
    while (previous := int(before[way[-1]])) >= 0:
        way.append(previous)
    x_m, y_m = _place(np.array(way[::-1]))
    return _towards(x_m, y_m, movement, p)


def _towards(
    x_m: NDArray[np.float64], y_m: NDArray[np.float64], movement: LocalMovement,
    p: GoalFollowerParameters,
) -> DirectionCandidate | None:  # fmt: skip
    """Return the way to the furthest place of a detour that can be driven to straight on."""
    away_m = np.hypot(x_m, y_m)
    far = np.flatnonzero(away_m >= LOOK_AHEAD_M)
    for place in range(int(far[0]) if len(far) else len(away_m) - 1, 0, -1):
        heading_rad = math.atan2(y_m[place], x_m[place])
        open_m = movement.open_m(heading_rad, p.robot_radius_m + p.margin_m / 2)
        if open_m >= away_m[place]:
            ahead_m = movement.open_m(heading_rad, p.robot_radius_m)
            return DirectionCandidate('straight', heading_rad, ahead_m)
    return None


class _Grid(NamedTuple):
    """Steps from cell to cell: of each where it begins and ends, and its length, by source."""

    sources: NDArray[np.int32]
    targets: NDArray[np.int32]
    lengths_m: NDArray[np.float64]
    starts: NDArray[np.int32]


@cache
def _grid() -> _Grid:
    row, column = np.divmod(np.arange(ROWS * COLUMNS), COLUMNS)
    steps = []
    for d_row, d_column in ((a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b):
        to_row, to_column = row + d_row, column + d_column
        on = (to_row >= 0) & (to_row < ROWS) & (to_column >= 0) & (to_column < COLUMNS)
        source = np.flatnonzero(on)
        length_m = np.full(len(source), CELL_M * math.hypot(d_row, d_column))
        steps.append((source, to_row[on] * COLUMNS + to_column[on], length_m))
    source, target, length_m = (np.concatenate(part) for part in zip(*steps, strict=True))
    order = np.lexsort((target, source))
    starts = np.searchsorted(source[order], np.arange(ROWS * COLUMNS + 1))
    return _Grid(
        source[order].astype(np.int32), target[order].astype(np.int32), length_m[order],
        starts.astype(np.int32),
    )  # fmt: skip


def _cell(x_m: float, y_m: float) -> int:
    """Return the cell of a place on the grid."""
    return round((y_m + ASIDE_M) / CELL_M) * COLUMNS + round((x_m + BACK_M) / CELL_M)


def _place(cells: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x and y of the middles of cells."""
    rows, columns = np.divmod(cells, COLUMNS)
    return columns * CELL_M - BACK_M, rows * CELL_M - ASIDE_M


def _cells_of(route: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the beginning of a route as far as it lies on the grid: way along it, and cells."""
    lengths_m = np.hypot(*np.diff(route, axis=0).T)
    corners_m = np.concatenate([[0.0], np.cumsum(lengths_m)])
    along_m = np.arange(0.0, min(float(corners_m[-1]), 2.0 * FRONT_M), CELL_M)
    x, y = (np.interp(along_m, corners_m, route[:, axis]) for axis in (0, 1))
    off = np.flatnonzero((x < -BACK_M) | (x > FRONT_M) | (np.abs(y) > ASIDE_M))
    count = int(off[0]) if len(off) else len(along_m)
    columns, rows = np.rint((x + BACK_M) / CELL_M), np.rint((y + ASIDE_M) / CELL_M)
    return along_m[:count], (rows * COLUMNS + columns)[:count].astype(np.int64)


@compiled
def _costs(
    points: NDArray[np.float64], ranges_m: NDArray[np.float64], angle_min_rad: float,
    angle_increment_rad: float, radius_m: float, last_rad: float,
) -> NDArray[np.float64]:  # fmt: skip
    """Return what a way through each cell counts for its length; infinite: the robot does not fit.

    A cell is seen where the beam in its direction ends behind it, or does not end.
    """
    costs = np.ones(ROWS * COLUMNS)
    for cell in range(ROWS * COLUMNS):
        x = (cell % COLUMNS) * CELL_M - BACK_M
        y = (cell // COLUMNS) * CELL_M - ASIDE_M
        away = math.hypot(x, y)
        square = math.inf
        for i in range(len(points)):
            e_x, e_y = points[i, 0] - x, points[i, 1] - y
            square = min(square, e_x * e_x + e_y * e_y)
        gap = math.sqrt(square)
        if gap < radius_m and away > radius_m:
            costs[cell] = math.inf
            continue
        room = min(max((gap - radius_m) / ROOM_M, 0.0), 1.0)
        costs[cell] = TIGHT - (TIGHT - 1.0) * room
        bearing = math.atan2(y, x)
        turn = (bearing - angle_min_rad) % (2.0 * math.pi) if angle_increment_rad > 0.0 else (
            (angle_min_rad - bearing) % (2.0 * math.pi)
        )
        beam = round(turn / max(abs(angle_increment_rad), 1e-9))
        if beam >= len(ranges_m) or 0.0 < ranges_m[beam] < away:
            costs[cell] *= UNSEEN
        if away < FIRST_M:
            aside = abs((bearing - last_rad + math.pi) % (2.0 * math.pi) - math.pi)
            costs[cell] *= 1.0 + STEADY * aside
    return costs
