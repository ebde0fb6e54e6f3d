# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal memory: learn travel times between pose cells, and recall the direction to a goal.

Milford et al. (2005), section III: equations (1) to (6) as printed. It plans on the pose cells,
without an experience map, and therefore inherits their ambiguities: if two places share cells, it
plans shortcuts that do not exist, and if one place is represented by two sets of cells, it finds
routes from one of them only (Milford et al. (2006), section II.A). Our updates and routes are in
goal_routes.py.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.saved import MAX_COUNT, Field, Saved, count, named_numbers
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import AUTOMATIC, PoseCellsParameters
from ratslam_ros.core.goal_memory.plane import Plane
from ratslam_ros.core.goal_memory.published_links import (
    INITIAL_S,
    ITERATION_S,
    STAMP_JITTER_S,
    observations_s,
    updated_s,
)
from ratslam_ros.core.pose_cells.packet import MAX_CELLS
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnreachableGoal, UnusableParameter

Cells = NDArray[np.int64]
Activity = NDArray[np.float64]

SEARCH_CELLS = 4.0
"""Radius around a place in which the nearest linked cell stands for it: about that of a packet."""

SURROUNDING_CELLS = 2.0, 8.0
"""Distances from the peak of the cells that surround the packet, among which the direction is
searched. The paper does not give them: within 4 or 6 cells there often is no cell with less time,
because weak activity at the end of an observation gives links too large times."""

REACHED_CELLS = 1.0
"""Distance of the peak from a goal at which it is reached: section V.C."""


@dataclass(frozen=True)
class TemporalArray:
    """Time to reach one goal from every cell; Milford et al. (2005), equation (6).

    Attributes:
        goal: place of the goal.
        remaining_s: (n_y, n_x) time to the goal in seconds, infinite if no links lead to it.
        onward: (n_y, n_x) next cell on the fastest route, y * n_x + x; negative at the goal and
            if no links lead to it.
    """

    goal: Place
    remaining_s: NDArray[np.float64]
    onward: Cells


class GoalMemory(Saved):
    """Links between successively active pose cells with their travel times, and routes over them.

    Places passed to its methods are peaks of the pose cells.
    """

    SAVED = (
        Field('dims', '_plane', int, (2,), 1, MAX_CELLS, save=tuple,
              parameters='pc_dim_x and pc_dim_y'),
        Field('cells', '_numbers', 'i8', ('cells',), 0, MAX_COUNT,
              save=lambda numbers: np.fromiter(numbers, np.int64, len(numbers)),
              load=lambda cells: {cell: number for number, cell in enumerate(cells.tolist())},
              fits=('numbers of cells', lambda cells, state: (
                  np.max(cells, initial=0) < math.prod(state['dims'])
              ))),
        Field('ends', '_ends', 'i4', ('steps', 2), 0, 'cells',
              save=lambda ends: np.array(ends, np.int32).reshape(-1, 2),
              load=lambda ends: array('i', ends.tobytes())),
        Field('mu_s', '_mu_s', 'f8', ('steps',), 0.0,
              load=lambda mu_s: array('d', mu_s.tobytes())),
        Field('goals', 'goals', list, fits=named_numbers(3),
              save=lambda goals: [[name, *place] for name, place in goals.items()],
              load=lambda rows: {name: Place(*place) for name, *place in rows}),
        Field('present/travel_s', '_travel_s'),
        count('present/observations', '_observations'),
        Field('present/peak', '_previous_peak', float, (3,), make=Place, nullable=True),
        Field('present/activity', '_previous', float, ('', 2), nullable=True,
              save=lambda cells: cells.items(), load=lambda rows: dict(map(tuple, rows))),
    )

    def __init__(self, cells: PoseCellsParameters) -> None:
        """Create a memory without links for pose cells.

        Raises:
            UnusableParameter: the size of a cell is automatic.
        """
        self._least_active = cells.pc_global_inhib
        """All active cells are linked: those that global inhibition leaves. Shifts by parts of a
        cell spread activity down to 1e-52, whose chi would be 1e100 s."""
        if cells.pc_cell_x_size == AUTOMATIC:
            raise UnusableParameter(
                'goal_memory.goal_memory is true and pose_cells.pc_cell_x_size is -1; expected a '
                'size in m, because links between cells do not follow a change of the size'
            )
        self._plane = Plane(cells.pc_dim_x, cells.pc_dim_y)
        self._planes_per_rad = cells.pc_dim_th / (2.0 * math.pi)
        self.goals: dict[str, Place] = {}
        """Places of the marked goals by name."""
        # Cells and links are numbered in the order in which they are first linked. The key of a
        # link combines the numbers of its two cells.
        self._numbers: dict[int, int] = {}
        self._links: dict[int, int] = {}
        self._ends = array('i')
        self._mu_s = array('d')
        self._observations = 0
        self._recalled: tuple[Place, int, TemporalArray] | None = None
        self.relocated()

    def __len__(self) -> int:
        """Return the number of links; links are undirected."""
        return len(self._mu_s)

    def relocated(self) -> None:
        """Discard the previous activity: the motion since then was not observed."""
        self._previous: dict[int, float] | None = None
        self._previous_peak: Place | None = None
        self._travel_s = 0.0

    def integrate(self, motion: Motion, pose_cells: PoseCells) -> None:
        """Learn from one motion, after the pose cells integrated it: after each iteration."""
        if not (pose_cells.mapping and motion.is_known):
            self.relocated()
            return
        self._travel_s += motion.dt_s
        if self._travel_s >= ITERATION_S - STAMP_JITTER_S:
            self.learn(self._travel_s, *pose_cells.projected())
            self._travel_s = 0.0

    def learn(self, elapsed_s: float, cells: Cells, activity: Activity) -> None:
        """Link the active cells to those that were active in the last iteration: (2) to (5).

        Args:
            elapsed_s: time since the last iteration.
            cells: (n,) distinct cell numbers y * n_x + x.
            activity: (n,) their activity, summed over all headings: (1).
        """
        active = activity > self._least_active
        cells, activity = cells[active], activity[active]
        previous = self._previous
        self._previous = dict(zip(cells.tolist(), activity.tolist(), strict=True))
        if previous is None:
            return
        self._observations += 1
        before = np.array(list(previous), np.int64), np.array(list(previous.values()), np.float64)
        seconds = observations_s(before, (cells, activity), elapsed_s, self._plane)
        for i, row in zip(previous, seconds.tolist(), strict=True):
            for j, observed_s in zip(self._previous, row, strict=True):
                if i != j:
                    self._observe(i, j, observed_s, INITIAL_S)

    def _observe(
        self, i: int, j: int, seconds: float, initial_s: float | None = None
    ) -> None:
        """Average a link's time with an observation, by equation (5).

        Args:
            i, j: cells that the link joins.
            seconds: the observation.
            initial_s: time of the link before the first observation; None: that observation.
        """
        numbers = self._numbers
        a, b = numbers.setdefault(i, len(numbers)), numbers.setdefault(j, len(numbers))
        key = a << 32 | b if a < b else b << 32 | a
        link = self._links.setdefault(key, len(self._mu_s))
        if link == len(self._mu_s):
            self._ends.extend((a, b))
            self._mu_s.append(seconds if initial_s is None else updated_s(initial_s, seconds))
        else:
            self._mu_s[link] = updated_s(self._mu_s[link], seconds)

    # Goals

    def mark(self, name: str, peak: Place) -> None:
        """Store the place of the peak as a goal; a goal of the same name is replaced."""
        self.goals[name] = peak

    def goal(self, name: str) -> Place:
        """Return the place of a goal.

        Raises:
            UnreachableGoal: no goal has this name.
        """
        if name not in self.goals:
            known = ', '.join(self.goals) or 'none yet'
            raise UnreachableGoal(f'no goal is named {name!r}; known: {known}: mark it first')
        return self.goals[name]

    def reached(self, goal: Place, peak: Place, within_cells: float = REACHED_CELLS) -> bool:
        """Return whether the peak is at the goal, with any heading: section V.C."""
        return self._plane.distance(goal, peak) <= within_cells

    def blocked(self, peak: Place, bearing_rad: float, tried_s: float) -> int:
        """Return the number of links that a blocked way changes: none by equations (2) to (5)."""
        return 0

    # Recall

    def recall(self, goal: Place) -> TemporalArray:
        """Compute the times to a goal from all cells that are connected to it.

        The goal is represented by the nearest linked cell within the search radius. The result is
        cached until another goal is requested or a link changes.

        Raises:
            UnreachableGoal: there is no linked cell within the search radius.
        """
        if self._recalled is None or self._recalled[:2] != (goal, self._observations):
            self._recalled = goal, self._observations, self._compute(goal)
        return self._recalled[2]

    def _compute(self, goal: Place) -> TemporalArray:
        around = self._plane.around(goal, SEARCH_CELLS)
        linked = [cell for *_, cell in around if cell in self._numbers]
        if not linked:
            raise UnreachableGoal(
                f'no cell near x {goal.x:.1f}, y {goal.y:.1f} has been linked; drive there first'
            )
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import dijkstra

        count = len(self._numbers)
        ends = np.array(self._ends, np.int32).reshape(-1, 2)
        links = csr_array((np.array(self._mu_s), (ends[:, 0], ends[:, 1])), shape=(count, count))
        times_s, previous = dijkstra(
            links, directed=False, indices=self._numbers[linked[0]], return_predecessors=True
        )
        cells = np.fromiter(self._numbers, np.int64, count)
        remaining_s = np.full(self._plane.n_y * self._plane.n_x, np.inf)
        remaining_s[cells] = times_s
        onward = np.full(len(remaining_s), -1, np.int64)
        onward[cells] = np.where(previous >= 0, cells[np.maximum(previous, 0)], -1)
        shape = self._plane.n_y, self._plane.n_x
        return TemporalArray(goal, remaining_s.reshape(shape), onward.reshape(shape))

    def remaining_s(self, times: TemporalArray, peak: Place) -> float:
        """Return the time to the goal in s from the nearest linked cell; infinite without one."""
        start = self._start(times, peak)
        return math.inf if start is None else float(times.remaining_s.flat[start])

    def direction(self, times: TemporalArray, peak: Place) -> float | None:
        """Return the direction in which the time decreases fastest (section III.B).

        Returns:
            Direction in the plane of the cells in rad, counter-clockwise from x; None if the goal
            is reached, or if the time decreases nowhere.
        """
        start = self._start(times, peak)
        if start is None or self.reached(times.goal, peak):
            return None
        start_s = float(times.remaining_s.flat[start])
        steepest, best_rad = 0.0, None
        least, most = SURROUNDING_CELLS
        for distance, dx, dy, cell in self._plane.around(peak, most):
            descent = (start_s - float(times.remaining_s.flat[cell])) / max(distance, least)
            is_goal = times.onward.flat[cell] < 0
            if (distance >= least or is_goal) and descent > steepest:
                steepest, best_rad = descent, math.atan2(dy, dx)
        return best_rad

    def bearing(self, times: TemporalArray, peak: Place) -> float | None:
        """Return ``direction`` relative to the robot's heading: rad, positive to the left."""
        direction = self.direction(times, peak)
        return None if direction is None else wrap(direction - self._heading(peak))

    # Cells

    def _start(self, times: TemporalArray, peak: Place) -> int | None:
        """Return the nearest cell connected to the goal, None if none is in the search radius."""
        cells = (cell for *_, cell in self._plane.around(peak, SEARCH_CELLS))
        return next((one for one in cells if math.isfinite(times.remaining_s.flat[one])), None)

    def _heading(self, peak: Place) -> float:
        return peak.theta / self._planes_per_rad

    # Memory

    def _restored(self, state: State) -> None:
        pairs = state['ends'].tolist()
        self._links = {min(p) << 32 | max(p): link for link, p in enumerate(pairs)}
