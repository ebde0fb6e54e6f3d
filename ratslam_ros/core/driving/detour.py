# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detour: obstacle avoidance by the shortest path on a local cost grid."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.free_directions import DirectionCandidate, LocalMovement

if TYPE_CHECKING:  # SciPy loads slowly
    from scipy.sparse import csr_array

CELL_M = 0.1
"""Side of a cell of the grid in m."""

GRID_BACK_M, GRID_FRONT_M, GRID_SIDE_M = 1.0, 4.0, 2.5
"""Extents of the grid behind, ahead of and to each side of the robot in m."""

ROW_COUNT = round(2 * GRID_SIDE_M / CELL_M) + 1
COLUMN_COUNT = round((GRID_BACK_M + GRID_FRONT_M) / CELL_M) + 1
"""Numbers of rows and columns of the grid."""

ROBOT_CELL = round(GRID_SIDE_M / CELL_M) * COLUMN_COUNT + round(GRID_BACK_M / CELL_M)
"""Index of the cell of the robot."""

TIGHT_COST_FACTOR = 4.0
"""Cost factor of a cell where the robot just fits; decreases to 1 with the clearance."""

FULL_CLEARANCE_M = 0.3
"""Clearance beside the robot from which a cell has no extra cost, in m."""

UNSEEN_COST_FACTOR = 2.0
"""Cost factor of a cell that the laser does not see."""

MAX_EXTRA_COST_M = 4.0
"""Extra cost of a detour over the route from which the route counts as closed, in m."""

LOOKAHEAD_M = 0.8
"""Distance of the point of the detour that the robot heads for, in m."""

TURN_COST_PER_RAD = 0.5
"""Extra cost factor per rad between the start of a detour and the last heading. This hysteresis
avoids switching between two detours of equal length."""

TURN_COST_RADIUS_M = 0.5
"""Distance from the robot within which TURN_COST_PER_RAD applies, in m."""


def plan_detour(
    movement: LocalMovement, route: NDArray[np.float64], p: GoalFollowerParameters,
    last_rad: float = 0.0,
) -> DirectionCandidate | None:
    """Return the first direction of the cheapest detour round the obstacles on the route.

    The detour rejoins the route behind the first obstacle, at the point with the least total cost
    of detour and remaining route.

    Args:
        movement: the free directions of the scan.
        route: (n, 2) route in the frame of the robot in m, from the robot on.
        p: size and margins of the robot.
        last_rad: the last heading.

    Returns:
        None if there is no detour, or only one that costs MAX_EXTRA_COST_M more than the route.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    scan = movement.scan
    costs = _cell_costs(
        movement.points, scan.ranges_m, scan.angle_min_rad, scan.angle_increment_rad,
        scan.x_m, scan.y_m, p.robot_radius_m, last_rad,
    )
    along_m, cells = _route_cells(route)
    blocked = np.flatnonzero(~np.isfinite(costs[cells]))
    behind = slice(blocked[0] if len(blocked) else -1, None)
    along_m, cells = along_m[behind], cells[behind]
    sources, grid = _grid()
    weights = grid.data * 0.5 * (costs[sources] + costs[grid.indices])
    graph = csr_array((weights, grid.indices, grid.indptr), shape=grid.shape)
    costs_m, predecessors = dijkstra(graph, indices=ROBOT_CELL, return_predecessors=True)
    extra_m = costs_m[cells] - along_m
    if len(cells) == 0 or not extra_m.min() < MAX_EXTRA_COST_M:
        return None
    path = [int(cells[extra_m.argmin()])]
    while (previous := int(predecessors[path[-1]])) >= 0:
        path.append(previous)
    rows, columns = np.divmod(np.array(path[::-1]), COLUMN_COUNT)
    return _first_direction(
        columns * CELL_M - GRID_BACK_M, rows * CELL_M - GRID_SIDE_M, movement, p
    )


def _first_direction(
    x_m: NDArray[np.float64], y_m: NDArray[np.float64], movement: LocalMovement,
    p: GoalFollowerParameters,
) -> DirectionCandidate | None:
    """Return the direction of the farthest point, up to LOOKAHEAD_M, that is free straight on."""
    away_m = np.hypot(x_m, y_m)
    far = np.flatnonzero(away_m >= LOOKAHEAD_M)
    for point in range(int(far[0]) if len(far) else len(away_m) - 1, 0, -1):
        heading_rad = math.atan2(y_m[point], x_m[point])
        free_m = movement.free_m(heading_rad, p.robot_radius_m + p.margin_m / 2)
        if free_m >= away_m[point]:
            ahead_m = movement.free_m(heading_rad, p.robot_radius_m)
            return DirectionCandidate('straight', heading_rad, ahead_m)
    return None


@cache
def _grid() -> tuple[NDArray[np.int32], csr_array]:
    """Return the sources of the edges between neighbouring cells, and their lengths in m."""
    from scipy.sparse import csr_array

    count = ROW_COUNT * COLUMN_COUNT
    row, column = np.divmod(np.arange(count), COLUMN_COUNT)
    lengths_m, sources, targets = [], [], []
    for d_row, d_column in ((a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b):
        to_row, to_column = row + d_row, column + d_column
        on = (to_row >= 0) & (to_row < ROW_COUNT) & (to_column >= 0) & (to_column < COLUMN_COUNT)
        sources.append(np.flatnonzero(on))
        targets.append((to_row * COLUMN_COUNT + to_column)[on])
        lengths_m.append(np.full(len(sources[-1]), CELL_M * math.hypot(d_row, d_column)))
    ends = np.stack([np.concatenate(sources), np.concatenate(targets)]).astype(np.int32)
    graph = csr_array((np.concatenate(lengths_m), ends), shape=(count, count))
    return np.repeat(np.arange(count, dtype=np.int32), np.diff(graph.indptr)), graph


def _route_cells(route: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the distances along a route in m, and the cells there, until it leaves the grid."""
    lengths_m = np.hypot(*np.diff(route, axis=0).T)
    corners_m = np.concatenate([[0.0], np.cumsum(lengths_m)])
    along_m = np.arange(0.0, min(float(corners_m[-1]), 2.0 * GRID_FRONT_M), CELL_M)
    x, y = (np.interp(along_m, corners_m, route[:, axis]) for axis in (0, 1))
    off = np.flatnonzero((x < -GRID_BACK_M) | (x > GRID_FRONT_M) | (np.abs(y) > GRID_SIDE_M))
    count = int(off[0]) if len(off) else len(along_m)
    columns, rows = np.rint((x + GRID_BACK_M) / CELL_M), np.rint((y + GRID_SIDE_M) / CELL_M)
    return along_m[:count], (rows * COLUMN_COUNT + columns)[:count].astype(np.int64)


@compiled
def _cell_costs(
    points: NDArray[np.float64], ranges_m: NDArray[np.float64], angle_min_rad: float,
    angle_increment_rad: float, laser_x_m: float, laser_y_m: float, radius_m: float,
    last_rad: float,
) -> NDArray[np.float64]:
    """Return the (cells,) cost factors; infinite where the robot does not fit.

    A cell is seen if the beam in its direction ends behind it or does not end.
    """
    costs = np.ones(ROW_COUNT * COLUMN_COUNT)
    for cell in range(ROW_COUNT * COLUMN_COUNT):
        x = (cell % COLUMN_COUNT) * CELL_M - GRID_BACK_M
        y = (cell // COLUMN_COUNT) * CELL_M - GRID_SIDE_M
        away = math.hypot(x, y)
        square = math.inf
        for i in range(len(points)):
            e_x, e_y = points[i, 0] - x, points[i, 1] - y
            square = min(square, e_x * e_x + e_y * e_y)
        gap = math.sqrt(square)
        if gap < radius_m and away > radius_m:
            costs[cell] = math.inf
            continue
        room = min(max((gap - radius_m) / FULL_CLEARANCE_M, 0.0), 1.0)
        costs[cell] = TIGHT_COST_FACTOR - (TIGHT_COST_FACTOR - 1.0) * room
        seen_at = math.atan2(y - laser_y_m, x - laser_x_m)
        turn = (seen_at - angle_min_rad) % (2.0 * math.pi) if angle_increment_rad > 0.0 else (
            (angle_min_rad - seen_at) % (2.0 * math.pi)
        )
        beam = round(turn / max(abs(angle_increment_rad), 1e-9))
        from_laser = math.hypot(x - laser_x_m, y - laser_y_m)
        if beam >= len(ranges_m) or 0.0 < ranges_m[beam] < from_laser:
            costs[cell] *= UNSEEN_COST_FACTOR
        bearing = math.atan2(y, x)
        if away < TURN_COST_RADIUS_M:
            aside = abs((bearing - last_rad + math.pi) % (2.0 * math.pi) - math.pi)
            costs[cell] *= 1.0 + TURN_COST_PER_RAD * aside
    return costs
