# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shortest paths of a robot over the floor, and over the places where it has been."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_simulator.bodies import fits, room_for

GRID_M = 0.1
"""Largest side of a cell in the graph of the floor."""

DRIVEN_M = 0.1
"""Side of the squares of which the graph of driven places keeps one place each."""

JOIN_M = 0.35
"""Distance up to which driven places are connected."""

REACH_M = 0.5
"""Largest distance from an end of a path to the nearest cell where the body fits."""

TURN_AHEAD_M = 0.5
"""Path length to the point that the robot turns to before it starts."""

_MOVES = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))
"""Moves in rows and columns that link cells of the floor, one for each pair of directions.

With these 16 directions paths are at most 3 % too long; with 8 it would be 8 %.
"""


@dataclass(frozen=True, eq=False)
class FloorPath:
    """A path over the floor: positions in metres from start to goal, (n, 2)."""

    positions_m: NDArray[np.float64]

    @property
    def length_m(self) -> float:
        """Length of the path, in metres."""
        return float(np.hypot(*np.diff(self.positions_m, axis=0).T).sum())

    def time_s(self, heading_rad: float, p: GoalFollowerParameters) -> float:
        """Return the shortest time for the path, in seconds.

        The robot turns on the spot to the direction of the path, and drives at its speed, with
        its braking deceleration at both ends.

        Args:
            heading_rad: heading at the start.
            p: speeds and deceleration.
        """
        x_m, y_m = (self._after(TURN_AHEAD_M) - self.positions_m[0]).tolist()
        turn_rad = abs(math.remainder(math.atan2(y_m, x_m) - heading_rad, math.tau))
        # On a shorter path the robot does not reach full speed.
        ramps_m = p.speed_mps**2 / p.braking_mps2
        if self.length_m < ramps_m:
            drive_s = 2.0 * math.sqrt(self.length_m / p.braking_mps2)
        else:
            drive_s = self.length_m / p.speed_mps + p.speed_mps / p.braking_mps2
        return drive_s + turn_rad / p.turn_rate_radps

    def _after(self, length_m: float) -> NDArray[np.float64]:
        along_m = np.cumsum(np.hypot(*np.diff(self.positions_m, axis=0).T))
        at = min(int(np.searchsorted(along_m, length_m)) + 1, len(self.positions_m) - 1)
        position: NDArray[np.float64] = self.positions_m[at]
        return position


class FloorGraph:
    """Graph of the cells of the floor where a body fits."""

    def __init__(self, solid: NDArray[np.bool_], cell_m: float, radius_m: float) -> None:
        """Build the graph.

        Args:
            solid: (n_y, n_x), cells of walls and obstacles.
            cell_m: side of a cell.
            radius_m: radius of the body.
        """
        finer = max(math.ceil(cell_m / GRID_M - 1e-9), 1)
        self._cell_m = cell_m / finer
        solid = np.kron(solid, np.ones((finer, finer), np.bool_))
        self._room = room_for(solid, self._cell_m, radius_m)
        if not self._room.any():
            self._graph = csr_array((solid.size, solid.size))
            return
        self._graph = _grid_graph(self._room, self._cell_m)
        # Distance, and row and column, of the nearest cell with room, for each cell.
        self._away, self._nearest = distance_transform_edt(~self._room, return_indices=True)

    def shortest_path(self, start: Pose, goal: tuple[float, float]) -> FloorPath | None:
        """Return the shortest path from a pose to a position, None if there is none."""
        first, last = self._node(start.x_m, start.y_m), self._node(*goal)
        if first is None or last is None:
            return None
        _, before = dijkstra(self._graph, directed=False, indices=first, return_predecessors=True)
        nodes = _trace_back(before, first, last)
        if nodes is None:
            return None
        rows, columns = np.divmod(nodes, self._room.shape[1])
        cells = np.stack([columns + 0.5, rows + 0.5], axis=1) * self._cell_m
        # The ends replace the cells in which they are.
        return FloorPath(np.concatenate([[start[:2]], cells[1:-1], [goal]]))

    def _node(self, x_m: float, y_m: float) -> int | None:
        n_y, n_x = self._room.shape
        row, column = int(y_m // self._cell_m), int(x_m // self._cell_m)
        if not (0 <= row < n_y and 0 <= column < n_x and self._room.any()):
            return None
        if self._away[row, column] * self._cell_m > REACH_M:
            return None
        row, column = self._nearest[:, row, column].tolist()
        return int(row * n_x + column)


class DrivenGraph:
    """Graph of the places where the robot has been, and over which its map can lead it."""

    def __init__(self, positions_m: NDArray[np.float64]) -> None:
        """Build the graph.

        Args:
            positions_m: (n, 2 or more), x and y first, in any order.
        """
        positions_m = np.asarray(positions_m, np.float64)[:, :2]
        squares = np.floor(positions_m / DRIVEN_M).astype(np.int64)
        _, kept = np.unique(squares, axis=0, return_index=True)
        self.positions_m = positions_m[np.sort(kept)]

    def without(self, solid: NDArray[np.bool_], cell_m: float, radius_m: float) -> DrivenGraph:
        """Return the graph without the places that are now blocked for a body by solid cells."""
        free = [fits(solid, cell_m, x, y, radius_m) for x, y in self.positions_m.tolist()]
        return DrivenGraph(self.positions_m[np.array(free, np.bool_)])

    def shortest_path(self, start: Pose, goal: tuple[float, float]) -> FloorPath | None:
        """Return the shortest path from a pose to a position, None if there is none."""
        points = np.concatenate([self.positions_m, [start[:2]], [goal]])
        pairs = cKDTree(points).query_pairs(JOIN_M, output_type='ndarray')
        lengths_m = np.hypot(*(points[pairs[:, 0]] - points[pairs[:, 1]]).T)
        # A sparse matrix has no entries of 0: identical places need a positive length.
        lengths_m = np.maximum(lengths_m, 1e-9)
        size = len(points)
        graph = coo_array((lengths_m, pairs.T.astype(np.int32)), shape=(size, size)).tocsr()
        _, before = dijkstra(graph, directed=False, indices=size - 2, return_predecessors=True)
        nodes = _trace_back(before, size - 2, size - 1)
        return None if nodes is None else FloorPath(points[nodes])


def _grid_graph(room: NDArray[np.bool_], cell_m: float) -> csr_array:
    """Return the graph of cells with their moves, each stored once with its length.

    A move requires room in all cells of the rectangle that it crosses, so that no corner is cut.
    """
    n_y, n_x = room.shape
    nodes = np.arange(n_y * n_x, dtype=np.int32).reshape(n_y, n_x)
    starts, ends, lengths = [], [], []
    for rows, columns in _MOVES:
        # A move to the left crosses the same rectangle from its other lower corner.
        width = abs(columns)
        free = np.ones((n_y - rows, n_x - width), np.bool_)
        for row in range(rows + 1):
            for column in range(width + 1):
                free &= room[row : n_y - rows + row, column : n_x - width + column]
        left, right = nodes[: n_y - rows, : n_x - width], nodes[: n_y - rows, width:]
        above_left, above_right = nodes[rows:, : n_x - width], nodes[rows:, width:]
        starts.append((left if columns >= 0 else right)[free])
        ends.append((above_right if columns >= 0 else above_left)[free])
        lengths.append(np.full(int(free.sum()), math.hypot(rows, columns) * cell_m))
    edges = np.concatenate(starts), np.concatenate(ends)
    graph: csr_array = coo_array(
        (np.concatenate(lengths), edges), shape=(room.size, room.size)
    ).tocsr()
    return graph


def _trace_back(before: NDArray[np.int32], first: int, last: int) -> NDArray[np.int64] | None:
    """Return the nodes of a path from the predecessors of all nodes, None if there is no path."""
    nodes = [last]
    while nodes[-1] != first:
        node = int(before[nodes[-1]])
        if node < 0:
            return None
        nodes.append(node)
    return np.array(nodes[::-1], np.int64)
