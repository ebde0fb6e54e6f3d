# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pruning: select the experience to remove, to make room for a new one or to keep a map small.

Milford (2008), section IV, with the additions that docs/algorithm.md lists under "Pruning".
The pose cells make this decision, not the experience map, because they create the experiences and
assign their ids; the map applies the decision when it receives the action.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.freshness import Freshness
from ratslam_ros.core.common.rows import KeyedRows, Rows
from ratslam_ros.core.common.saved import MAX_COUNT, Field, Saved, count
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import MemoryParameters, PoseCellsParameters

RECENT_VISITS_COUNT = 10
"""Experiences of this many latest visits are not pruned: the robot is still near them."""

MAX_GAP_M = 1.5
"""Maximum distance between neighbours that pruning may leave, if any candidate allows it. The link
that replaces a pruned experience is straight, so a long one would cut through walls."""

GAP_RATIO = 1.5
"""If every candidate exceeds MAX_GAP_M: largest gap, relative to the smallest one, among which the
number of visits decides. Without this, a map of widely spaced places would be pruned evenly, with
no regard to how often a place was visited."""

SUPERSEDED_SHARE = 0.25
"""Share of the experiences that may have a younger one at their place. They make the map more
precise, but with all of them it would grow on known ground without limit."""


class VisitHistory(Saved):
    """Number of visits and time of the last visit per experience; time is counted in visits."""

    SAVED = (
        count('now', '_now'),
        Field('counts', '', 'i8', ('experiences',), 0, MAX_COUNT,
              save=lambda own: own._rows.values[:, 0]),
        Field('last', '', 'i8', ('experiences',), 0, MAX_COUNT,
              save=lambda own: own._rows.values[:, 1]),
    )

    def __init__(self) -> None:
        # Number of visits, and time of the last one.
        self._rows = Rows(2, np.int64)
        self._now = 0

    def __len__(self) -> int:
        return len(self._rows)

    def create(self, experience_id: int) -> None:
        """Count the first visit to a new experience, whose id may be that of a pruned one."""
        self._now += 1
        self._rows[experience_id] = 1, self._now

    def visit(self, experience_id: int) -> None:
        """Count a visit to an existing experience."""
        self._now += 1
        self._rows[experience_id] = self._rows[experience_id][0] + 1, self._now

    def retain(self, experience_id: int) -> None:
        """Exclude an experience from further selections, until ten others were visited."""
        self._rows[experience_id] = self._rows[experience_id][0], self._now

    def old(self) -> NDArray[np.bool_]:
        """Return (n,) which experiences are neither the origin nor of the latest visits."""
        old: NDArray[np.bool_] = self._rows.values[:, 1] <= self._now - RECENT_VISITS_COUNT
        old[:1] = False
        return old

    def may_go(self, distances: DistanceGraph) -> NDArray[np.bool_]:
        """Return which experiences may be pruned, at least one.

        More than ``RECENT_VISITS_COUNT`` + 1 must exist. Experience 0, the origin of the map, is
        kept, as are those of the last ``RECENT_VISITS_COUNT`` visits, which include the current
        one. Candidates that would leave a gap longer than ``MAX_GAP_M`` are kept if there are
        others; otherwise those that would leave one longer than ``GAP_RATIO`` times the smallest
        gap.

        Returns:
            (n,) for all experiences.
        """
        may_go = self.old()
        gaps_m = distances.gaps_after_removal_m(len(self))
        shortest_m = gaps_m[may_go].min()
        return may_go & (
            gaps_m <= (MAX_GAP_M if shortest_m <= MAX_GAP_M else GAP_RATIO * shortest_m)
        )

    def prune_candidate(self, may_go: NDArray[np.bool_]) -> int:
        """Select the experience to prune.

        Milford (2008), section IV: of the experiences visited once, the one visited longest ago;
        if there is none, of those visited least often, the one visited longest ago.

        Args:
            may_go: (n,) which of all experiences may be selected, at least one.
        """
        counts, last = self._rows.values.T
        candidates = np.flatnonzero(may_go & (counts == counts[may_go].min()))
        return int(candidates[np.argmin(last[candidates])])

    def _restored(self, state: State) -> None:
        self._rows.replace(np.column_stack([state['counts'], state['last']]))


class DistanceGraph(Saved):
    """Travelled distances between neighbouring experiences, also past pruned ones."""

    SAVED = (
        Field('ends', '', 'i8', ('gaps', 2), 0, 'experiences'),
        Field('ways_m', '', 'f8', ('gaps',)),
    )

    def __init__(self) -> None:
        self._neighbours_m: list[dict[int, float]] = []
        self._rows = KeyedRows(2, 3)  # by pair, the lower id first
        self._gaps_m = np.zeros(64)

    def are_neighbours(self, a: int, b: int) -> bool:
        """Return whether two experiences are connected directly."""
        return a < len(self._neighbours_m) and b in self._neighbours_m[a]

    def gaps_after_removal_m(self, count: int) -> NDArray[np.float64]:
        """Return the longest gap, in metres, that removing each experience would leave.

        Removal connects all neighbours of an experience to the nearest one of them. An experience
        with a single neighbour is the end of a dead end, and counts as if the path continued for
        the same distance: otherwise dead ends would be pruned from their ends.

        Args:
            count: number of experiences.

        Returns:
            (count,) gaps.
        """
        self._grow(count)
        return self._gaps_m[:count]

    def connect(self, a: int, b: int, distance_m: float) -> None:
        """Add a travelled distance between two experiences; the shortest one is kept."""
        if a == b or min(a, b) < 0:
            return
        for one, other in ((a, b), (b, a)):
            self._grow(one + 1)
            neighbours_m = self._neighbours_m[one]
            neighbours_m[other] = min(distance_m, neighbours_m.get(other, distance_m))
            self._update_gap(one)
        a, b = min(a, b), max(a, b)
        self._rows.put((a, b), (self._neighbours_m[a][b],))

    def remove(self, experience_id: int) -> None:
        """Remove an experience and connect all its neighbours to the nearest one of them."""
        self._grow(experience_id + 1)
        neighbours_m = self._neighbours_m[experience_id]
        self._neighbours_m[experience_id] = {}
        self._update_gap(experience_id)
        for other in neighbours_m:
            del self._neighbours_m[other][experience_id]
            self._rows.drop(min(experience_id, other), max(experience_id, other))
            self._update_gap(other)
        if neighbours_m:
            nearest = min(neighbours_m, key=lambda other: (neighbours_m[other], other))
            for other, distance_m in neighbours_m.items():
                self.connect(nearest, other, neighbours_m[nearest] + distance_m)

    def state(self) -> State:
        """Return all distances, for ``restore``."""
        ends = self._rows.values[:, :2].astype(np.int64)
        order = np.argsort((ends[:, 0] << 32) + ends[:, 1])
        return {'ends': ends[order], 'ways_m': self._rows.values[order, 2]}

    def _restored(self, state: State) -> None:
        ends, distances_m = state['ends'].tolist(), state['ways_m'].tolist()
        for (a, b), distance_m in zip(ends, distances_m, strict=True):
            self.connect(a, b, distance_m)

    def _grow(self, count: int) -> None:
        while len(self._neighbours_m) < count:
            self._neighbours_m.append({})
        if count > len(self._gaps_m):
            added = max(len(self._gaps_m), count - len(self._gaps_m))
            self._gaps_m = np.concatenate([self._gaps_m, np.zeros(added)])

    def _update_gap(self, experience_id: int) -> None:
        distances_m = self._neighbours_m[experience_id].values()
        nearest_m = min(distances_m, default=0.0)
        longest_m = max(distances_m, default=0.0)
        self._gaps_m[experience_id] = nearest_m + longest_m


class Pruning(Saved):
    """Visits of all experiences and distances between them, and the choice that follows."""

    SAVED = (
        Field('visits', '_visits', VisitHistory), Field('gaps', '_distances', DistanceGraph),
        Field('freshness', '_freshness', Freshness, optional=True),
        Field('superseded', '', 'i8', ('',), 0, 'experiences',
              save=lambda own: np.flatnonzero(own._superseded.values),
              when=lambda own: own._superseded.values.any()),
    )

    def __init__(self, parameters: PoseCellsParameters, memory: MemoryParameters) -> None:
        p = self._p = parameters
        self.is_used = p.exp_max > 0 or p.exp_view_links
        """Whether experiences are pruned, for which the distances between them are needed."""
        self._visits, self._distances = VisitHistory(), DistanceGraph()
        self._superseded = Rows(1, np.bool_)
        """Whether each experience has a younger one at its place."""
        has_freshness = p.exp_max > 0 and p.exp_forget == 'freshness'
        fading = memory.forget_share, memory.forget_after_s
        self._freshness = Freshness(*fading) if has_freshness else None

    def __len__(self) -> int:
        return len(self._visits)

    def advance(self, stamp_ns: int) -> None:
        """Set the time at which experiences are visited; it never goes back."""
        if self._freshness is not None:
            self._freshness.advance(stamp_ns)

    def stay(self, experience_id: int) -> None:
        """Record that the robot is still at an experience."""
        if self._freshness is not None:
            self._freshness.observe(experience_id)

    def visit(self, experience_id: int) -> None:
        """Record a visit to an existing experience."""
        self._visits.visit(experience_id)
        self.stay(experience_id)

    def create(self, experience_id: int) -> None:
        """Record a new experience, whose id may be that of a pruned one."""
        self._visits.create(experience_id)
        self._superseded[experience_id] = (False,)
        if self._freshness is not None:
            self._freshness.add(experience_id)

    def connect(self, a: int, b: int, distance_m: float) -> None:
        """Record a travelled distance between two experiences."""
        if self.is_used:
            self._distances.connect(a, b, distance_m)

    def supersede(self, older: int, younger: int, distance_m: float) -> None:
        """Mark an experience that a younger one at its place replaces."""
        self._superseded[older] = (True,)
        self.connect(younger, older, distance_m)

    def take(self) -> int:
        """Return the id for a new experience: the next one, or that of one that is pruned now."""
        count = len(self)
        is_full = 0 < self._p.exp_max <= count
        old = self._visits.old()
        may_go = old & self._superseded.values[:, 0]
        if not is_full and may_go.sum() <= SUPERSEDED_SHARE * count:
            return count
        if is_full and self._p.exp_forget == 'visited_once':
            may_go = old
        elif not may_go.any():
            may_go = self._visits.may_go(self._distances)
        found = None
        if self._freshness is not None and is_full:
            found = self._freshness.candidate(may_go[self._freshness.items])
        chosen = self._visits.prune_candidate(may_go) if found is None else found
        if self._freshness is not None:
            self._freshness.remove(chosen)
        self._distances.remove(chosen)
        return chosen

    def estimate_missing(self, pairs: Iterable[tuple[int, int, float]]) -> None:
        """Add distances of transitions for which none was recorded."""
        if self.is_used:
            for a, b, distance_m in pairs:
                if not self._distances.are_neighbours(a, b):
                    self._distances.connect(a, b, distance_m)

    def _restored(self, state: State) -> None:
        count = len(self)
        self._superseded.replace(np.isin(np.arange(count), state.get('superseded', [])))
        if self._freshness is not None and 'freshness' not in state:  # saved without a limit
            for number in range(count):
                self._freshness.add(number)
