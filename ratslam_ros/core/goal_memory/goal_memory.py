# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal memory: learn travel times between pose cells, and plan routes to goals over them.

The method of Milford et al. (2005). It plans on the pose cells, without an experience map, and
therefore inherits their ambiguities: if two places share cells, it plans shortcuts that do not
exist, and if one place is represented by two sets of cells, it finds routes from one of them only
(Milford et al. (2006), section II.A).
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.saved import MAX_COUNT, Field, Saved, count, named_numbers
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import AUTOMATIC, PoseCellsParameters
from ratslam_ros.core.goal_memory.published_links import (
    ETA_CHI_S,
    ETA_DELTA_S,
    ETA_TAU,
    INITIAL_S,
    ITERATION_S,
    STAMP_JITTER_S,
    observations_s,
    updated_s,
)
from ratslam_ros.core.pose_cells.packet import MAX_CELLS
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.torus import Place, Torus
from ratslam_ros.errors import UnreachableGoal, UnusableParameter

Cells = NDArray[np.int64]
Activity = NDArray[np.float64]

STEP_CELLS = 1.0
"""Distance in cells between updates of the links. With shorter steps slow and fast routes hardly
differ, with longer ones routes cut corners (docs/algorithm.md)."""

ACTIVE_SHARE = 0.3
"""Cells with at least this share of the largest activity are linked: about nine for a packet."""

SEARCH_CELLS = 4.0
"""Radius around the peak in which cells contribute to the direction to the goal: smooth, and
narrower than the distance between two paths."""

REACHED_CELLS = 1.0
"""Distance of the peak from a goal at which it is reached, as in the paper."""

STATIONARY_CELLS_PER_S = 0.02
"""Speed up to which the robot counts as stationary: no travel time is added, no link learned."""

MAX_LINK_CELLS = STEP_CELLS + 6.0
"""Maximum length of a link that is a motion: a step plus the extent of a packet. Longer links
connect packets at different places: they are jumps of the packet."""

BARRIER_AHEAD_CELLS = 1.0
"""Distance ahead of a blocked robot of the line across which links are penalised."""

BARRIER_HALF_WIDTH_CELLS = 2.0
"""Half the length of that line."""

SECTOR_COS = math.cos(math.radians(45.0))
"""Cosine of the largest angle to the route of cells that contribute to the direction."""


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
        Field('dims', '_torus', int, (2,), 1, MAX_CELLS,
              save=lambda torus: (torus.n_x, torus.n_y), parameters='pc_dim_x and pc_dim_y'),
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

    def __init__(self, cells: PoseCellsParameters, update: str = 'cell') -> None:
        """Create a memory without links.

        Args:
            cells: extents and size of the pose cells.
            update: ``goal_memory_update``.

        Raises:
            UnusableParameter: the size of a cell is automatic.
        """
        self._is_published = update == 'iteration'
        self._least_active = cells.pc_global_inhib
        """As published, all active cells are linked: here those that global inhibition leaves.
        Shifts by parts of a cell spread activity down to 1e-52, whose chi would be 1e100 s."""
        if cells.pc_cell_x_size == AUTOMATIC:
            raise UnusableParameter(
                'goal_memory.goal_memory is true and pose_cells.pc_cell_x_size is -1; expected a '
                'size in m, because links between cells do not follow a change of the size'
            )
        self._torus = Torus(cells.pc_dim_x, cells.pc_dim_y, cells.pc_dim_th)
        self._cell_m = cells.pc_cell_x_size
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
        """Learn from one motion, after the pose cells integrated it.

        Links are updated whenever the peak has moved by STEP_CELLS, or after each iteration.
        """
        if not (pose_cells.mapping and motion.is_known):
            self.relocated()
            return
        if self._is_published:
            self._travel_s += motion.dt_s
            if self._travel_s >= ITERATION_S - STAMP_JITTER_S:
                self.learn(self._travel_s, *pose_cells.projected())
                self._travel_s = 0.0
            return
        if abs(motion.distance_m) <= STATIONARY_CELLS_PER_S * self._cell_m * motion.dt_s:
            return
        self._travel_s += motion.dt_s
        peak, previous = pose_cells.peak, self._previous_peak
        if previous is not None and self._distance(previous, peak) < STEP_CELLS:
            return
        self._previous_peak = peak
        self.learn(self._travel_s, *pose_cells.projected())
        self._travel_s = 0.0

    def learn(self, travel_s: float, cells: Cells, activity: Activity) -> None:
        """Link the active cells to those that were active at the previous call.

        After Milford et al. (2005), equations (2) to (5), which published_links.py has as printed.
        Here each pair of cells is observed once: of the two orders, i before j and j before i, the
        one with the larger product of activities. The first observation sets a link.

        Args:
            travel_s: time for which the robot moved since the previous call; as published, all
                time since then.
            cells: (n,) distinct cell numbers y * n_x + x.
            activity: (n,) their activity, summed over all headings.
        """
        if self._is_published:
            self._learn_as_published(travel_s, cells, activity)
            return
        largest = float(activity.max())
        active = activity >= ACTIVE_SHARE * largest
        now = dict(zip(cells[active].tolist(), (activity[active] / largest).tolist(), strict=True))
        previous, self._previous = self._previous, now
        if previous is None:
            return
        self._observations += 1
        products: dict[tuple[int, int], float] = {}
        for i, share_before in previous.items():
            for j, share_now in now.items():
                pair = (i, j) if i < j else (j, i)
                product = share_before * share_now
                if i != j and product > products.get(pair, 0.0):
                    products[pair] = product
        tau = ETA_TAU * travel_s
        for (i, j), product in products.items():
            chi = ETA_CHI_S * (1.0 / product - 1.0)
            delta = ETA_DELTA_S * self._distance(self._place(i), self._place(j))
            self._observe(i, j, tau + chi + delta)

    def _learn_as_published(self, elapsed_s: float, cells: Cells, activity: Activity) -> None:
        active = activity > self._least_active
        cells, activity = cells[active], activity[active]
        previous = self._previous
        self._previous = dict(zip(cells.tolist(), activity.tolist(), strict=True))
        if previous is None:
            return
        self._observations += 1
        before = np.array(list(previous), np.int64), np.array(list(previous.values()), np.float64)
        extents = self._torus.n_x, self._torus.n_y
        seconds = observations_s(before, (cells, activity), elapsed_s, extents)
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

    def blocked(self, peak: Place, bearing_rad: float, tried_s: float) -> int:
        """Increase the times of the links that cross a line just ahead of a blocked robot.

        The failed attempt counts as an observation of the link's time plus ``tried_s``. If the
        path becomes free, driving it averages the increase out.

        Args:
            peak: position of the robot.
            bearing_rad: blocked direction relative to the heading, positive to the left.
            tried_s: total duration of the attempts.

        Returns:
            The number of links.
        """
        direction = self._heading(peak) + bearing_rad
        cos, sin = math.cos(direction), math.sin(direction)
        cells = np.fromiter(self._numbers, np.int64, len(self._numbers))
        ends = cells[np.array(self._ends, np.int32).reshape(-1, 2)]
        first, second = self._place(ends[:, 0]), self._place(ends[:, 1])
        (x, y), (dx, dy) = self._offset(peak, first), self._offset(first, second)
        ahead, aside = x * cos + y * sin - BARRIER_AHEAD_CELLS, y * cos - x * sin
        ahead_on, aside_on = ahead + dx * cos + dy * sin, aside + dy * cos - dx * sin
        across = ((ahead > 0.0) != (ahead_on > 0.0)) & (
            # |aside| where the link crosses the line; without dividing, as it may be parallel.
            np.abs(aside * ahead_on - aside_on * ahead)
            <= BARRIER_HALF_WIDTH_CELLS * np.abs(ahead_on - ahead)
        )
        across &= dx * dx + dy * dy <= MAX_LINK_CELLS**2  # jumps cross no place in between
        links = np.flatnonzero(across).tolist()
        for link in links:
            self._mu_s[link] += 0.5 * tried_s
        self._observations += 1
        return len(links)

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
        """Return whether the peak is at the goal, with any heading.

        Milford et al. (2005), section V.C.
        """
        return self._distance(goal, peak) <= within_cells

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
        linked = [cell for _, _, _, cell in self._around(goal) if cell in self._numbers]
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
        remaining_s = np.full(self._torus.n_y * self._torus.n_x, np.inf)
        remaining_s[cells] = times_s
        onward = np.full(len(remaining_s), -1, np.int64)
        onward[cells] = np.where(previous >= 0, cells[np.maximum(previous, 0)], -1)
        shape = self._torus.n_y, self._torus.n_x
        return TemporalArray(goal, remaining_s.reshape(shape), onward.reshape(shape))

    def remaining_s(self, times: TemporalArray, peak: Place) -> float:
        """Return the time to the goal from the connected cell nearest to the peak, in seconds.

        It is infinite if there is no connected cell within the search radius.
        """
        start = self._start(times, peak)
        return math.inf if start is None else float(times.remaining_s.flat[start])

    def direction(self, times: TemporalArray, peak: Place) -> float | None:
        """Return the direction of the steepest descent of the time around the peak.

        The route over the links selects a sector, so that cells behind a barrier are ignored. The
        direction is the mean direction of the cells in this sector, weighted by the descent
        towards them. Cells closer than half the search radius are ignored, unless the route ends
        there.

        Returns:
            Direction in the plane of the cells in rad, counter-clockwise from x; None if the goal
            is reached or no route exists.
        """
        start = self._start(times, peak)
        if start is None or self.reached(times.goal, peak):
            return None
        min_distance = 0.5 * SEARCH_CELLS
        route = self.path(times, peak, SEARCH_CELLS).tolist()
        ahead_x, ahead_y = next((p for p in route if math.hypot(*p) >= min_distance), route[-1])
        ahead = math.hypot(ahead_x, ahead_y)
        start_s = float(times.remaining_s.flat[start])
        x = y = 0.0
        for distance, dx, dy, cell in self._around(peak):
            descent_s = start_s - float(times.remaining_s.flat[cell])
            in_sector = dx * ahead_x + dy * ahead_y >= SECTOR_COS * distance * ahead
            if descent_s > 0.0 and in_sector and distance >= min(min_distance, ahead):
                x += descent_s * dx / distance**2
                y += descent_s * dy / distance**2
        return math.atan2(y, x) if x or y else math.atan2(ahead_y, ahead_x)

    def bearing(self, times: TemporalArray, peak: Place) -> float | None:
        """Return ``direction`` relative to the robot's heading: rad, positive to the left."""
        direction = self.direction(times, peak)
        return None if direction is None else wrap(direction - self._heading(peak))

    def path(
        self, times: TemporalArray, peak: Place, length_cells: float = math.inf
    ) -> NDArray[np.float64]:
        """Return the fastest route from the peak.

        A link between places far apart is a jump of the packet while the robot stays at one place.
        Such links add no displacement.

        Args:
            times: times to the goal.
            peak: position of the robot.
            length_cells: the route ends at its first point beyond this length.

        Returns:
            (n, 2) x and y in cells relative to the peak, not wrapped, from (0, 0) to the goal or
            the length; (0, 2) if no route exists.
        """
        start = self._start(times, peak)
        if start is None:
            return np.empty((0, 2))
        points = [(0.0, 0.0)]
        length = 0.0
        at = self._place(start)
        x, y = self._offset(peak, at)
        onward = int(times.onward.flat[start])
        if onward < 0:
            points.append((x, y))
        while onward >= 0 and length < length_cells:
            following = self._place(onward)
            dx, dy = self._offset(at, following)
            if math.hypot(dx, dy) <= MAX_LINK_CELLS:
                x, y = x + dx, y + dy
                length += math.hypot(x - points[-1][0], y - points[-1][1])
                points.append((x, y))
            at, onward = following, int(times.onward.flat[onward])
        return np.array(points)

    def route_ahead(
        self, times: TemporalArray, peak: Place, length_m: float = math.inf
    ) -> NDArray[np.float64]:
        """Return ``path`` in the robot's frame: (n, 2) metres, x ahead and y to the left."""
        path = self.path(times, peak, length_m / self._cell_m) * self._cell_m
        x, y = path[:, 0], path[:, 1]
        cos, sin = math.cos(self._heading(peak)), math.sin(self._heading(peak))
        return np.stack([x * cos + y * sin, y * cos - x * sin], 1)

    # Cells

    def _start(self, times: TemporalArray, peak: Place) -> int | None:
        """Return the nearest cell connected to the goal, None if none is in the search radius."""
        cells = (cell for *_, cell in self._around(peak))
        return next((one for one in cells if math.isfinite(times.remaining_s.flat[one])), None)

    def _around(self, place: Place) -> Iterator[tuple[float, float, float, int]]:
        """Yield the cells within the search radius, nearest first.

        On a torus smaller than the radius each cell is yielded once, at its shortest distance.

        Yields:
            Distance, x and y relative to the place, and cell number.
        """
        torus, radius = self._torus, math.ceil(SEARCH_CELLS)
        middle_x, middle_y = math.floor(place.x + 0.5), math.floor(place.y + 0.5)
        found = []
        for j in range(-min(radius, (torus.n_y - 1) // 2), min(radius, torus.n_y // 2) + 1):
            for i in range(-min(radius, (torus.n_x - 1) // 2), min(radius, torus.n_x // 2) + 1):
                dx, dy = middle_x + i - place.x, middle_y + j - place.y
                distance = math.sqrt(dx * dx + dy * dy)
                if distance <= SEARCH_CELLS:
                    cell = (middle_y + j) % torus.n_y * torus.n_x + (middle_x + i) % torus.n_x
                    found.append((distance, dx, dy, cell))
        yield from sorted(found)

    def _heading(self, peak: Place) -> float:
        return peak.theta / self._torus.planes_per_rad

    def _place(self, cell: Any) -> Place:
        """Return the place of a cell, or those of an array of cells."""
        y, x = divmod(cell, self._torus.n_x)
        return Place(x, y, 0.0)

    def _offset(self, start: Place, end: Place) -> tuple[Any, Any]:
        """Return the shortest displacement from one place to another along x and y, in cells."""
        n_x, n_y = self._torus.n_x, self._torus.n_y
        return (
            (end.x - start.x + 0.5 * n_x) % n_x - 0.5 * n_x,
            (end.y - start.y + 0.5 * n_y) % n_y - 0.5 * n_y,
        )

    def _distance(self, a: Place, b: Place) -> float:
        """Return the shortest distance of two places along x and y, in cells."""
        dx, dy = self._offset(a, b)
        return math.sqrt(dx * dx + dy * dy)

    # Memory

    def _restored(self, state: State) -> None:
        pairs = state['ends'].tolist()
        self._links = {min(p) << 32 | max(p): link for link, p in enumerate(pairs)}
