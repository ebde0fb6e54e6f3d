# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trials: a robot is sent to a goal, and the truth, which it never sees, judges how it did."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.errors import UnreachableGoal
from ratslam_ros.simulator.bodies import fits, room_for
from ratslam_ros.simulator.closed_loop import ClosedLoop

NEAR_M = 0.5
"""A trial has succeeded no further than this from the goal."""

SLOWEST = 3.0
"""And within so many times the shortest time."""

GRID_M = 0.1
"""Ways over the floor are looked for on a grid at least as fine as this."""

DRIVEN_M = 0.1
"""Of the places that were driven, one is kept of every square as wide as this."""

JOIN_M = 0.35
"""Places that were driven are joined where they are no further apart."""

REACH_M = 0.5
"""A way over the floor begins and ends at the free cell that is nearest, no further off."""

# Sixteen directions: with eight, ways would come out up to 8 % too long, with these 3 %.
_MOVES = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))


@dataclass(frozen=True, eq=False)
class Way:
    """A way over the floor: (n, 2) m from start to goal."""

    positions_m: NDArray[np.float64]

    @property
    def length_m(self) -> float:
        """How long it is."""
        return float(np.hypot(*np.diff(self.positions_m, axis=0).T).sum())

    def time_s(self, heading_rad: float, p: GoalFollowerParameters) -> float:
        """Return the time that it takes, by a robot that knows it and has the floor for itself.

        It turns on the spot to where the way leads, drives at its speed, and starts and stops as
        fast as it may brake.
        """
        x_m, y_m = (self._after(NEAR_M) - self.positions_m[0]).tolist()
        turn_rad = abs(math.remainder(math.atan2(y_m, x_m) - heading_rad, math.tau))
        # Below this there is no time to come to full speed.
        ramps_m = p.speed_mps**2 / p.braking_mps2
        if self.length_m < ramps_m:
            drive_s = 2.0 * math.sqrt(self.length_m / p.braking_mps2)
        else:
            drive_s = self.length_m / p.speed_mps + p.speed_mps / p.braking_mps2
        return drive_s + turn_rad / p.turn_rate_radps

    def _after(self, way_m: float) -> NDArray[np.float64]:
        along_m = np.cumsum(np.hypot(*np.diff(self.positions_m, axis=0).T))
        at = min(int(np.searchsorted(along_m, way_m)) + 1, len(self.positions_m) - 1)
        position: NDArray[np.float64] = self.positions_m[at]
        return position


class Floor:
    """The shortest ways that there are, whoever knows them."""

    def __init__(self, solid: NDArray[np.bool_], cell_m: float, radius_m: float) -> None:
        """Look where a body fits.

        Args:
            solid: (n_y, n_x) of a plan, or of a world with its obstacles.
            cell_m: side of a cell.
            radius_m: of the body.
        """
        finer = max(math.ceil(cell_m / GRID_M - 1e-9), 1)
        self._cell_m = cell_m / finer
        solid = np.kron(solid, np.ones((finer, finer), np.bool_))
        self._room = room_for(solid, self._cell_m, radius_m)
        if not self._room.any():
            self._graph = csr_array((solid.size, solid.size))
            return
        self._graph = _grid_graph(self._room, self._cell_m)
        # Of each cell, the nearest one with room.
        self._away, self._nearest = distance_transform_edt(~self._room, return_indices=True)

    def way(self, start: Pose, goal: tuple[float, float]) -> Way | None:
        """Return the shortest way; None where there is none."""
        first, last = self._node(start.x_m, start.y_m), self._node(*goal)
        if first is None or last is None:
            return None
        _, before = dijkstra(self._graph, directed=False, indices=first, return_predecessors=True)
        nodes = _backwards(before, first, last)
        if nodes is None:
            return None
        rows, columns = np.divmod(nodes, self._room.shape[1])
        cells = np.stack([columns + 0.5, rows + 0.5], axis=1) * self._cell_m
        # The cells of both ends are replaced by the ends themselves.
        return Way(np.concatenate([[start[:2]], cells[1:-1], [goal]]))

    def _node(self, x_m: float, y_m: float) -> int | None:
        n_y, n_x = self._room.shape
        row, column = int(y_m // self._cell_m), int(x_m // self._cell_m)
        if not (0 <= row < n_y and 0 <= column < n_x and self._room.any()):
            return None
        if self._away[row, column] * self._cell_m > REACH_M:
            return None
        row, column = self._nearest[:, row, column].tolist()
        return int(row * n_x + column)


class Driven:
    """The shortest ways over places where the robot has been: others it cannot know."""

    def __init__(self, positions_m: NDArray[np.float64]) -> None:
        """Take places, (n, 2 or more) m, x and y first, in any order."""
        positions_m = np.asarray(positions_m, np.float64)[:, :2]
        squares = np.floor(positions_m / DRIVEN_M).astype(np.int64)
        _, kept = np.unique(squares, axis=0, return_index=True)
        self.positions_m = positions_m[np.sort(kept)]

    def without(self, solid: NDArray[np.bool_], cell_m: float, radius_m: float) -> Driven:
        """Return those places where a body still fits: obstacles were put up since."""
        free = [fits(solid, cell_m, x, y, radius_m) for x, y in self.positions_m.tolist()]
        return Driven(self.positions_m[np.array(free, np.bool_)])

    def way(self, start: Pose, goal: tuple[float, float]) -> Way | None:
        """Return the shortest way; None where there is none."""
        points = np.concatenate([self.positions_m, [start[:2]], [goal]])
        pairs = cKDTree(points).query_pairs(JOIN_M, output_type='ndarray')
        lengths_m = np.hypot(*(points[pairs[:, 0]] - points[pairs[:, 1]]).T)
        # Places exactly on each other are joined too; a length of 0 would be no link.
        lengths_m = np.maximum(lengths_m, 1e-9)
        size = len(points)
        graph = coo_array((lengths_m, tuple(pairs.T)), shape=(size, size)).tocsr()
        _, before = dijkstra(graph, directed=False, indices=size - 2, return_predecessors=True)
        nodes = _backwards(before, size - 2, size - 1)
        return None if nodes is None else Way(points[nodes])


@dataclass(frozen=True, eq=False)
class Trial:
    """A goal, and how the robot got there.

    ``outcome``: of the errand, ``refused`` where there was none, ``given up`` at the limit.
    ``error_m``: true distance to the goal at the end. ``shortest``: the shortest way over places
    that the robot had driven, ``floor``: the shortest one that there is; None where there is none.
    ``shortest_s``: of the way that it could know, by which it is judged; ``floor_s``: of the other
    one. ``path``: (n, 3) true poses.
    """

    goal: str
    at_m: tuple[float, float]
    outcome: str
    error_m: float
    driven_m: float
    took_s: float
    shortest: Way | None
    floor: Way | None
    shortest_s: float
    floor_s: float
    path: NDArray[np.float64] = field(repr=False)
    tries_failed: int = 0
    links_unlearned: int = 0
    collisions: int = 0
    succeeded: bool = field(init=False)

    def __post_init__(self) -> None:
        told = self.outcome == 'succeeded' and self.took_s <= self.limit_s
        object.__setattr__(self, 'succeeded', told and self.error_m <= NEAR_M)

    @property
    def limit_s(self) -> float:
        """The time that it had."""
        return SLOWEST * self.shortest_s

    @property
    def ratio(self) -> float:
        """The path driven against the shortest in the graph of places driven before."""
        return self.driven_m / self.shortest.length_m if self.shortest else math.nan

    @property
    def floor_ratio(self) -> float:
        """The path driven against the shortest that there is."""
        return self.driven_m / self.floor.length_m if self.floor else math.nan


def attempt(loop: ClosedLoop, goal: str, at_m: tuple[float, float]) -> Trial:
    """Send the robot to a place by its name, and judge.

    The graph of driven places is that of all the robot has driven until now, less what is
    obstructed now. Where the robot has no way to the goal that it has driven, the shortest one on
    the floor counts; where there is none at all, the trial fails at the time limit of the goals.

    ``at_m``: where the goal truly is.
    """
    simulator, p = loop.simulator, loop.config.goal_follower
    world, radius_m = simulator.world, simulator.options.robot.body_radius_m
    start = Pose(simulator.truth.x_m, simulator.truth.y_m, simulator.truth.heading_rad)
    obstructed = world.solid, simulator.plan.cell_m, radius_m
    floor = Floor(*obstructed).way(start, at_m)
    shortest = Driven(loop.log.truths()).without(*obstructed).way(start, at_m)
    floor_s = math.inf if floor is None else floor.time_s(start.heading_rad, p)
    shortest_s = floor_s if shortest is None else shortest.time_s(start.heading_rad, p)
    began_s, odometer_m, first = loop.now_s, simulator.odometer_m, len(loop.log.truth)
    before = loop.tries_failed, loop.links_unlearned, simulator.collisions
    end_s = began_s + SLOWEST * shortest_s
    try:
        [errand] = loop.go_to(goal, until=lambda: loop.now_s > end_s)
        # What is not over at the limit is cancelled by the loop.
        outcome = 'given up' if errand.status == 'cancelled' else errand.status
    except UnreachableGoal:
        outcome = 'refused'
    failed, unlearned, collisions = before
    truth = simulator.truth
    path = np.array([start, *loop.log.truth[first:]], np.float64)
    return Trial(
        goal, at_m, outcome, math.hypot(truth.x_m - at_m[0], truth.y_m - at_m[1]),
        simulator.odometer_m - odometer_m, loop.now_s - began_s, shortest, floor, shortest_s,
        floor_s, path, loop.tries_failed - failed, loop.links_unlearned - unlearned,
        simulator.collisions - collisions,
    )  # fmt: skip


def choose_goals(
    places: Mapping[str, tuple[float, float]], here: Pose, count: int, rng: np.random.Generator
) -> list[str]:
    """Return goals that are far from each other and from the robot, in an order drawn by lot."""
    names = list(places)
    positions_m = np.array([places[name] for name in names], np.float64).reshape(-1, 2)
    away_m = np.hypot(positions_m[:, 0] - here.x_m, positions_m[:, 1] - here.y_m)
    chosen: list[int] = []
    for _ in range(min(count, len(names))):
        at = int(np.argmax(away_m))
        chosen.append(at)
        away_m = np.minimum(away_m, np.hypot(*(positions_m - positions_m[at]).T))
    return [names[at] for at in rng.permutation(chosen).tolist()]


def _grid_graph(room: NDArray[np.bool_], cell_m: float) -> csr_array:
    """Return the graph of cells, each linked once with those that a straight move leads to.

    A move needs all cells of the rectangle that it crosses: no corner is cut.
    """
    n_y, n_x = room.shape
    nodes = np.arange(n_y * n_x).reshape(n_y, n_x)
    starts, ends, lengths = [], [], []
    for rows, columns in _MOVES:
        # To the left means: the same rectangle, from its other lower corner.
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


def _backwards(before: NDArray[np.int32], first: int, last: int) -> NDArray[np.int64] | None:
    """Return the nodes of a way from its predecessors."""
    nodes = [last]
    while nodes[-1] != first:
        node = int(before[nodes[-1]])
        if node < 0:
            return None
        nodes.append(node)
    return np.array(nodes[::-1], np.int64)
