# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Numbering: ids of a neighbour that may have been restarted -> ids that stay."""

from __future__ import annotations

NOTHING_LEARNED = 0
"""The memory stamp of who has learned nothing yet."""


class Numbering:
    """Ids in order of their first appearance.

    A neighbour counts what it has learned from 0, and names its memory by the stamp of the first
    thing learned. One with an empty memory counts from 0 again, and means other things by it:
    whoever joined at the start and never lost a neighbour keeps that neighbour's numbers.
    """

    def __init__(self) -> None:
        self.memory_ns = NOTHING_LEARNED
        """The memory that the ids are of now."""
        self.forgotten = 0
        """How often the neighbour came back with another memory."""
        self._own: dict[int, int] = {}
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def remember(self, memory_ns: int) -> bool:
        """Take the memory that a message names; return whether that is another one than before."""
        if memory_ns in (NOTHING_LEARNED, self.memory_ns):
            return False
        another = self.memory_ns != NOTHING_LEARNED
        self.memory_ns = memory_ns
        self.forgotten += another
        self._own.clear()
        return another

    def knows(self, theirs: int) -> bool:
        """Tell whether an id of the present memory has a number."""
        return theirs in self._own

    def number(self, theirs: int) -> int:
        """Return the number of an id of the present memory, a new one where it has none."""
        own = self._own.get(theirs)
        if own is None:
            own = self._own[theirs] = self._count
            self._count += 1
        return own
