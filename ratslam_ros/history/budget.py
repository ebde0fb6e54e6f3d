# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Byte budget of a history: how often records that may be left out are written."""

from __future__ import annotations

from collections import defaultdict

from ratslam_ros.core.mapping.map_changes import MapChange
from ratslam_ros.history.records import (
    CellsRecord,
    ImageRecord,
    MatchRecord,
    PoseRecord,
    ScanRecord,
)

NS_PER_S = 1_000_000_000

RATE_BYTES_PER_S = 13_000
"""Growth of the file per second of stamps: 47 MB per hour, below the promised 50 MB."""

RESERVE_BYTES = 1_000_000
"""Unused bytes that are saved for later, as for the poses that a loop closure moves."""

PERIODS_NS: dict[type, int] = {
    PoseRecord: NS_PER_S // 5,
    MapChange: NS_PER_S,
    CellsRecord: NS_PER_S,
    MatchRecord: NS_PER_S,
    ScanRecord: NS_PER_S,
    ImageRecord: NS_PER_S,
}
"""Shortest period of every kind that may be left out. A robot moves about 0.2 m in 0.2 s; a person
reads pictures once a second, and a replay spends less time on them than on its map. The camera
image is read from the recording at its full rate if that is available."""

STRETCHES = 16
"""The periods are doubled for every 1/16 of half the reserve that is used up."""

MAP_ROW_BYTES = 24
"""Bytes of an experience or link in a change of the map, at most; typical are 8."""

MIN_MAP_ROWS = 64
"""Rows of a change of the map that are always written, so that new experiences appear."""


class Budget:
    """Token bucket over stamps: it depends on the stamps and the size of the file alone."""

    def __init__(self) -> None:
        self.left_bytes = RESERVE_BYTES
        """Bytes that may be written now; negative if too many were."""
        self._size_bytes = 0
        self._stamp_ns: int | None = None
        self._due_ns: defaultdict[type, int] = defaultdict(int)

    def update(self, stamp_ns: int, size_bytes: int) -> None:
        """Set the size of the file at a stamp; stamps must not decrease."""
        if self._stamp_ns is not None:
            earned = (stamp_ns - self._stamp_ns) * RATE_BYTES_PER_S // NS_PER_S
            self.left_bytes = min(self.left_bytes + earned, RESERVE_BYTES)
        self.left_bytes -= size_bytes - self._size_bytes
        self._stamp_ns, self._size_bytes = stamp_ns, size_bytes

    def allows(self, kind: type, stamp_ns: int, is_special: bool = False) -> bool:
        """Return whether a record may be written.

        Args:
            kind: class of the record; those that are not in ``PERIODS_NS`` may always be written.
            stamp_ns: its stamp.
            is_special: the record is worth more than others of its kind, and need not wait.
        """
        return stamp_ns >= self._due_ns[kind] or (
            is_special and self.left_bytes > RESERVE_BYTES // 2
        )

    def written(self, kind: type, stamp_ns: int) -> None:
        """Start the period of a kind of which a record was written."""
        period_ns = PERIODS_NS.get(kind)
        if period_ns is not None:
            self._due_ns[kind] = stamp_ns + (period_ns << self._doublings)

    @property
    def map_rows(self) -> int:
        """Largest number of rows in the next change of the map: a quarter of what is left."""
        return max(self.left_bytes // 4 // MAP_ROW_BYTES, MIN_MAP_ROWS)

    @property
    def _doublings(self) -> int:
        half = RESERVE_BYTES // 2
        return min(max(half - self.left_bytes, 0) * STRETCHES // half, 2 * STRETCHES)
