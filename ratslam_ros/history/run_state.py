# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""State of a run at a moment: the sum of all records up to it."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from ratslam_ros.core.common.rows import Rows, require_shapes, with_capacity
from ratslam_ros.core.mapping.map_changes import MAX_ROWS, MapChange, MapMirror
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
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

NEWEST_COUNT = 10
"""A transition to one of the newest experiences closes no loop."""

MAX_CLOSURES = 500
"""Largest number of listed loop closures: more than a page shows."""

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
        row, count = view.target_id, len(self)
        if row >= count:
            for name in self.__struct_fields__:
                grown = with_capacity(getattr(self, name), max(row + 1, 2 * count))
                grown[count:] = -1 if name == 'errors' else 0
                setattr(self, name, grown)
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
        self._points = Rows(2)
        self._last = 0.0, 0.0
        self.version = 0
        """Counter that grows with every point."""

    @property
    def points_m(self) -> NDArray[np.float64]:
        """(n, 2) positions in m, oldest first."""
        return self._points.values

    def add(self, position: tuple[float, float]) -> None:
        """Add a position, rounded to 1 mm as in a file, unless it is near the last one."""
        if len(self._points) and math.dist(self._last, position) < TRAIL_SPACING_M:
            return
        if len(self._points) == TRAIL_LENGTH:
            self._points.replace(self.points_m[TRAIL_LENGTH // 4 :].copy())
        x_m, y_m = position
        self._last = round(x_m, 3), round(y_m, 3)
        self._points.append(self._last)
        self.version += 1

    def replace(self, points_m: NDArray[np.float64]) -> None:
        """Set all positions, (n, 2); of more than ``TRAIL_LENGTH`` the oldest are left out."""
        self._points.replace(points_m[-TRAIL_LENGTH:])
        if len(self._points):
            x_m, y_m = self.points_m[-1].tolist()
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
        closures: the newest views that closed a loop, or would have but for a reason.
        newest: ids of the newest experiences.
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
    closures: list[ViewRecord] = []
    newest: list[int] = []
    trail: Trail = field(default_factory=Trail)
    dead_reckoning: Trail = field(default_factory=Trail)
    truth: Trail = field(default_factory=Trail)

    def apply(self, record: Record) -> None:
        """Add the next record; raises ValueError for a map that is too large."""
        self.stamp_ns = max(self.stamp_ns, record.stamp_ns)
        self.record_count += 1
        match record:
            case MapChange():
                if record.experience_count > MAX_ROWS:
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
        before = NO_EXPERIENCE if self.view is None else self.view.recognised_id
        self.view = view
        if view.action == 'create':
            self.newest = [*self.newest[1 - NEWEST_COUNT :], view.target_id]
        if (
            view.reason or view.relocated_to != NO_EXPERIENCE
            or (view.action == 'link' and view.target_id not in self.newest)
            or (
                view.recognised_id != before
                and view.recognised_id not in (NO_EXPERIENCE, *self.newest)
            )
        ):
            self.closures.append(view)
            del self.closures[:-MAX_CLOSURES]
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
