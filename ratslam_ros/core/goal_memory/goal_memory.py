# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal memory: pose cells, goal -> direction, by the times between places learned on the cells.

The older way to goals (seed 001), on the pose cells themselves and without an experience map. It
inherits what the cells do: where two places share cells it knows a short cut that is none, and
where one place has two sets of cells it knows the way from one of them only (seed 000, II.A).
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.config.goal_memory import GoalMemoryParameters
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.torus import Place, Torus
from ratslam_ros.errors import UnreachableGoal, UnusableInput

Cells = NDArray[np.int64]
Activity = NDArray[np.float64]

REST_CELLS_PER_S = 0.02
"""A robot slower than this rests: the time is none of the way, and nothing is linked."""

PACKET_CELLS = 6.0
"""Two packets that are more than this and a step apart are two places, not one that moves on."""

BLOCKED_AHEAD_CELLS = 1.0
BLOCKED_ASIDE_CELLS = 2.0
"""Where the line lies that nothing passes while the robot is blocked, and how far to the sides."""

SECTOR_COS = math.cos(math.radians(45.0))
"""How far beside the way cells may lie that count for the direction."""


@dataclass(frozen=True)
class TemporalArray:
    """How long it takes from every cell to one goal; seed 001, equation (6).

    ``remaining_s``: (n_y, n_x) seconds, infinite where nothing leads on; ``onward``: (n_y, n_x)
    the cell after each on its quickest way, y * n_x + x, negative at the goal and where none is.
    """

    goal: Place
    remaining_s: NDArray[np.float64]
    onward: Cells


class GoalMemory:
    """Links between pose cells that were active one after the other, and ways over them."""

    def __init__(self, parameters: GoalMemoryParameters, cells: PoseCellsParameters) -> None:
        self.parameters = parameters
        """They may be replaced at any time."""
        self._torus = Torus(cells.pc_dim_x, cells.pc_dim_y, cells.pc_dim_th)
        self._cell_m = cells.pc_cell_x_size
        self.goals: dict[str, Place] = {}
        """The places that were marked, by their names."""
        # Cells are numbered as they are first linked, links as they are first made; a link's key
        # is made of the numbers of its ends.
        self._numbers: dict[int, int] = {}
        self._links: dict[int, int] = {}
        self._ends = array('i')
        self._mu_s = array('d')
        self._observations = 0
        self._recalled: tuple[Place, int, TemporalArray] | None = None
        self.relocated()

    def __len__(self) -> int:
        """Return the number of links, each for both directions."""
        return len(self._mu_s)

    def relocated(self) -> None:
        """Link nothing to what was active before: nobody knows how the robot came here."""
        self._before: dict[int, float] | None = None
        self._peak_before: Place | None = None
        self._way_s = 0.0

    def integrate(self, motion: Motion, pose_cells: PoseCells) -> None:
        """Take what a motion made of the pose cells; links whenever the peak has moved a step."""
        if not pose_cells.mapping:
            self.relocated()
            return
        if abs(motion.distance_m) <= REST_CELLS_PER_S * self._cell_m * motion.dt_s:
            return
        self._way_s += motion.dt_s
        peak, before = pose_cells.peak, self._peak_before
        if before is not None and (
            self._between(before, peak) < self.parameters.goal_memory_step_cells
        ):
            return
        self._peak_before = peak
        self.learn(self._way_s, *pose_cells.projected())
        self._way_s = 0.0

    def learn(self, way_s: float, cells: Cells, activity: Activity) -> None:
        """Link the cells that are active now to those active at the call before.

        Equations (2) to (5) of seed 001, once for a pair of cells: of its two observations, i
        before j and j before i, the stronger counts.

        Args:
            way_s: time that the robot moved since the call before.
            cells: (n,) y * n_x + x, none twice.
            activity: (n,) their activity, over all headings.
        """
        p = self.parameters
        largest = float(activity.max())
        active = activity >= p.goal_memory_active_share * largest
        now = dict(zip(cells[active].tolist(), (activity[active] / largest).tolist(), strict=True))
        before, self._before = self._before, now
        if before is None:
            return
        self._observations += 1
        products: dict[tuple[int, int], float] = {}
        for i, share_before in before.items():
            for j, share_now in now.items():
                pair = (i, j) if i < j else (j, i)
                product = share_before * share_now
                if i != j and product > products.get(pair, 0.0):
                    products[pair] = product
        tau = p.goal_memory_eta_tau * way_s
        for (i, j), product in products.items():
            chi = p.goal_memory_eta_chi * (1.0 / product - 1.0)
            delta = p.goal_memory_eta_delta * self._between(self._place(i), self._place(j))
            self._observe(i, j, tau + chi + delta)

    def _observe(self, i: int, j: int, seconds: float) -> None:
        """Average an observation into a link; the first one sets it."""
        numbers = self._numbers
        a, b = numbers.setdefault(i, len(numbers)), numbers.setdefault(j, len(numbers))
        key = a << 32 | b if a < b else b << 32 | a
        link = self._links.setdefault(key, len(self._mu_s))
        if link == len(self._mu_s):
            self._ends.extend((a, b))
            self._mu_s.append(seconds)
        else:
            self._mu_s[link] = 0.5 * (self._mu_s[link] + seconds)

    def blocked(self, peak: Place, bearing_rad: float, tried_s: float) -> int:
        """Take that the robot cannot go on: links across a line just ahead of it become longer.

        What was tried in vain is an observation like any other, of a time that is not over yet:
        the link's own and ``tried_s``. Once the way is free, driving it averages that away.

        Args:
            peak: where the robot is.
            bearing_rad: where it cannot go, from ahead and to the left positive.
            tried_s: how long it has tried, in all.

        Returns:
            How many links that were.
        """
        n_x, n_y = self._torus.n_x, self._torus.n_y
        direction = self._heading(peak) + bearing_rad
        cos, sin = math.cos(direction), math.sin(direction)
        cells = np.fromiter(self._numbers, np.int64, len(self._numbers))
        ends = cells[np.array(self._ends, np.int32).reshape(-1, 2)]
        # Of both ends, x and y from the peak: the first the shortest way round, then the link.
        x = (ends[:, 0] % n_x - peak.x + 0.5 * n_x) % n_x - 0.5 * n_x
        y = (ends[:, 0] // n_x - peak.y + 0.5 * n_y) % n_y - 0.5 * n_y
        dx = (ends[:, 1] % n_x - ends[:, 0] % n_x + 0.5 * n_x) % n_x - 0.5 * n_x
        dy = (ends[:, 1] // n_x - ends[:, 0] // n_x + 0.5 * n_y) % n_y - 0.5 * n_y
        ahead, aside = x * cos + y * sin - BLOCKED_AHEAD_CELLS, y * cos - x * sin
        ahead_on, aside_on = ahead + dx * cos + dy * sin, aside + dy * cos - dx * sin
        across = ((ahead > 0.0) != (ahead_on > 0.0)) & (
            # |aside| where the link is on the line; multiplied out, as no link may be along it
            np.abs(aside * ahead_on - aside_on * ahead)
            <= BLOCKED_ASIDE_CELLS * np.abs(ahead_on - ahead)
        )
        across &= dx * dx + dy * dy <= self._longest_cells**2  # a jump passes no place between
        links = np.flatnonzero(across).tolist()
        for link in links:
            self._mu_s[link] += 0.5 * tried_s
        self._observations += 1
        return len(links)

    # Goals

    def mark(self, name: str, peak: Place) -> None:
        """Remember the place of the peak as a goal; a name that is known is moved."""
        self.goals[name] = peak

    def goal(self, name: str) -> Place:
        """Return the place of a goal.

        Raises:
            UnreachableGoal: there is none of this name.
        """
        if name not in self.goals:
            known = ', '.join(self.goals) or 'none yet'
            raise UnreachableGoal(f'no goal is named {name!r}; known: {known}: mark it first')
        return self.goals[name]

    def reached(self, goal: Place, peak: Place) -> bool:
        """Return whether the peak is at the goal, whatever the heading (seed 001, V.C)."""
        return self._between(goal, peak) <= self.parameters.goal_memory_reached_cells

    # Recall

    def recall(self, goal: Place) -> TemporalArray:
        """Return the times to a goal, from wherever links lead to it.

        The goal stands for the nearest linked cell within the search radius. Asked again for the
        same goal, what was computed is returned until something more was learned.

        Raises:
            UnreachableGoal: there is none.
        """
        if self._recalled is None or self._recalled[:2] != (goal, self._observations):
            self._recalled = goal, self._observations, self._compute(goal)
        return self._recalled[2]

    def _compute(self, goal: Place) -> TemporalArray:
        known = [cell for _, _, _, cell in self._around(goal) if cell in self._numbers]
        if not known:
            raise UnreachableGoal(
                f'no cell near x {goal.x:.1f}, y {goal.y:.1f} was ever linked; drive there first'
            )
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import dijkstra

        count = len(self._numbers)
        ends = np.array(self._ends, np.int32).reshape(-1, 2)
        links = csr_array((np.array(self._mu_s), (ends[:, 0], ends[:, 1])), shape=(count, count))
        times_s, before = dijkstra(
            links, directed=False, indices=self._numbers[known[0]], return_predecessors=True
        )
        cells = np.fromiter(self._numbers, np.int64, count)
        remaining_s = np.full(self._torus.n_y * self._torus.n_x, np.inf)
        remaining_s[cells] = times_s
        onward = np.full(len(remaining_s), -1, np.int64)
        onward[cells] = np.where(before >= 0, cells[np.maximum(before, 0)], -1)
        shape = self._torus.n_y, self._torus.n_x
        return TemporalArray(goal, remaining_s.reshape(shape), onward.reshape(shape))

    def remaining_s(self, times: TemporalArray, peak: Place) -> float:
        """Return the time from the known cell nearest to the peak, infinite if none is near."""
        here = self._here(times, peak)
        return math.inf if here is None else float(times.remaining_s.flat[here])

    def direction(self, times: TemporalArray, peak: Place) -> float | None:
        """Return the direction in which the time falls fastest around the peak.

        The way over the links tells the side, so that no cell behind a blocked line attracts; the
        cells on that side, weighted by how fast the time falls towards them, tell it exactly.
        Those from half the search radius on count before nearer ones.

        Returns:
            rad, in the plane of the cells, counter-clockwise from x; None where no way is known or
            where the goal is reached.
        """
        here = self._here(times, peak)
        if here is None or self.reached(times.goal, peak):
            return None
        away = 0.5 * self._search_cells
        way = self.path(times, peak, self._search_cells).tolist()
        side_x, side_y = next((p for p in way if math.hypot(*p) >= away), way[-1])
        side = math.hypot(side_x, side_y)
        here_s = float(times.remaining_s.flat[here])
        x = y = 0.0
        for distance, dx, dy, cell in self._around(peak):
            fall_s = here_s - float(times.remaining_s.flat[cell])
            on_this_side = dx * side_x + dy * side_y >= SECTOR_COS * distance * side
            if fall_s > 0.0 and on_this_side and distance >= min(away, side):
                x += fall_s * dx / distance**2
                y += fall_s * dy / distance**2
        return math.atan2(y, x) if x or y else math.atan2(side_y, side_x)

    def bearing(self, times: TemporalArray, peak: Place) -> float | None:
        """Return ``direction`` as seen by the robot: rad from ahead, to the left positive."""
        direction = self.direction(times, peak)
        return None if direction is None else wrap(direction - self._heading(peak))

    def path(
        self, times: TemporalArray, peak: Place, length_cells: float = math.inf
    ) -> NDArray[np.float64]:
        """Return the way that the time falls along, from the peak on.

        Where a link joins two places far apart, both are one place and the way goes on from there:
        the packet will jump when the robot comes to it.

        Returns:
            (n, 2) x and y in cells from the peak, not wrapped; the first is (0, 0), the last is
            the first beyond the length, or the goal; (0, 2) where no way is known.
        """
        here = self._here(times, peak)
        if here is None:
            return np.empty((0, 2))
        points = [(0.0, 0.0)]
        length = 0.0
        at = self._place(here)
        x, y = self._offset(peak, at)
        onward = int(times.onward.flat[here])
        if onward < 0:
            points.append((x, y))
        while onward >= 0 and length < length_cells:
            then = self._place(onward)
            dx, dy = self._offset(at, then)
            if math.hypot(dx, dy) <= self._longest_cells:
                x, y = x + dx, y + dy
                length += math.hypot(x - points[-1][0], y - points[-1][1])
                points.append((x, y))
            at, onward = then, int(times.onward.flat[onward])
        return np.array(points)

    def route_ahead(
        self, times: TemporalArray, peak: Place, length_m: float = math.inf
    ) -> NDArray[np.float64]:
        """Return ``path`` in the robot's frame: (n, 2) metres, x ahead and y to the left."""
        way = self.path(times, peak, length_m / self._cell_m) * self._cell_m
        cos, sin = math.cos(self._heading(peak)), math.sin(self._heading(peak))
        return np.stack([way[:, 0] * cos + way[:, 1] * sin, way[:, 1] * cos - way[:, 0] * sin], 1)

    # Cells

    @property
    def _longest_cells(self) -> float:
        """The longest link between cells of one place; longer ones are jumps."""
        return self.parameters.goal_memory_step_cells + PACKET_CELLS

    @property
    def _search_cells(self) -> float:
        return self.parameters.goal_memory_search_cells

    def _here(self, times: TemporalArray, peak: Place) -> int | None:
        """Return the nearest cell from which a way is known, None if there is none around."""
        for _, _, _, cell in self._around(peak):
            if math.isfinite(times.remaining_s.flat[cell]):
                return cell
        return None

    def _around(self, place: Place) -> Iterator[tuple[float, float, float, int]]:
        """Yield distance, x and y from the place, and the cell, of those near it; nearest first.

        On a small torus a cell is met once, on the shortest way.
        """
        torus, radius = self._torus, math.ceil(self._search_cells)
        middle_x, middle_y = math.floor(place.x + 0.5), math.floor(place.y + 0.5)
        found = []
        for j in range(-min(radius, (torus.n_y - 1) // 2), min(radius, torus.n_y // 2) + 1):
            for i in range(-min(radius, (torus.n_x - 1) // 2), min(radius, torus.n_x // 2) + 1):
                dx, dy = middle_x + i - place.x, middle_y + j - place.y
                away = math.sqrt(dx * dx + dy * dy)
                if away <= self._search_cells:
                    cell = (middle_y + j) % torus.n_y * torus.n_x + (middle_x + i) % torus.n_x
                    found.append((away, dx, dy, cell))
        yield from sorted(found)

    def _heading(self, peak: Place) -> float:
        return peak.theta / self._torus.planes_per_rad

    def _place(self, cell: int) -> Place:
        y, x = divmod(cell, self._torus.n_x)
        return Place(x, y, 0.0)

    def _offset(self, start: Place, end: Place) -> tuple[float, float]:
        """Return x and y from one place to another, the shortest way round."""
        n_x, n_y = self._torus.n_x, self._torus.n_y
        return (
            (end.x - start.x + 0.5 * n_x) % n_x - 0.5 * n_x,
            (end.y - start.y + 0.5 * n_y) % n_y - 0.5 * n_y,
        )

    def _between(self, a: Place, b: Place) -> float:
        """Return the distance of two places in the plane, in cells."""
        dx, dy = self._offset(a, b)
        return math.sqrt(dx * dx + dy * dy)

    # Memory

    def state(self) -> State:
        """Return all that was learned, for ``restore``."""
        return {
            'dims': [self._torus.n_x, self._torus.n_y],
            'cells': np.fromiter(self._numbers, np.int64, len(self._numbers)),
            'ends': np.array(self._ends, np.int32).reshape(-1, 2),
            'mu_s': np.array(self._mu_s, np.float64),
            'goals': [[name, *place] for name, place in self.goals.items()],
        }

    def restore(self, state: State) -> None:
        """Take what ``state`` gave for the present memory, which must be empty.

        Raises:
            UnusableInput: it is of pose cells of other extents.
        """
        dims = [self._torus.n_x, self._torus.n_y]
        if state['dims'] != dims:
            raise UnusableInput(
                f'the goal memory is of {state["dims"]} cells; expected {dims}: pc_dim_x and '
                'pc_dim_y must be those of the run that saved'
            )
        self._numbers = {cell: number for number, cell in enumerate(state['cells'].tolist())}
        pairs = state['ends'].tolist()
        self._links = {min(p) << 32 | max(p): link for link, p in enumerate(pairs)}
        self._ends = array('i', state['ends'].astype(np.int32).tobytes())
        self._mu_s = array('d', state['mu_s'].astype(np.float64).tobytes())
        self.goals = {name: Place(*place) for name, *place in state['goals']}
        self._recalled = None
        self.relocated()
