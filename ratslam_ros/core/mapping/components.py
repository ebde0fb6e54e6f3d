# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Components of the map: parts whose relative pose is unknown, after gaps of the odometry.

A component begins where the motion of the robot is unknown, and ends when a recognised place
connects it to an earlier one. The poses within a component are correct relative to each other.
Not in the papers.
"""

from __future__ import annotations

from ratslam_ros.core.common.saved import MAX_ID, Field, Saved, count


class Components(Saved):
    """Component of each experience and of the robot; numbers ascend in the order of creation."""

    SAVED = (
        count('components/current', 'current'), count('components/gaps', 'gap_count'),
        Field('components/experiences', '_of', 'i8', ('experiences',), 0, MAX_ID,
              load=lambda numbers: numbers.tolist()),
    )

    def __init__(self) -> None:
        self.current = 0
        """Component in which the robot is."""
        self.gap_count = 0
        """Number of components that were begun after the first one."""
        self.merge_count = 0
        """Counter that grows when components are merged or split."""
        self._of: list[int] = []

    def of(self, experience_id: int) -> int:
        """Return the component of an experience; for -1 that of the robot."""
        return self.current if experience_id < 0 else self._of[experience_id]

    def numbers(self) -> list[int]:
        """Return the component of each experience."""
        return self._of.copy()

    @property
    def first(self) -> int:
        """Lowest number of a component that has experiences; without any, that of the robot."""
        return 0 if self.current == 0 else min(self._of, default=self.current)

    @property
    def count(self) -> int:
        """Number of components that have experiences."""
        return len(set(self._of))

    def members(self, component: int) -> list[int]:
        """Return the ids of the experiences of a component, ascending."""
        return [i for i, number in enumerate(self._of) if number == component]

    def begin(self) -> None:
        """Begin a component: the robot's pose relative to all experiences is unknown."""
        self.gap_count += 1
        self.current = self.gap_count

    def split(self, members: set[int]) -> None:
        """Move experiences of the robot's component, and the robot, to a new one."""
        self.merge_count += 1
        self.begin()
        for experience_id in members:
            self._of[experience_id] = self.current

    def add(self, experience_id: int) -> None:
        """Assign a new experience, whose id may be that of a pruned one, to the robot's one."""
        self._of[experience_id : experience_id + 1] = [self.current]

    def merge(self, component: int, into: int) -> None:
        """Assign the experiences of one component, and the robot if it is there, to another."""
        self.merge_count += 1
        self._of = [into if number == component else number for number in self._of]
        if self.current == component:
            self.current = into
