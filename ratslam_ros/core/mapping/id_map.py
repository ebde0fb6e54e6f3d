# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Numbering: ids of a neighbour, which may be restarted -> ids that stay."""

from __future__ import annotations

from ratslam_ros.core.common.state import State

NOTHING_LEARNED = 0
"""The memory stamp of who has learned nothing yet."""
FIRST_MEMORY = 1
"""The least that is one: the stamps of a video begin at 0."""


class IdMap:
    """Ids that stay, for those of a neighbour that counts what it has learned from 0.

    The neighbour names its memory by the stamp of the first thing learned. After a restart it
    counts from 0 again, and means other things by it: those get numbers above all known ones.
    Whoever never lost a neighbour has that neighbour's own numbers.
    """

    def __init__(self) -> None:
        self.memory_ns = NOTHING_LEARNED
        """The memory that the ids are of now."""
        self.forgotten = 0
        """How often the neighbour came back with another memory."""
        self._base = 0
        self._end = 0

    def remember(self, memory_ns: int) -> bool:
        """Take the memory that a message names; return whether that is another one than before."""
        if memory_ns in (NOTHING_LEARNED, self.memory_ns):
            return False
        another = self.memory_ns != NOTHING_LEARNED
        self.memory_ns = memory_ns
        self.forgotten += another
        self._base = self._end
        return another

    def forget(self) -> None:
        """Take all ids for those of other things from now on."""
        self._base = self._end
        self.forgotten += 1

    def was_used(self, theirs: int) -> bool:
        """Tell whether an id of the present memory, or one above it, has been numbered."""
        return self._base + theirs < self._end

    def state(self) -> State:
        """Return all numbers, for ``restore``."""
        return {
            'memory_ns': self.memory_ns, 'forgotten': self.forgotten, 'base': self._base,
            'end': self._end,
        }  # fmt: skip

    def restore(self, state: State) -> None:
        """Take what ``state`` gave."""
        self.memory_ns, self.forgotten = state['memory_ns'], state['forgotten']
        self._base, self._end = state['base'], state['end']

    def number(self, theirs: int) -> int:
        """Return the number of an id of the present memory; negative ids stay as they are."""
        if theirs < 0:
            return theirs
        own = self._base + theirs
        self._end = max(self._end, own + 1)
        return own


class DenseIdMap(IdMap):
    """Numbers without gaps, in order of first use: for whoever came late or missed some ids."""

    def __init__(self) -> None:
        super().__init__()
        self._own: dict[int, int] = {}

    def remember(self, memory_ns: int) -> bool:
        """Take the memory that a message names; return whether that is another one than before."""
        another = super().remember(memory_ns)
        if another:
            self._own.clear()
        return another

    def forget(self) -> None:
        """Take all ids for those of other things from now on."""
        super().forget()
        self._own.clear()

    def state(self) -> State:
        """Return all numbers, for ``restore``."""
        return {**super().state(), 'own': [list(pair) for pair in self._own.items()]}

    def restore(self, state: State) -> None:
        """Take what ``state`` gave."""
        super().restore(state)
        self._own = {theirs: own for theirs, own in state['own']}

    def knows(self, theirs: int) -> bool:
        """Tell whether an id of the present memory has a number."""
        return theirs in self._own

    def number(self, theirs: int) -> int:
        """Return the number of an id of the present memory, the next one where it has none."""
        own = self._own.get(theirs)
        if own is None:
            own = self._own[theirs] = self._end
            self._end += 1
        return own
