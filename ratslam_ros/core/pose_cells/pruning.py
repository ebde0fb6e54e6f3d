# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pruning: visits to experiences -> the one to forget where a map has reached its limit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.state import State

RECENT_VISITS = 10
"""What the robot came by in so many visits is not forgotten: it is still there."""

LONGEST_GAP_M = 1.5
"""No experience is forgotten that leaves two others further apart, while others can be. The link
past what is forgotten is straight where the way was not: a longer one leads through walls."""

LONGER = 1.5
"""Where none can be, those go by their visits that leave no more than so many times the shortest
gap; on a map of places so far apart all ways would else be thinned alike, however often driven."""


class Visits:
    """How often, and when last, the robot came to each experience; time is counted in visits."""

    def __init__(self) -> None:
        self._counts = np.zeros(64, np.int64)
        self._last = np.zeros(64, np.int64)
        self._known = 0
        self._now = 0

    def create(self, experience_id: int) -> None:
        """Count the first visit to a new experience, which may have the number of an old one."""
        if experience_id == len(self._counts):
            self._counts = np.concatenate([self._counts, np.zeros_like(self._counts)])
            self._last = np.concatenate([self._last, np.zeros_like(self._last)])
        self._known = max(self._known, experience_id + 1)
        self._counts[experience_id] = 0
        self.arrive(experience_id)

    def arrive(self, experience_id: int) -> None:
        """Count a visit to an experience that is known."""
        self._now += 1
        self._counts[experience_id] += 1
        self._last[experience_id] = self._now

    def least(self, gaps: Gaps) -> int:
        """Return the experience to forget; there must be more than ``RECENT_VISITS`` + 1.

        Seed 002, section IV: of those visited once the one visited longest ago. Where none was,
        of those visited least often the one last visited longest ago. Experience 0 stays, as the
        map hangs on it, and so do those of the last ``RECENT_VISITS``, with the current one; those
        that would leave a gap longer than ``LONGEST_GAP_M`` stay while there are others, and where
        there are none those that would leave one of more than ``LONGER`` times the shortest.
        """
        counts, last = self._counts[: self._known], self._last[: self._known]
        may_go = last <= self._now - RECENT_VISITS
        may_go[0] = False
        left_m = gaps.left_by(self._known)
        shortest_m = left_m[may_go].min()
        may_go &= left_m <= (LONGEST_GAP_M if shortest_m <= LONGEST_GAP_M else LONGER * shortest_m)
        fewest = counts[may_go].min()
        candidates = np.flatnonzero(may_go & (counts == fewest))
        return int(candidates[np.argmin(last[candidates])])

    def state(self) -> State:
        """Return all visits, for ``restore``."""
        return {
            'now': self._now, 'counts': self._counts[: self._known].copy(),
            'last': self._last[: self._known].copy(),
        }  # fmt: skip

    def restore(self, state: State) -> None:
        """Take what ``state`` gave."""
        self._now, self._known = state['now'], len(state['counts'])
        room = np.zeros(max(0, 64 - self._known), np.int64)
        self._counts = np.concatenate([state['counts'], room])
        self._last = np.concatenate([state['last'], room])

    def assume(self, experiences: int, current_id: int) -> None:
        """Take every experience as visited once, in the order of their numbers, and one again.

        That is what is known of a memory that was saved without visits.
        """
        for experience_id in range(experiences):
            self.create(experience_id)
        if current_id >= 0:
            self.arrive(current_id)


class Gaps:
    """How far the experiences are apart on the ways driven, also past what was forgotten."""

    def __init__(self) -> None:
        self._ways_m: list[dict[int, float]] = []
        self._left_m = np.zeros(64)

    def knows(self, a: int, b: int) -> bool:
        """Return whether there is a way between two experiences."""
        return a < len(self._ways_m) and b in self._ways_m[a]

    def left_by(self, experiences: int) -> NDArray[np.float64]:
        """Return the longest gap that forgetting each experience leaves between two neighbours.

        The map joins them all with the nearest one. Where that is the only one the experience ends
        a way, and counts as if the way went on as far: else ways would be eaten from their ends.
        """
        self._make_room(experiences)
        return self._left_m[:experiences]

    def join(self, a: int, b: int, way_m: float) -> None:
        """Take a way between two experiences; of several the shortest counts."""
        if a == b or min(a, b) < 0:
            return
        for one, other in ((a, b), (b, a)):
            self._make_room(one + 1)
            ways_m = self._ways_m[one]
            ways_m[other] = min(way_m, ways_m.get(other, way_m))
            self._measure(one)

    def forget(self, experience_id: int) -> None:
        """Join the neighbours of an experience past it, all with the nearest one."""
        self._make_room(experience_id + 1)
        ways_m = self._ways_m[experience_id]
        self._ways_m[experience_id] = {}
        self._measure(experience_id)
        for other in ways_m:
            del self._ways_m[other][experience_id]
            self._measure(other)
        if ways_m:
            nearest = min(ways_m, key=lambda other: (ways_m[other], other))
            for other, way_m in ways_m.items():
                self.join(nearest, other, ways_m[nearest] + way_m)

    def state(self) -> State:
        """Return all ways, for ``restore``."""
        ways = [
            (one, other, way_m)
            for one, ways_m in enumerate(self._ways_m)
            for other, way_m in sorted(ways_m.items()) if one < other
        ]  # fmt: skip
        return {
            'ends': np.array([way[:2] for way in ways], np.int64).reshape(-1, 2),
            'ways_m': np.array([way[2] for way in ways], np.float64),
        }

    def restore(self, state: State) -> None:
        """Take what ``state`` gave."""
        for (a, b), way_m in zip(state['ends'].tolist(), state['ways_m'].tolist(), strict=True):
            self.join(a, b, way_m)

    def _make_room(self, experiences: int) -> None:
        while len(self._ways_m) < experiences:
            self._ways_m.append({})
        if experiences > len(self._left_m):
            room = np.zeros(max(len(self._left_m), experiences - len(self._left_m)))
            self._left_m = np.concatenate([self._left_m, room])

    def _measure(self, experience_id: int) -> None:
        ways_m = self._ways_m[experience_id].values()
        nearest_m = min(ways_m, default=0.0)
        longest_m = max(ways_m, default=0.0)
        self._left_m[experience_id] = nearest_m + longest_m
