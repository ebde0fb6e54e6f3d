# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""State of a run at a moment: the sum of all records up to it."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from ratslam_ros.core.common.rows import require_shapes
from ratslam_ros.core.mapping.map_changes import MAX_EXPERIENCES, MapChange, MapMirror
from ratslam_ros.history.records import (
    CellsRecord,
    CommandRecord,
    ImageRecord,
    MatchRecord,
    PoseRecord,
    Record,
    RouteRecord,
    ScanRecord,
    StatusRecord,
    ViewRecord,
)

NS_PER_S = 1_000_000_000

RECENT_NS = 60 * NS_PER_S
"""Time for which views are kept."""

MAX_COMMANDS = 100
"""Largest number of commands that are kept."""

TRAIL_SPACING_M = 0.1
"""Distance between two points of a trail."""

TRAIL_LENGTH = 20_000
"""Largest number of points of a trail; the oldest are removed."""


LATEST: dict[type[Record], str] = {
    CellsRecord: 'cells', ImageRecord: 'image', MatchRecord: 'match', ScanRecord: 'scan',
    RouteRecord: 'route', StatusRecord: 'status',
}
"""Kinds of which a state contains only the last record, and the attribute with it."""


def _no_numbers() -> NDArray[np.int64]:
    return np.empty(0, np.int64)


class Visits(Struct, array_like=True):
    """When and how often every experience was visited, and how well its view matched.

    Attributes:
        created_ns: (n,) stamp at which every experience was created, 0 if unknown.
        visited_ns: (n,) stamp of the last visit, 0 if there was none.
        counts: (n,) number of visits.
        errors: (n,) match error at the last visit; -1 if there is none.
    """

    created_ns: NDArray[np.int64] = field(default_factory=_no_numbers)
    visited_ns: NDArray[np.int64] = field(default_factory=_no_numbers)
    counts: NDArray[np.int64] = field(default_factory=_no_numbers)
    errors: NDArray[np.float32] = field(default_factory=lambda: np.empty(0, np.float32))

    def __post_init__(self) -> None:
        n = len(self.counts)
        require_shapes(self, created_ns=(n,), visited_ns=(n,), counts=(n,), errors=(n,))

    def __len__(self) -> int:
        return len(self.counts)

    def add(self, view: ViewRecord) -> None:
        """Count a visit of the target of the view's action."""
        row = view.target_id
        if row >= len(self):
            more = max(row + 1, 2 * len(self)) - len(self)
            self.created_ns = np.append(self.created_ns, np.zeros(more, np.int64))
            self.visited_ns = np.append(self.visited_ns, np.zeros(more, np.int64))
            self.counts = np.append(self.counts, np.zeros(more, np.int64))
            self.errors = np.append(self.errors, np.full(more, -1.0, np.float32))
        if view.action == 'create':
            self.created_ns[row] = view.stamp_ns
            self.counts[row] = 0
        if view.action in ('create', 'link', 'set'):
            self.counts[row] += 1
        self.visited_ns[row] = view.stamp_ns
        self.errors[row] = view.error


class Trail:
    """Positions of the robot, with a point about every ``TRAIL_SPACING_M``."""

    def __init__(self) -> None:
        self._points = np.empty((0, 2))
        self._count = 0
        self._last = 0.0, 0.0
        self.version = 0
        """Counter that grows with every point."""

    @property
    def points_m(self) -> NDArray[np.float64]:
        """(n, 2) positions in m, oldest first."""
        return self._points[: self._count]

    def add(self, position: tuple[float, float]) -> None:
        """Add a position, rounded to 1 mm as in a file, unless it is near the last one."""
        n = self._count
        if n and math.dist(self._last, position) < TRAIL_SPACING_M:
            return
        if n == TRAIL_LENGTH:
            n = TRAIL_LENGTH * 3 // 4
            self._points[:n] = self._points[TRAIL_LENGTH - n : TRAIL_LENGTH]
        elif n == len(self._points):
            self._points = np.append(self._points, np.empty((max(64, n), 2)), axis=0)
        x_m, y_m = position
        self._points[n] = self._last = round(x_m, 3), round(y_m, 3)
        self._count = n + 1
        self.version += 1

    def replace(self, points_m: NDArray[np.float64]) -> None:
        """Set all positions, (n, 2); of more than ``TRAIL_LENGTH`` the oldest are left out."""
        self._points = points_m[-TRAIL_LENGTH:].copy()
        self._count = len(self._points)
        if self._count:
            x_m, y_m = self._points[-1].tolist()
            self._last = x_m, y_m
        self.version += 1


class RunState(Struct, array_like=True, eq=False):
    """Everything that can be shown of a run at one moment.

    Attributes:
        stamp_ns: largest stamp of the records, 0 before the first.
        record_count: number of applied records: the position in the history.
        position: number of records of a live run that it includes; None if it was read from a
            history.
        commands: the newest commands, oldest first.
        recent: views of the last minute.
    """

    stamp_ns: int = 0
    record_count: int = 0
    position: int | None = None
    map: MapMirror = field(default_factory=MapMirror)
    visits: Visits = field(default_factory=Visits)
    pose: PoseRecord | None = None
    view: ViewRecord | None = None
    cells: CellsRecord | None = None
    image: ImageRecord | None = None
    match: MatchRecord | None = None
    scan: ScanRecord | None = None
    route: RouteRecord | None = None
    status: StatusRecord | None = None
    commands: list[CommandRecord] = []
    recent: list[ViewRecord] = []
    trail: Trail = field(default_factory=Trail)
    dead_reckoning: Trail = field(default_factory=Trail)
    truth: Trail = field(default_factory=Trail)

    def apply(self, record: Record) -> None:
        """Add the next record; raises ValueError for a map that is too large."""
        self.stamp_ns = max(self.stamp_ns, record.stamp_ns)
        self.record_count += 1
        match record:
            case MapChange():
                if record.experience_count > MAX_EXPERIENCES:
                    raise ValueError(f'a map has {record.experience_count} experiences')
                self.map.apply(record)
            case ViewRecord():
                self._see(record)
            case PoseRecord():
                self._move(record)
            case CommandRecord():
                self.commands.append(record)
                del self.commands[:-MAX_COMMANDS]
            case _:
                setattr(self, LATEST[type(record)], record)

    def _see(self, view: ViewRecord) -> None:
        self.view = view
        self.recent.append(view)
        while self.recent[0].stamp_ns < view.stamp_ns - RECENT_NS:
            del self.recent[0]
        if view.target_id >= 0 and not view.reason:
            self.visits.add(view)

    def _move(self, record: PoseRecord) -> None:
        self.pose = record
        self.trail.add(record.pose[:2])
        if record.dead_reckoning is not None:
            self.dead_reckoning.add(record.dead_reckoning[:2])
        if record.truth is not None:
            self.truth.add(record.truth[:2])
