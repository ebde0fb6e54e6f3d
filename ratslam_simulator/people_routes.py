# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shortest routes of people over the free cells of the floor."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ratslam_simulator.bodies import room_for
from ratslam_simulator.world import PERSON_RADIUS_M

if TYPE_CHECKING:
    from scipy.sparse import csr_array

COMFORT_MARGIN_M = 0.1
"""Free space beside the body that people prefer to have."""

NEAR_WALL_COST_RATIO = 2.0
"""Cost per metre in cells without the comfort margin, relative to cells with it."""

TOO_NARROW_COST_RATIO = 1000.0
"""Cost per metre in cells where a person does not fit, relative to cells with the margin."""


class PeopleRoutes:
    """Next cells on the shortest routes to a fixed set of destination cells.

    The routes to a destination are computed when they are first asked for.

    Attributes:
        next_cell: (destinations, cells) int32, the next cell on the route from each cell, -1 if
            the cell is the destination, has no route to it, or the routes are not yet computed.
    """

    def __init__(
        self, solid: NDArray[np.bool_], cell_m: float, destinations: NDArray[np.intp]
    ) -> None:
        """Prepare routes over a floor.

        Args:
            solid: (n_y, n_x), cells of walls and obstacles.
            cell_m: side of a cell.
            destinations: (n,) flat indices of cells.
        """
        self._solid = solid
        self._cell_m = cell_m
        self._destinations = destinations
        self.next_cell = np.full((len(destinations), solid.size), -1, np.int32)
        self._computed = np.zeros(len(destinations), bool)
        self._graph: csr_array | None = None

    def to(self, destination: int) -> NDArray[np.int32]:
        """Return the row of `next_cell` for a destination, computed if necessary."""
        if not self._computed[destination]:
            from scipy.sparse.csgraph import dijkstra  # slow to import

            if self._graph is None:
                self._graph = _graph(self._solid, self._cell_m)
            _, before = dijkstra(
                self._graph, indices=self._destinations[destination], return_predecessors=True
            )
            self.next_cell[destination] = np.maximum(before, -1)
            self._computed[destination] = True
        row: NDArray[np.int32] = self.next_cell[destination]
        return row


def _graph(solid: NDArray[np.bool_], cell_m: float) -> csr_array:
    """Connect free cells with their eight neighbours, at a higher cost near walls."""
    from scipy.sparse import csr_array

    factor = np.where(
        room_for(solid, cell_m, PERSON_RADIUS_M), NEAR_WALL_COST_RATIO, TOO_NARROW_COST_RATIO
    )
    factor[room_for(solid, cell_m, PERSON_RADIUS_M + COMFORT_MARGIN_M)] = 1.0
    number = np.arange(solid.size, dtype=np.int32).reshape(solid.shape)
    sources, targets, lengths = [], [], []
    for step_y, step_x in ((0, 1), (1, 0), (1, 1), (1, -1)):
        n_y, n_x = solid.shape
        first = (slice(0, n_y - step_y), slice(max(-step_x, 0), n_x - max(step_x, 0)))
        second = (slice(step_y, n_y), slice(max(step_x, 0), n_x + min(step_x, 0)))
        free = ~solid[first] & ~solid[second]
        sources.append(number[first][free])
        targets.append(number[second][free])
        step_m = cell_m * math.hypot(step_x, step_y)
        lengths.append(step_m * np.maximum(factor[first], factor[second])[free])
    source, target = np.concatenate(sources), np.concatenate(targets)
    length = np.concatenate(lengths)
    both = (np.concatenate([source, target]), np.concatenate([target, source]))
    return csr_array((np.concatenate([length, length]), both), (solid.size, solid.size))
