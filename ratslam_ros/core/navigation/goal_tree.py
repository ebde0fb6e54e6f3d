# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal tree: the quickest ways to one goal, kept while the map grows."""

from __future__ import annotations

import math
from array import array

import numpy as np

from ratslam_ros.core.navigation.route_graph import SHORTEST_S
from ratslam_ros.core.navigation.route_planner import (
    Route,
    RoutePlanner,
    check_on_map,
    predecessor_chain,
    unreachable,
)

EXPERIENCES_PER_CHANGE = 1000
"""A goal's tree is computed anew after one change of a link for so many experiences of the map."""


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

    def __init__(self, planner: RoutePlanner, goal_id: int) -> None:
        """Compute the ways to an experience.

        Raises:
            UnreachableGoal: there is no such experience.
        """
        check_on_map(goal_id, len(planner.experience_map))
        self.goal_id = goal_id
        self._planner = planner
        self._map = planner.experience_map
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

    def route(self, start_id: int | None = None) -> Route:
        """Read the way to the goal.

        ``start_id``: where to start, None for the current experience.

        Raises:
            UnreachableGoal: there is no such experience, or no link leads from it.
        """
        self._follow()
        start = self._start(start_id)
        remaining_s = self._remaining_s[start]
        if not math.isfinite(remaining_s):
            raise unreachable(start, self.goal_id)
        ids = predecessor_chain(np.frombuffer(self._next, np.int32), start)
        arrival_s = remaining_s - np.frombuffer(self._remaining_s)[ids]
        return Route(tuple(ids.tolist()), tuple(arrival_s.tolist()))

    def _start(self, start_id: int | None) -> int:
        start = self._map.current_id if start_id is None else start_id
        check_on_map(start, len(self._next))
        return start

    def _compute(self) -> None:
        """Compute all ways anew."""
        times = self._planner.temporal_map(self.goal_id, to_start=True)
        self._back = self._planner.parameters.route_back_factor
        # Arrays that grow. Their memory is only lent to NumPy: while it is they cannot.
        self._remaining_s = array('d', times.arrival_s.tobytes())
        self._next = array('i', times.before.tobytes())
        self._links = self._map.link_count
        self._computed = self._version = self._map.links_version
        self._rebuilt = self._map.rebuilt
        self._rejected_shortcuts = self._planner.rejected_shortcut_count
        self._linked = int(self._map.link_ends.max(initial=-1)) + 1
        self._stale = False

    def _follow(self) -> None:
        """Bring the tree up to the links of the map, as the class describes."""
        graph = self._map
        new = len(graph) - len(self._next)
        self._remaining_s.extend([math.inf] * new)
        self._next.extend([-1] * new)
        refactored = self._planner.parameters.route_back_factor != self._back
        rejected_shortcuts = self._planner.rejected_shortcut_count != self._rejected_shortcuts
        if graph.links_version == self._version and not refactored and not rejected_shortcuts:
            return
        if graph.rebuilt != self._rebuilt or refactored or rejected_shortcuts:
            self._compute()
            return
        links = slice(self._links, graph.link_count)
        # Every change either made a link or averaged one.
        joins = self._planner.parameters.route_join_m > 0.0
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
