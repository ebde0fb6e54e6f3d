# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal memory with links per cell driven, routes along links, and blocked ways.

``goal_memory_update: cell`` selects it. See docs/algorithm.md, "Goal memory".
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.goal_memory.goal_memory import (
    SEARCH_CELLS,
    Activity,
    Cells,
    GoalMemory,
    TemporalArray,
)
from ratslam_ros.core.goal_memory.published_links import ETA_CHI_S, ETA_DELTA_S, ETA_TAU
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.torus import Place

STEP_CELLS = 1.0
"""Distance in cells between updates of the links. With shorter steps slow and fast routes hardly
differ, with longer ones routes cut corners (docs/algorithm.md)."""

ACTIVE_SHARE = 0.3
"""Cells with at least this share of the largest activity are linked: about nine for a packet."""

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


class GoalRoutes(GoalMemory):
    """A goal memory that learns by the distance driven, and plans routes along its links."""

    def __init__(self, cells: PoseCellsParameters) -> None:
        """Create a memory without links for pose cells."""
        super().__init__(cells)
        self._cell_m = cells.pc_cell_x_size

    def integrate(self, motion: Motion, pose_cells: PoseCells) -> None:
        """Learn from one motion, after the pose cells integrated it.

        Links are updated whenever the peak has moved by STEP_CELLS.
        """
        if not (pose_cells.mapping and motion.is_known):
            self.relocated()
            return
        if abs(motion.distance_m) <= STATIONARY_CELLS_PER_S * self._cell_m * motion.dt_s:
            return
        self._travel_s += motion.dt_s
        peak, previous = pose_cells.peak, self._previous_peak
        if previous is not None and self._plane.distance(previous, peak) < STEP_CELLS:
            return
        self._previous_peak = peak
        self.learn(self._travel_s, *pose_cells.projected())
        self._travel_s = 0.0

    def learn(self, travel_s: float, cells: Cells, activity: Activity) -> None:
        """Link the active cells to those that were active at the previous call.

        After Milford et al. (2005), equations (2) to (5). Here each pair of cells is observed
        once: of the two orders, i before j and j before i, the one with the larger product of
        activities. The first observation sets a link.

        Args:
            travel_s: time for which the robot moved since the previous call.
            cells: (n,) distinct cell numbers y * n_x + x.
            activity: (n,) their activity, summed over all headings.
        """
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
            delta = ETA_DELTA_S * self._plane.distance(self._plane.place(i), self._plane.place(j))
            self._observe(i, j, tau + chi + delta)

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
        first, second = self._plane.place(ends[:, 0]), self._plane.place(ends[:, 1])
        (x, y), (dx, dy) = self._plane.offset(peak, first), self._plane.offset(first, second)
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
        for distance, dx, dy, cell in self._plane.around(peak, SEARCH_CELLS):
            descent_s = start_s - float(times.remaining_s.flat[cell])
            in_sector = dx * ahead_x + dy * ahead_y >= SECTOR_COS * distance * ahead
            if descent_s > 0.0 and in_sector and distance >= min(min_distance, ahead):
                x += descent_s * dx / distance**2
                y += descent_s * dy / distance**2
        return math.atan2(y, x) if x or y else math.atan2(ahead_y, ahead_x)

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
        at = self._plane.place(start)
        x, y = self._plane.offset(peak, at)
        onward = int(times.onward.flat[start])
        if onward < 0:
            points.append((x, y))
        while onward >= 0 and length < length_cells:
            following = self._plane.place(onward)
            dx, dy = self._plane.offset(at, following)
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
