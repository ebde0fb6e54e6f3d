# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal recall: graph, goal -> Route, the quickest way over the experience map."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.config import GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.route_graph import route_graph
from ratslam_ros.errors import RatslamError

if TYPE_CHECKING:  # SciPy takes long to load: it is loaded where the first route is asked for
    from scipy.sparse import csr_array

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
        check_on_map(goal_id, len(self.arrival_s))
        if not math.isfinite(self.arrival_s[goal_id]):
            raise unreachable(self.start_id, goal_id)
        ids = predecessor_chain(self.before, goal_id)[::-1]
        return Route(tuple(ids.tolist()), tuple(self.arrival_s[ids].tolist()))


class RoutePlanner:
    """Finds routes over an experience map; keeps what it computed on it until links change."""

    def __init__(self, parameters: GoalRecallParameters, experience_map: ExperienceMap) -> None:
        self.parameters = parameters
        """They may be replaced at any time."""
        self.experience_map = experience_map
        self._graphs: dict[
            tuple[float, float, float], tuple[tuple[int, int, int], csr_array]
        ] = {}
        self._rejected_shortcuts: set[int] = set()

    def reject_shortcuts(self, experience_ids: Iterable[int]) -> None:
        """Never again join some experiences with others because they lie close together."""
        self._rejected_shortcuts.update(experience_ids)

    def forgotten(self, experience_id: int) -> None:
        """Take note that a number comes to mean another experience."""
        self._rejected_shortcuts.discard(experience_id)

    @property
    def rejected_shortcut_count(self) -> int:
        """How many experiences are not joined with others."""
        return len(self._rejected_shortcuts)

    def temporal_map(self, start_id: int | None = None, to_start: bool = False) -> TemporalMap:
        """Return the times from an experience to all, over links in both directions.

        Args:
            start_id: where to start, None for the current experience.
            to_start: the times from all to the start instead, and the experience after each; they
                differ where ``route_back_factor`` is not 1.

        Raises:
            UnreachableGoal: the map is empty.
        """
        experience_map = self.experience_map
        if len(experience_map) == 0:
            raise UnreachableGoal('the map is empty; drive first')
        start = experience_map.current_id if start_id is None else start_id
        changes = (
            experience_map.links_version, len(experience_map), len(self._rejected_shortcuts)
        )  # fmt: skip
        back, join_m = self.parameters.route_back_factor, self.parameters.route_join_m
        factors = (back, 1.0, join_m) if to_start else (1.0, back, join_m)
        known = self._graphs.get(factors)
        if known is None or known[0] != changes:
            if factors not in self._graphs and len(self._graphs) > 1:
                self._graphs.clear()  # the parameters were replaced
            weighted = route_graph(experience_map, *factors, self._rejected_shortcuts)
            known = self._graphs[factors] = changes, weighted
        from scipy.sparse.csgraph import dijkstra

        arrival_s, before = dijkstra(known[1], indices=start, return_predecessors=True)
        return TemporalMap(start, arrival_s, before)

    def route_to(self, goal_id: int) -> Route:
        """Return the quickest route to an experience; see ``TemporalMap.route_to``."""
        return self.temporal_map().route_to(goal_id)

    def nearest(self, x_m: float, y_m: float, tolerance_m: float = 0.0) -> int:
        """Return the experience that is nearest to a place on the map.

        ``tolerance_m``: its greatest distance; 0: ``goal_tolerance_m``.

        Raises:
            UnreachableGoal: none is that near.
        """
        if len(self.experience_map) == 0:
            raise UnreachableGoal('the map is empty; drive first')
        poses = self.experience_map.poses
        away_m = np.hypot(poses[:, 0] - x_m, poses[:, 1] - y_m)
        nearest = int(np.argmin(away_m))
        self._check_near(x_m, y_m, float(away_m[nearest]), tolerance_m)
        return nearest

    def route_to_place(
        self, x_m: float, y_m: float, tolerance_m: float = 0.0, start_id: int | None = None
    ) -> Route:
        """Return the quickest route to the experience that is nearest to a place on the map.

        Args:
            x_m, y_m: the place.
            tolerance_m: greatest distance of the experience; 0: ``goal_tolerance_m``.
            start_id: where to start, None for the current experience.

        Raises:
            UnreachableGoal: no experience that links lead to lies within the tolerance.
        """
        times = self.temporal_map(start_id)
        reachable = np.isfinite(times.arrival_s)
        return times.route_to(self._goal_at(reachable, x_m, y_m, tolerance_m))

    def _goal_at(
        self, reachable: NDArray[np.bool_], x_m: float, y_m: float, tolerance_m: float
    ) -> int:
        """Return the nearest of the reachable experiences; if none is near, of all that are."""
        poses = self.experience_map.poses
        away_m = np.hypot(poses[:, 0] - x_m, poses[:, 1] - y_m)
        goal = int(np.argmin(np.where(reachable, away_m, np.inf)))
        if not (reachable[goal] and away_m[goal] <= (tolerance_m or self._tolerance_m)):
            goal = int(np.argmin(away_m))
            self._check_near(x_m, y_m, float(away_m[goal]), tolerance_m)
        return goal

    @property
    def _tolerance_m(self) -> float:
        return self.parameters.goal_tolerance_m

    def _check_near(self, x_m: float, y_m: float, away_m: float, tolerance_m: float) -> None:
        tolerance = tolerance_m or self._tolerance_m
        if not away_m <= tolerance:
            raise UnreachableGoal(
                f'the nearest experience to ({x_m:g}, {y_m:g}) is {away_m:.2f} m away; '
                f'expected at most {tolerance:g} m: choose a place nearer to the map or raise '
                'goal_recall.goal_tolerance_m'
            )


def check_on_map(experience_id: int, count: int) -> None:
    """Raise UnreachableGoal unless a map of ``count`` experiences has this id."""
    if not 0 <= experience_id < count:
        raise UnreachableGoal(
            f'there is no experience {experience_id}; expected 0 to {count - 1}'
        )


def unreachable(start_id: int, goal_id: int) -> UnreachableGoal:
    """Return the error for a goal in another part of the map than the start."""
    return UnreachableGoal(
        f'no link leads from experience {start_id} to {goal_id}; drive between their parts of '
        'the map first'
    )


@compiled
def predecessor_chain(before: NDArray[np.int32], last: int) -> NDArray[np.int32]:
    """Return an experience, the one before it and so on."""
    ids = np.empty(len(before), np.int32)
    count = 0
    while last >= 0 and count < len(ids):
        ids[count] = last
        last = before[last]
        count += 1
    return ids[:count]
