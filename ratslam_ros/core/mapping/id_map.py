# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Id maps: translate the ids of a peer node, which may be restarted, to ids that stay unique."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ratslam_ros.core.common.saved import Field, Saved, count

NO_MEMORY_NS = 0
"""Memory stamp of a node that has not learned anything yet."""

MIN_MEMORY_NS = 1
"""Smallest memory stamp of a node that has learned something; the stamps of a video begin at 0."""


class IdMap(Saved):
    """Translates a peer's ids, which start at 0 after each restart, to own ids that stay unique.

    The stamp of the first item that the peer learned identifies its memory. After a restart the
    peer counts from 0 again, and its ids denote other items: they are mapped to own ids above all
    used ones. Until the peer's first restart, own ids equal the peer's ids.
    """

    SAVED: ClassVar[tuple[Field, ...]] = (
        Field('memory_ns', 'memory_ns', int), count('forgotten', 'restarts'),
        count('base', '_base'), count('end', '_end'),
    )

    def __init__(self) -> None:
        self.memory_ns = NO_MEMORY_NS
        """Stamp of the peer's memory that the ids belong to at present."""
        self.restarts = 0
        """Number of times the peer's ids started to denote other items."""
        self._base = 0
        self._end = 0

    def set_memory(self, memory_ns: int) -> bool:
        """Set the peer's memory, and return whether it replaces another one.

        Args:
            memory_ns: memory stamp of a received message; ``NO_MEMORY_NS`` is ignored.
        """
        if memory_ns in (NO_MEMORY_NS, self.memory_ns):
            return False
        replaced = self.memory_ns != NO_MEMORY_NS
        self.memory_ns = memory_ns
        if replaced:
            self.restart()
        self._base = self._end
        return replaced

    def restart(self) -> None:
        """Map all ids to new own ids from now on, also if the memory stamp stays the same."""
        self._base = self._end
        self.restarts += 1

    def was_used(self, peer_id: int) -> bool:
        """Return whether an id of the present memory, or a higher one, has been mapped."""
        return self._base + peer_id < self._end

    def assume(self, count: int) -> None:
        """Use the ids below ``count`` unchanged, as those of a memory without a stamp."""
        self.memory_ns, self._base, self._end = MIN_MEMORY_NS, 0, count

    def own_id(self, peer_id: int) -> int:
        """Return the own id for an id of the present memory; negative ids are returned as is."""
        if peer_id < 0:
            return peer_id
        own = self._base + peer_id
        self._end = max(self._end, own + 1)
        return own


class DenseIdMap(IdMap):
    """Id map without gaps: own ids are assigned in the order in which peer ids are first mapped.

    For a receiver that may have missed ids, because it was started late or messages were lost.
    """

    SAVED = (
        *IdMap.SAVED,
        Field('own', 'own_ids', 'i8', ('', 2),
              save=lambda ids: np.array([[*ids], [*ids.values()]]).T,
              load=lambda rows: dict(rows.tolist())),
    )

    def __init__(self) -> None:
        super().__init__()
        self.own_ids: dict[int, int] = {}
        """Own ids of the mapped ids of the present memory; do not modify."""

    def restart(self) -> None:
        """Map all ids to new own ids from now on, also if the memory stamp stays the same."""
        super().restart()
        self.own_ids.clear()

    def assume(self, count: int) -> None:
        """Use the ids below ``count`` unchanged, as those of a memory without a stamp."""
        super().assume(count)
        self.own_ids = {number: number for number in range(count)}

    def peer_id(self, own_id: int) -> int | None:
        """Return the id of the present memory that has an own id, None if there is none."""
        return next((peer for peer, own in self.own_ids.items() if own == own_id), None)

    def own_id(self, peer_id: int) -> int:
        """Return the own id for an id of the present memory; assign the next one if it has none.

        Unlike in ``IdMap``, negative ids are mapped too: the caller has to exclude them.
        """
        own = self.own_ids.get(peer_id)
        if own is None:
            own = self.own_ids[peer_id] = self._end
            self._end += 1
        return own
