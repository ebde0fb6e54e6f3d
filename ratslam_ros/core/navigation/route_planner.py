# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal recall: graph, goal -> Route, the quickest way over the experience map."""

from __future__ import annotations

import math
from array import array
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.config import GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.errors import UnreachableGoal

if TYPE_CHECKING:  # SciPy takes long to load: it is loaded where the first route is asked for
    from scipy.sparse import csr_array

SHORTEST_S = 1e-9
"""A link's least duration: a graph's edge of length 0 would be no edge."""

NEWEST = 10
"""Experiences made so soon one after the other are not joined beside their links."""

TILE_M = 4.0
"""Places are joined where links lead from one to the other within squares of this width: over so
short a way the map is right, whatever it does to loops that are not closed yet."""

SLOWEST_MPS = 0.01

TURN_RADPS = 1.0
"""How fast a robot turns where ways are joined."""

EXPERIENCES_PER_CHANGE = 1000
"""A goal's tree is computed anew after one change of a link for so many experiences of the map."""


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
        _check_known(goal_id, len(self.arrival_s))
        if not math.isfinite(self.arrival_s[goal_id]):
            raise _unlinked(self.start_id, goal_id)
        ids = _chain(self.before, goal_id, len(self.before))[::-1]
        return Route(tuple(ids.tolist()), tuple(self.arrival_s[ids].tolist()))


class RoutePlanner:
    """Finds routes over an experience map; keeps what it computed on it until links change."""

    def __init__(self, parameters: GoalRecallParameters) -> None:
        self.parameters = parameters
        """They may be replaced at any time."""
        self._durations: WeakKeyDictionary[
            ExperienceMap, dict[tuple[float, float, float], tuple[tuple[int, int, int], csr_array]]
        ] = WeakKeyDictionary()
        self._rejected_shortcuts: WeakKeyDictionary[ExperienceMap, set[int]] = WeakKeyDictionary()
        self._tree: GoalTree | None = None

    def part(self, experience_map: ExperienceMap, experience_ids: Iterable[int]) -> None:
        """Never again join some experiences with others because they lie close together."""
        self._rejected_shortcuts.setdefault(experience_map, set()).update(experience_ids)

    def forgotten(self, experience_map: ExperienceMap, experience_id: int) -> None:
        """Take note that a number comes to mean another experience."""
        self._rejected_shortcuts.get(experience_map, set()).discard(experience_id)

    def rejected_shortcuts(self, experience_map: ExperienceMap) -> int:
        """Return how many experiences are not joined with others."""
        return len(self._rejected_shortcuts.get(experience_map, ()))

    def temporal_map(
        self, experience_map: ExperienceMap, start_id: int | None = None, to_start: bool = False
    ) -> TemporalMap:
        """Return the times from an experience to all, over links in both directions.

        Args:
            experience_map: the graph.
            start_id: where to start, None for the current experience.
            to_start: the times from all to the start instead, and the experience after each; they
                differ where ``route_back_factor`` is not 1.

        Raises:
            UnreachableGoal: the map is empty.
        """
        if len(experience_map) == 0:
            raise UnreachableGoal('the map is empty; drive first')
        start = experience_map.current_id if start_id is None else start_id
        rejected_shortcuts = self._rejected_shortcuts.get(experience_map, set())
        changes = experience_map.links_version, len(experience_map), len(rejected_shortcuts)
        back, join_m = self.parameters.route_back_factor, self.parameters.route_join_m
        factors = (back, 1.0, join_m) if to_start else (1.0, back, join_m)
        graphs = self._durations.setdefault(experience_map, {})
        known = graphs.get(factors)
        if known is None or known[0] != changes:
            if factors not in graphs and len(graphs) > 1:
                graphs.clear()  # the parameters were replaced
            weighted = durations(experience_map, *factors, rejected_shortcuts)
            known = graphs[factors] = changes, weighted
        from scipy.sparse.csgraph import dijkstra

        arrival_s, before = dijkstra(known[1], indices=start, return_predecessors=True)
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
        reachable = np.isfinite(times.arrival_s)
        return times.route_to(self._goal_at(experience_map, reachable, x_m, y_m, tolerance_m))

    def follow(self, experience_map: ExperienceMap, x_m: float, y_m: float) -> Route:
        """Return the route to a place again and again while the robot drives.

        As ``route_to_place`` from the current experience, but the ways to the goal are kept from
        one call to the next; see ``GoalTree`` for how exact they are on a large map.

        Raises:
            UnreachableGoal: no experience that links lead to lies within ``goal_tolerance_m``.
        """
        tree = self._tree
        if tree is not None and tree.experience_map is not experience_map:
            tree = None
        if tree is not None and math.isfinite(tree.remaining_s()):
            reachable = tree.reachable()
        else:
            reachable = np.isfinite(self.temporal_map(experience_map).arrival_s)
        goal = self._goal_at(experience_map, reachable, x_m, y_m)
        if tree is None or tree.goal_id != goal:
            tree = self._tree = GoalTree(self, experience_map, goal)
        return tree.route()

    def _goal_at(
        self, experience_map: ExperienceMap, reachable: NDArray[np.bool_], x_m: float, y_m: float,
        tolerance_m: float = 0.0,
    ) -> int:  # fmt: skip
        """Return the nearest of the reachable experiences; if none is near, of all that are."""
        poses = experience_map.poses
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


class GoalTree:
    """The quickest ways to one goal from all experiences, kept while the robot drives.

    It follows the map whenever it is asked. A new experience that one link ties to a known one is
    appended, and a new link that shortens no way is passed over; the tree stays exact. Where
    links have vanished, or ``route_back_factor`` is another one, it is computed anew. Any other
    change of a link, by averaging too, makes it stale: its ways exist, but may take another time
    than it says, or be the quickest no more. A stale tree is computed anew

    - once ``EXPERIENCES_PER_CHANGE`` times the changes of links since it was computed are at
      least the experiences of the map: at every change on a map of up to 1,000, at every 50th on
      one of 50,000. The cost of an action so does not grow with the map;
    - at once where a new link joins experiences that were not on it, which can happen only as
      often as the map falls into parts.
    """

    def __init__(self, recall: RoutePlanner, experience_map: ExperienceMap, goal_id: int) -> None:
        """Compute the ways to an experience.

        Raises:
            UnreachableGoal: there is no such experience.
        """
        _check_known(goal_id, len(experience_map))
        self.experience_map = experience_map
        self.goal_id = goal_id
        self._recall = recall
        self._compute()

    def exact(self) -> bool:
        """Return whether the ways are the quickest over the links as they are now."""
        self._follow()
        return not self._stale

    def remaining_s(self, start_id: int | None = None) -> float:
        """Return the time to the goal in s, infinite where no link leads.

        ``start_id``: where to start, None for the current experience.

        Raises:
            UnreachableGoal: there is no such experience.
        """
        self._follow()
        return self._remaining_s[self._start(start_id)]

    def reachable(self) -> NDArray[np.bool_]:
        """Return (n,) whether links lead from an experience to the goal."""
        self._follow()
        return np.isfinite(np.frombuffer(self._remaining_s))

    def route(self, start_id: int | None = None, most: int | None = None) -> Route:
        """Read the way to the goal, or the beginning of it.

        Args:
            start_id: where to start, None for the current experience.
            most: number of experiences that suffice, 1 or more; None for the whole way.

        Raises:
            UnreachableGoal: there is no such experience, or no link leads from it.
        """
        self._follow()
        start = self._start(start_id)
        remaining_s = self._remaining_s[start]
        if not math.isfinite(remaining_s):
            raise _unlinked(start, self.goal_id)
        count = len(self._next)
        ids = _chain(np.frombuffer(self._next, np.int32), start, count if most is None else most)
        arrival_s = remaining_s - np.frombuffer(self._remaining_s)[ids]
        return Route(tuple(ids.tolist()), tuple(arrival_s.tolist()))

    def _start(self, start_id: int | None) -> int:
        start = self.experience_map.current_id if start_id is None else start_id
        _check_known(start, len(self._next))
        return start

    def _compute(self) -> None:
        """Compute all ways anew."""
        times = self._recall.temporal_map(self.experience_map, self.goal_id, to_start=True)
        self._back = self._recall.parameters.route_back_factor
        # Arrays that grow. Their memory is only lent to NumPy: while it is they cannot.
        self._remaining_s = array('d', times.arrival_s.tobytes())
        self._next = array('i', times.before.tobytes())
        self._links = self.experience_map.link_count
        self._computed = self._version = self.experience_map.links_version
        self._rebuilt = self.experience_map.rebuilt
        self._rejected_shortcuts = self._recall.rejected_shortcuts(self.experience_map)
        self._linked = int(self.experience_map.link_ends.max(initial=-1)) + 1
        self._stale = False

    def _follow(self) -> None:
        """Bring the tree up to the links of the map, as the class describes."""
        graph = self.experience_map
        new = len(graph) - len(self._next)
        self._remaining_s.extend([math.inf] * new)
        self._next.extend([-1] * new)
        refactored = self._recall.parameters.route_back_factor != self._back
        rejected_shortcuts = self._recall.rejected_shortcuts(graph) != self._rejected_shortcuts
        if graph.links_version == self._version and not refactored and not rejected_shortcuts:
            return
        if graph.rebuilt != self._rebuilt or refactored or rejected_shortcuts:
            self._compute()
            return
        links = slice(self._links, graph.link_count)
        # Every change either made a link or averaged one.
        joins = self._recall.parameters.route_join_m > 0.0
        if joins or graph.links_version - self._version > links.stop - links.start:
            self._stale = True
        self._links, self._version = graph.link_count, graph.links_version
        seconds = np.maximum(graph.link_durations_s[links], SHORTEST_S).tolist()
        joined = False
        for (a, b), duration_s in zip(graph.link_ends[links].tolist(), seconds, strict=True):
            joined |= self._add(a, b, duration_s)
        changes = self._version - self._computed
        if joined or (self._stale and changes * EXPERIENCES_PER_CHANGE >= len(graph)):
            self._compute()

    def _add(self, a: int, b: int, duration_s: float) -> bool:
        """Take a new link over; return whether it joins a part of the map that is not known."""
        old = self._linked  # no link has led to an experience of so high an id before
        self._linked = max(old, a + 1, b + 1)
        joined = False
        for far, near, seconds in ((a, b, duration_s), (b, a, self._back * duration_s)):
            known_s, through_s = self._remaining_s[far], self._remaining_s[near] + seconds
            if through_s >= known_s:  # also where both are infinite
                continue
            if far >= old:
                self._remaining_s[far], self._next[far] = through_s, near
            else:
                self._stale = True
                joined |= math.isinf(known_s)
        return joined


def durations(
    experience_map: ExperienceMap, ahead: float = 1.0, back: float = 1.0, join_m: float = 0.0,
    rejected_shortcuts: Collection[int] = (),
) -> csr_array:  # fmt: skip
    """Return (n, n) seconds between linked experiences, the quickest link for both directions.

    It is as SciPy computes on it, which then converts nothing: float64 and int32, rows in order.
    ``ahead``, ``back``: factors for the links in their own direction and in the other one.
    ``join_m``: experiences no further apart on the map count as linked, except for
    ``rejected_shortcuts``.
    """
    count = len(experience_map)
    sources, targets = experience_map.link_ends.T
    once = np.maximum(experience_map.link_durations_s, SHORTEST_S)
    rows, columns = [sources, targets], [targets, sources]
    seconds = [ahead * once, back * once]
    if join_m > 0.0 and len(once):
        a, b, between_s = _joins(experience_map, join_m, rejected_shortcuts)
        rows, columns = [*rows, a, b], [*columns, b, a]
        seconds += [between_s, between_s]
    column = np.concatenate(columns)
    places = np.concatenate(rows) * count + column
    order = np.argsort(places, kind='stable')  # the quick one where most is in order already
    places = places[order]
    first = np.flatnonzero(np.diff(places, prepend=-1))
    row_ends = np.cumsum(np.bincount(places[first] // count, minlength=count))
    from scipy.sparse import csr_array

    return csr_array(
        (
            np.minimum.reduceat(np.concatenate(seconds)[order], first),
            column[order[first]].astype(np.int32),
            np.concatenate([[0], row_ends]).astype(np.int32),
        ),
        shape=(count, count),
    )


def _joins(
    experience_map: ExperienceMap, join_m: float, rejected_shortcuts: Collection[int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return pairs of experiences that lie close together on the map, and s from one to the other.

    Only of those that have links: what was unlearned altogether is no place to go through. The
    robot goes there as fast as over the links, and turns on the spot.
    """
    from scipy.spatial import cKDTree

    linked = np.unique(experience_map.link_ends)
    if rejected_shortcuts:
        linked = np.setdiff1d(linked, np.fromiter(rejected_shortcuts, np.int64))
    poses = experience_map.poses[linked]
    pairs = cKDTree(poses[:, :2]).query_pairs(join_m, output_type='ndarray')
    # Neighbours in time are linked already.
    apart = linked[pairs[:, 1]] - linked[pairs[:, 0]]
    pairs = pairs[apart > NEWEST]
    unlearned = np.sort(experience_map.unlearned_ends, axis=1) @ (len(experience_map), 1)
    numbers = np.sort(linked[pairs], axis=1) @ (len(experience_map), 1)
    pairs = pairs[~np.isin(numbers, unlearned)]  # no way leads from one to the other any more
    pairs = pairs[_near_over_links(experience_map, linked[pairs])]
    step = poses[pairs[:, 1]] - poses[pairs[:, 0]]
    shapes = experience_map.link_shapes
    driven_m, driven_s = shapes[:, 0].sum(), experience_map.link_durations_s.sum()
    speed_mps = max(driven_m / driven_s, SLOWEST_MPS) if driven_s > 0.0 else SLOWEST_MPS
    turn_rad = np.abs((step[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
    seconds = np.hypot(step[:, 0], step[:, 1]) / speed_mps + turn_rad / TURN_RADPS + SHORTEST_S
    return linked[pairs[:, 0]], linked[pairs[:, 1]], seconds


def _near_over_links(
    experience_map: ExperienceMap, pairs: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return (n,) whether links lead from one of a pair to the other without going far away.

    Also such as were unlearned: where something stands now they still say how the places lie.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(experience_map)
    ends = np.concatenate([experience_map.link_ends, experience_map.unlearned_ends])
    places = experience_map.poses[:, :2] / TILE_M
    found = np.zeros(len(pairs), np.bool_)
    for shift in ((0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.5, 0.5)):
        tiles = np.floor(places + shift)
        inside = ends[(tiles[ends[:, 0]] == tiles[ends[:, 1]]).all(axis=1)]
        graph = coo_array((np.ones(len(inside)), inside.T), shape=(count, count))
        _, part = connected_components(graph, directed=False)
        found |= part[pairs[:, 0]] == part[pairs[:, 1]]
    return found


def _check_known(experience_id: int, count: int) -> None:
    if not 0 <= experience_id < count:
        raise UnreachableGoal(
            f'there is no experience {experience_id}; expected 0 to {count - 1}'
        )


def _unlinked(start_id: int, goal_id: int) -> UnreachableGoal:
    return UnreachableGoal(
        f'no link leads from experience {start_id} to {goal_id}; drive between their parts of '
        'the map first'
    )


@compiled
def _chain(before: NDArray[np.int32], last: int, most: int) -> NDArray[np.int32]:
    """Return an experience, the one before it and so on, at most so many of them."""
    ids = np.empty(min(most, len(before)), np.int32)
    count = 0
    while last >= 0 and count < len(ids):
        ids[count] = last
        last = before[last]
        count += 1
    return ids[:count]
