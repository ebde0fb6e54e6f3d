# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pruning: visits to experiences -> the one to forget where a map has reached its limit."""

from __future__ import annotations

import numpy as np

from ratslam_ros.core.state import State

RECENT_VISITS = 10
"""What the robot came by in so many visits is not forgotten: it is still there."""


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

    def least(self) -> int:
        """Return the experience to forget; there must be more than ``RECENT_VISITS`` + 1.

        Seed 002, section IV: of those visited once the one visited longest ago. Where none was,
        of those visited least often the one last visited longest ago. Experience 0 stays, as the
        map hangs on it, and so do those of the last ``RECENT_VISITS``, with the current one.
        """
        counts, last = self._counts[: self._known], self._last[: self._known]
        may_go = last <= self._now - RECENT_VISITS
        may_go[0] = False
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
