# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Route planner: fastest routes over the experience map, and the temporal map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.config import GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.route_graph import route_graph
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.errors import UnreachableGoal

if TYPE_CHECKING:  # SciPy loads slowly, so it is imported with the first route
    from scipy.sparse import csr_array

EMPTY = 'the map is empty; drive first'
"""Why no route leads anywhere on a map without experiences."""


@dataclass(frozen=True, slots=True)
class Route:
    """Experiences from the start to the goal.

    Attributes:
        experience_ids: (n,) ids.
        arrival_s: (n,) expected arrival times from the start of the route in s; the first is 0.
    """

    experience_ids: tuple[int, ...]
    arrival_s: tuple[float, ...]


@dataclass(frozen=True)
class TemporalMap:
    """Travel times from one experience to all others: Milford et al. (2006), eqs. (10) and (11).

    Attributes:
        start_id: the experience at time 0.
        arrival_s: (n,) travel times in s, infinite for unreachable experiences.
        predecessors: (n,) ids of the previous experience on the fastest route, negative for the
            start and for unreachable experiences.
        components: component of each experience.
    """

    start_id: int
    arrival_s: NDArray[np.float64]
    predecessors: NDArray[np.int32]
    components: Sequence[int] = ()

    def route_to(self, goal_id: int) -> Route:
        """Return the fastest route to an experience.

        Raises:
            UnreachableGoal: there is no such experience, or no link leads to it.
        """
        check_on_map(goal_id, len(self.arrival_s))
        if not math.isfinite(self.arrival_s[goal_id]):
            raise unreachable(self.start_id, goal_id, self.components)
        ids = predecessor_chain(self.predecessors, goal_id)[::-1]
        return Route(tuple(ids.tolist()), tuple(self.arrival_s[ids].tolist()))


class RoutePlanner:
    """Plans routes over an experience map, and caches its weighted graph until links change."""

    def __init__(self, parameters: GoalRecallParameters, experience_map: ExperienceMap) -> None:
        self.parameters = parameters
        """May be replaced at any time."""
        self.experience_map = experience_map
        self._graphs: dict[
            tuple[float, float, float, bool], tuple[tuple[int, int, int], csr_array]
        ] = {}
        self.rejected_shortcuts: set[int] = set()
        """Experiences without shortcuts (``route_join_m``)."""

    @property
    def back_factor(self) -> float:
        """Factor on the duration of a link that is driven against its direction."""
        return self.parameters.route_back_factor or math.inf

    def temporal_map(
        self, start_id: int | None = None, to_start: bool = False, blocked: bool = False
    ) -> TemporalMap:
        """Return the travel times from one experience to all, over links in both directions.

        Args:
            start_id: the start, None for the current experience.
            to_start: return the travel times from all experiences to the start, and successors in
                place of predecessors. They differ unless ``route_back_factor`` is 1.
            blocked: use unlearned links, too.

        Raises:
            UnreachableGoal: the map is empty, or the robot is at no experience.
        """
        experience_map = self.experience_map
        if len(experience_map) == 0:
            raise UnreachableGoal(EMPTY)
        start = start_of(experience_map, start_id)
        version = (
            experience_map.link_table.version, len(experience_map), len(self.rejected_shortcuts)
        )
        back, join_m = self.back_factor, self.parameters.route_join_m
        factors = (back, 1.0, join_m) if to_start else (1.0, back, join_m)
        key = (*factors, blocked)
        cached = self._graphs.get(key)
        if cached is None or cached[0] != version:
            if key not in self._graphs and len(self._graphs) > 3:
                self._graphs.clear()  # the parameters were replaced
            graph = route_graph(experience_map, *factors, self.rejected_shortcuts, blocked)
            cached = self._graphs[key] = version, graph
        from scipy.sparse.csgraph import dijkstra

        arrival_s, predecessors = dijkstra(cached[1], indices=start, return_predecessors=True)
        return TemporalMap(start, arrival_s, predecessors, experience_map.components)

    def route_to(self, goal_id: int, start_id: int | None = None) -> Route:
        """Return the fastest route to an experience; see ``TemporalMap.route_to``.

        If no links lead there, unlearned ones are used: what blocked them may be gone.
        """
        with suppress(UnreachableGoal):
            return self.temporal_map(start_id).route_to(goal_id)
        return self.temporal_map(start_id, blocked=True).route_to(goal_id)

    def nearest(
        self, x_m: float, y_m: float, tolerance_m: float = 0.0,
        reachable: NDArray[np.bool_] | None = None,
    ) -> int:
        """Return the experience nearest to a position on the map.

        Args:
            x_m, y_m: the position.
            tolerance_m: maximum distance in m, 0 for ``goal_tolerance_m``.
            reachable: (n,) which experiences are preferred, if one lies within the tolerance.

        Raises:
            UnreachableGoal: the map is empty, or no experience lies within the tolerance.
        """
        if len(self.experience_map) == 0:
            raise UnreachableGoal(EMPTY)
        tolerance = tolerance_m or self.parameters.goal_tolerance_m
        poses = self.experience_map.poses
        away_m = np.hypot(poses[:, 0] - x_m, poses[:, 1] - y_m)
        near = away_m <= tolerance
        if not near.any():
            raise UnreachableGoal(
                f'the nearest experience to ({x_m:g}, {y_m:g}) is {away_m.min():.2f} m away; '
                f'expected at most {tolerance:g} m: choose a place nearer to the map or raise '
                'goal_recall.goal_tolerance_m'
            )
        if reachable is not None and (near & reachable).any():
            near &= reachable
        return int(np.argmin(np.where(near, away_m, np.inf)))

    def route_to_place(
        self, x_m: float, y_m: float, tolerance_m: float = 0.0, start_id: int | None = None
    ) -> Route:
        """Return the fastest route to the reachable experience nearest to a position on the map.

        Args:
            x_m, y_m: the position.
            tolerance_m: maximum distance of the experience in m, 0 for ``goal_tolerance_m``.
            start_id: the start, None for the current experience.

        Raises:
            UnreachableGoal: no reachable experience lies within the tolerance.
        """
        times = self.temporal_map(start_id)
        goal_id = self.nearest(x_m, y_m, tolerance_m, np.isfinite(times.arrival_s))
        return self.route_to(goal_id, start_id)


def check_on_map(experience_id: int, count: int) -> None:
    """Raise UnreachableGoal unless a map of ``count`` experiences has this id."""
    if count == 0:
        raise UnreachableGoal(EMPTY)
    if not 0 <= experience_id < count:
        raise UnreachableGoal(
            f'there is no experience {experience_id}; expected 0 to {count - 1}'
        )


def start_of(experience_map: ExperienceMap, start_id: int | None) -> int:
    """Return the start of a route: the current experience if ``start_id`` is None.

    Raises:
        UnreachableGoal: there is no such experience, or the robot's own place is unknown.
    """
    if start_id is None and (reason := nowhere_because(experience_map)):
        raise UnreachableGoal(reason)
    start = experience_map.current_id if start_id is None else start_id
    check_on_map(start, len(experience_map))
    return start


def nowhere_because(experience_map: ExperienceMap) -> str:
    """Return why no route can begin where the robot is, '' if one can."""
    if experience_map.localisation == 'unknown':
        return (
            f'the pose on the map is unknown: {experience_map.covariance.reason}; drive until a '
            'place is recognised, or give the pose on initialpose'
        )
    if experience_map.current_id == NO_EXPERIENCE and len(experience_map) > 0:
        return 'no place has confirmed the given pose yet; drive until one is recognised'
    return ''


def unreachable(start_id: int, goal_id: int, components: Sequence[int]) -> UnreachableGoal:
    """Return the error for a goal to which no links lead from the start.

    ``components``: component of each experience.
    """
    if components and components[start_id] != components[goal_id]:
        return UnreachableGoal(
            f'no link leads from experience {start_id} to {goal_id}: between their components, '
            f'{components[start_id]} and {components[goal_id]}, the odometry had a gap; drive '
            'until a place of the other component is recognised'
        )
    return UnreachableGoal(
        f'no link leads from experience {start_id} to {goal_id}; drive between their parts of '
        'the map first'
    )


@compiled
def predecessor_chain(predecessors: NDArray[np.int32], last: int) -> NDArray[np.int32]:
    """Return an experience, its predecessor, the predecessor of that, and so on to the root."""
    ids = np.empty(len(predecessors), np.int32)
    count = 0
    while last >= 0 and count < len(ids):
        ids[count] = last
        last = predecessors[last]
        count += 1
    return ids[:count]
