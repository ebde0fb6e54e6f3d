# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal tree: cost-to-go and routes to one goal, updated incrementally while the map grows."""

from __future__ import annotations

import math
from array import array

import numpy as np

from ratslam_ros.core.navigation.route_graph import MIN_EDGE_S
from ratslam_ros.core.navigation.route_planner import (
    Route,
    RoutePlanner,
    check_on_map,
    predecessor_chain,
    start_of,
    unreachable,
)

EXPERIENCES_PER_CHANGE = 1000
"""A stale tree is recomputed after one link change per this many experiences of the map."""


class GoalTree:
    """Shortest-path tree to a goal: the cost-to-go and the successor of each experience.

    Every query first updates the tree to the current links. A new experience with one link to a
    known one is appended, and a new link that shortens no route is skipped; the tree stays exact.
    If links were removed, or ``route_back_factor`` or the rejected shortcuts have changed, the
    tree is recomputed. Any other link change, such as averaging a duration, makes the tree stale:
    its routes exist, but their durations may be outdated, and others may be faster. A stale tree
    is recomputed

    - once the link changes since the last computation, times EXPERIENCES_PER_CHANGE, reach the
      number of experiences: at every change on a map of up to 1,000, at every 50th on one of
      50,000. The mean cost of a query thus does not grow with the map;
    - at once if a new link connects another component of the graph. This can happen only as often
      as the graph falls apart.
    """

    def __init__(self, planner: RoutePlanner, goal_id: int) -> None:
        """Compute the tree.

        Raises:
            UnreachableGoal: there is no such experience.
        """
        check_on_map(goal_id, len(planner.experience_map))
        self.goal_id = goal_id
        self._planner = planner
        self._map = planner.experience_map
        self._compute()

    def route(self, start_id: int | None = None) -> Route:
        """Return the route to the goal.

        ``start_id``: the start, None for the current experience.

        Raises:
            UnreachableGoal: there is no such experience, or no link leads from it.
        """
        self._update()
        start = start_of(self._map, start_id)
        remaining_s = self._remaining_s[start]
        if not math.isfinite(remaining_s):
            raise unreachable(start, self.goal_id, self._map.components)
        ids = predecessor_chain(np.frombuffer(self._successors, np.int32), start)
        arrival_s = remaining_s - np.frombuffer(self._remaining_s)[ids]
        return Route(tuple(ids.tolist()), tuple(arrival_s.tolist()))

    def _compute(self) -> None:
        """Compute the whole tree."""
        times = self._planner.temporal_map(self.goal_id, to_start=True)
        self._computed_for = self._conditions
        # Growable arrays. They cannot grow while a NumPy view of their memory exists.
        self._remaining_s = array('d', times.arrival_s.tobytes())
        self._successors = array('i', times.predecessors.tobytes())
        self._link_count = self._map.link_count
        self._computed_version = self._version = self._map.link_table.version
        self._linked_end = int(self._map.link_ends.max(initial=-1)) + 1
        self._stale = False

    @property
    def _conditions(self) -> tuple[float, int, int]:
        """What the tree must be recomputed for if it has changed."""
        rejected = len(self._planner.rejected_shortcuts)
        return self._planner.back_factor, rejected, self._map.link_table.deletion_count

    def _update(self) -> None:
        """Update the tree to the current links, as the class docstring describes."""
        graph = self._map
        new = len(graph) - len(self._successors)
        self._remaining_s.extend([math.inf] * new)
        self._successors.extend([-1] * new)
        if self._conditions != self._computed_for:
            self._compute()
            return
        if graph.link_table.version == self._version:
            return
        links = slice(self._link_count, graph.link_count)
        # Each change of the version either added a link or averaged one.
        has_shortcuts = self._planner.parameters.route_join_m > 0.0
        if has_shortcuts or graph.link_table.version - self._version > links.stop - links.start:
            self._stale = True
        self._link_count, self._version = graph.link_count, graph.link_table.version
        seconds = np.maximum(graph.link_table.durations_s[links], MIN_EDGE_S).tolist()
        connected = False
        for (a, b), duration_s in zip(graph.link_ends[links].tolist(), seconds, strict=True):
            connected |= self._add(a, b, duration_s)
        changes = self._version - self._computed_version
        if connected or (self._stale and changes * EXPERIENCES_PER_CHANGE >= len(graph)):
            self._compute()

    def _add(self, a: int, b: int, duration_s: float) -> bool:
        """Add a link; return whether it connects another component of the graph to the tree."""
        linked_end = self._linked_end  # experiences from this id on had no links before
        self._linked_end = max(linked_end, a + 1, b + 1)
        connected = False
        for far, near, seconds in ((a, b, duration_s), (b, a, self._computed_for[0] * duration_s)):
            known_s, through_s = self._remaining_s[far], self._remaining_s[near] + seconds
            if through_s >= known_s:  # also if both are infinite
                continue
            if far >= linked_end:
                self._remaining_s[far], self._successors[far] = through_s, near
            else:
                self._stale = True
                connected |= math.isinf(known_s)
        return connected
