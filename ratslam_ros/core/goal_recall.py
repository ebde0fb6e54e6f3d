# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal recall: graph, goal -> Route, the quickest way over the experience map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from ratslam_ros.core.config import GoalRecallParameters
from ratslam_ros.core.experience_map import ExperienceMap, Link
from ratslam_ros.errors import RatslamError

SHORTEST_S = 1e-9
"""A link's least duration: a graph's edge of length 0 would be no edge."""


class UnreachableGoal(RatslamError):  # noqa: N818 - the errors' names say what they are
    """A goal that is not on the map, or that no link leads to."""


@dataclass(frozen=True, slots=True)
class Route:
    """Experiences from the current one to the goal, and when each is expected to be reached.

    ``experience_ids``: (n,); ``arrival_s``: (n,) seconds from the start of the route, from 0.
    """

    experience_ids: tuple[int, ...]
    arrival_s: tuple[float, ...]


@dataclass(frozen=True)
class TemporalMap:
    """How long it takes from one experience to every other; seed 000, equations (10) and (11).

    ``arrival_s``: (n,) seconds, infinite where no link leads; ``before``: (n,) the experience
    before each on its quickest way, negative at the start and where none leads.
    """

    start_id: int
    arrival_s: NDArray[np.float64]
    before: NDArray[np.int32]

    def route_to(self, goal_id: int) -> Route:
        """Read the quickest route back from its goal.

        Raises:
            UnreachableGoal: there is no such experience, or no link leads to it.
        """
        count = len(self.arrival_s)
        if not 0 <= goal_id < count:
            raise UnreachableGoal(
                f'there is no experience {goal_id}; expected 0 to {count - 1}'
            )
        if not math.isfinite(self.arrival_s[goal_id]):
            raise UnreachableGoal(
                f'no link leads from experience {self.start_id} to {goal_id}; drive between '
                'their parts of the map first'
            )
        ids = [goal_id]
        while ids[-1] != self.start_id:
            ids.append(int(self.before[ids[-1]]))
        ids.reverse()
        return Route(tuple(ids), tuple(self.arrival_s[ids].tolist()))


class GoalRecall:
    """Finds routes over an experience map."""

    def __init__(self, parameters: GoalRecallParameters) -> None:
        self._p = parameters

    def temporal_map(
        self, experience_map: ExperienceMap, start_id: int | None = None
    ) -> TemporalMap:
        """Return the times from an experience to all, over links in both directions.

        ``start_id``: where to start, None for the current experience.

        Raises:
            UnreachableGoal: the map is empty.
        """
        count = len(experience_map)
        if count == 0:
            raise UnreachableGoal('the map is empty; drive first')
        start = experience_map.current_id if start_id is None else start_id
        arrival_s, before = dijkstra(
            _durations(experience_map.links(), count), indices=start, return_predecessors=True
        )
        return TemporalMap(start, arrival_s, before)

    def route_to(self, experience_map: ExperienceMap, goal_id: int) -> Route:
        """Return the quickest route to an experience; see ``TemporalMap.route_to``."""
        return self.temporal_map(experience_map).route_to(goal_id)

    def nearest(
        self, experience_map: ExperienceMap, x_m: float, y_m: float, tolerance_m: float = 0.0
    ) -> int:
        """Return the experience that is nearest to a place on the map.

        ``tolerance_m``: its greatest distance; 0: ``goal_tolerance_m``.

        Raises:
            UnreachableGoal: none is that near.
        """
        if len(experience_map) == 0:
            raise UnreachableGoal('the map is empty; drive first')
        poses = experience_map.poses
        away_m = np.hypot(poses[:, 0] - x_m, poses[:, 1] - y_m)
        nearest = int(np.argmin(away_m))
        self._check_near(x_m, y_m, float(away_m[nearest]), tolerance_m)
        return nearest

    def route_to_place(
        self, experience_map: ExperienceMap, x_m: float, y_m: float, tolerance_m: float = 0.0,
        start_id: int | None = None,
    ) -> Route:  # fmt: skip
        """Return the quickest route to the experience that is nearest to a place on the map.

        Args:
            experience_map: the graph, and where the robot is on it.
            x_m, y_m: the place.
            tolerance_m: greatest distance of the experience; 0: ``goal_tolerance_m``.
            start_id: where to start, None for the current experience.

        Raises:
            UnreachableGoal: no experience that links lead to lies within the tolerance.
        """
        times = self.temporal_map(experience_map, start_id)
        tolerance = tolerance_m or self._p.goal_tolerance_m
        poses = experience_map.poses
        away_m = np.hypot(poses[:, 0] - x_m, poses[:, 1] - y_m)
        reachable_m = np.where(np.isfinite(times.arrival_s), away_m, np.inf)
        goal = int(np.argmin(reachable_m))
        if reachable_m[goal] <= tolerance:
            return times.route_to(goal)
        nearest = int(np.argmin(away_m))
        self._check_near(x_m, y_m, float(away_m[nearest]), tolerance_m)
        return times.route_to(nearest)  # says that no link leads there

    def _check_near(self, x_m: float, y_m: float, away_m: float, tolerance_m: float) -> None:
        tolerance = tolerance_m or self._p.goal_tolerance_m
        if not away_m <= tolerance:
            raise UnreachableGoal(
                f'the nearest experience to ({x_m:g}, {y_m:g}) is {away_m:.2f} m away; '
                f'expected at most {tolerance:g} m: choose a place nearer to the map or raise '
                'goal_recall.goal_tolerance_m'
            )


def _durations(links: list[Link], count: int) -> csr_array:
    """Return (count, count) seconds between linked experiences, the quicker way for both ways."""
    quickest: dict[tuple[int, int], float] = {}
    for link in links:
        for ends in ((link.source_id, link.target_id), (link.target_id, link.source_id)):
            known = quickest.get(ends, math.inf)
            quickest[ends] = max(min(link.duration_s, known), SHORTEST_S)
    rows = [source for source, _ in quickest]
    columns = [target for _, target in quickest]
    return csr_array((list(quickest.values()), (rows, columns)), shape=(count, count))
