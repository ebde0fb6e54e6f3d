# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A live run: records that arrive from other processes, brought into one order."""

from __future__ import annotations

import copy
import heapq
import threading
import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import replace

from ratslam_ros.core.mapping.map_changes import MapChange
from ratslam_ros.history.records import (
    ImageRecord,
    PoseRecord,
    Record,
    RouteRecord,
    StatusRecord,
    ViewRecord,
)
from ratslam_ros.history.run_state import NS_PER_S, RunState

HOLD_NS = 300_000_000
"""Time by which records are held, so that those of slower topics get their place before them: the
action that follows from an image usually arrives within this time."""

SILENCE_S = 0.5
"""Time without a record after which the held records are released."""

JUMP_BACK_NS = NS_PER_S
"""Distance by which the stamps of the poses must go back for a new run to begin, as the nodes have
it (docs/topics.md)."""

TAIL_NS = 120 * NS_PER_S
"""Time for which records stay in memory."""

MAX_TAIL = 20_000
"""Largest number of records that stay in memory, whatever their stamps are."""

LATCHED = MapChange, RouteRecord, StatusRecord
"""Records that may be much older than the moment at which they arrive: they do not begin a run."""


class LiveRun:
    """Records in the order of their stamps, with the state at any moment; thread-safe.

    Records of different topics arrive out of order. Each is held until a record with a stamp that
    is ``HOLD_NS`` later has arrived, or until no record has arrived for ``SILENCE_S``. A record
    that arrives too late for its place gets the stamp after the last one. So the stamps of the
    run never decrease, and a reader that has applied all records up to ``end_ns`` misses none.

    If the stamps of the poses jump back, the run begins anew: everything before is dropped.
    """

    is_growing = True

    def __init__(self, title: str, clock: Callable[[], float] = time.monotonic) -> None:
        """Create an empty run.

        Args:
            title: name of the run.
            clock: steady clock in s, which only detects silence.
        """
        self.title = title
        self.problems: dict[str, str] = {}
        """Notices by key, set by the owner of the run."""
        self._clock = clock
        self._lock = threading.RLock()
        self._sequence = 0
        self._clear()

    def _clear(self) -> None:
        self._held: list[tuple[int, int, Record]] = []
        self._newest_ns = 0  # of the poses, views and images
        self._pose_ns = 0
        self._added_s = self._clock()
        self._begin_ns = self._end_ns = 0
        self._base = RunState()
        """State before the first record of the tail."""
        self._stamps: list[int] = []
        self._tail: list[Record] = []

    # The executor's thread

    def add(self, record: Record) -> bool:
        """Add a record; return whether a new run begins with it, as the stamps jumped back."""
        with self._lock:
            stamp_ns = record.stamp_ns
            begins = False
            if isinstance(record, PoseRecord):
                begins = 0 < stamp_ns < self._pose_ns - JUMP_BACK_NS
                if begins:
                    self._clear()
                self._pose_ns = max(self._pose_ns, stamp_ns)
            if not isinstance(record, LATCHED):
                self._newest_ns = max(self._newest_ns, stamp_ns)
            self._sequence += 1
            heapq.heappush(self._held, (stamp_ns, self._sequence, record))
            self._added_s = self._clock()
            if self._newest_ns:
                self._release(self._newest_ns - HOLD_NS)
            return begins

    def replace_view(self, old: ViewRecord, new: ViewRecord) -> bool:
        """Replace a view if it is still held; return whether it was."""
        with self._lock:
            for index, (stamp_ns, sequence, record) in enumerate(self._held):
                if record is old:
                    self._held[index] = stamp_ns, sequence, new
                    return True
        return False

    def _release(self, until_ns: int) -> None:
        """Append the held records up to a stamp to the run."""
        before_ns = self._end_ns
        while self._held and self._held[0][0] <= until_ns:
            stamp_ns, _, record = heapq.heappop(self._held)
            if before_ns == 0 and isinstance(record, LATCHED) and self._begin_ns == 0:
                stamp_ns = max(stamp_ns, self._first_ns())
            if stamp_ns <= before_ns:
                stamp_ns = before_ns + 1
            if stamp_ns < self._end_ns:  # records before it have been moved
                stamp_ns = self._end_ns
            if stamp_ns != record.stamp_ns:
                record = replace(record, stamp_ns=stamp_ns)
            self._append(record)

    def _first_ns(self) -> int:
        """Return the stamp of the first held record that is not latched, 0 if there is none."""
        stamps = [stamp for stamp, _, record in self._held if not isinstance(record, LATCHED)]
        return min(stamps, default=0)

    def _append(self, record: Record) -> None:
        self._begin_ns = self._begin_ns or record.stamp_ns
        self._end_ns = record.stamp_ns
        self._stamps.append(record.stamp_ns)
        self._tail.append(record)
        if len(self._tail) > 2 * MAX_TAIL or self._stamps[0] < self._end_ns - 2 * TAIL_NS:
            self._shorten()

    def _shorten(self) -> None:
        """Drop the older records of the tail; it is done for many at once, as lists are moved."""
        keep = max(
            len(self._tail) - MAX_TAIL, bisect_left(self._stamps, self._end_ns - TAIL_NS)
        )
        for record in self._tail[:keep]:
            self._base.apply(record)
        del self._tail[:keep], self._stamps[:keep]
        self._begin_ns = self._base.stamp_ns

    # The loop's thread

    @property
    def begin_ns(self) -> int:
        """Stamp of the first record, 0 if there is none yet."""
        return self._begin_ns

    @property
    def end_ns(self) -> int:
        """Stamp of the last record, 0 if there is none yet."""
        with self._lock:
            if self._held and self._clock() - self._added_s > SILENCE_S:
                self._release(max(stamp_ns for stamp_ns, _, _ in self._held))
            return self._end_ns

    @property
    def notices(self) -> Sequence[str]:
        """What the user must know, such as which topics are silent."""
        return list(self.problems.values())

    def seek(self, stamp_ns: int) -> RunState:
        """Return a new state: that of the last record whose stamp is not later."""
        with self._lock:
            state = copy.deepcopy(self._base)
            self._apply(state, 0, stamp_ns)
            return state

    def advance(self, state: RunState, stamp_ns: int) -> None:
        """Apply to a state all records between it and a later stamp."""
        with self._lock:
            self._apply(state, bisect_right(self._stamps, state.stamp_ns), stamp_ns)

    def _apply(self, state: RunState, start: int, until_ns: int) -> None:
        for record in self._tail[start : bisect_right(self._stamps, until_ns)]:
            state.apply(record)

    def image_at(self, stamp_ns: int) -> bytes | None:
        """Return the best image of a stamp as JPEG, None if there is none near it."""
        with self._lock:
            images = [record for record in self._tail if isinstance(record, ImageRecord)]
        nearest = min(images, key=lambda image: abs(image.stamp_ns - stamp_ns), default=None)
        if nearest is None or abs(nearest.stamp_ns - stamp_ns) > NS_PER_S:
            return None
        return nearest.jpeg

    def _views(self, until_ns: int) -> list[ViewRecord]:
        with self._lock:
            records = self._tail[: bisect_right(self._stamps, until_ns)]
        return [record for record in records if isinstance(record, ViewRecord)]

    def view_at(self, stamp_ns: int) -> ViewRecord | None:
        """Return the last view whose stamp is not later."""
        views = self._views(stamp_ns)
        return views[-1] if views else None

    def step(self, stamp_ns: int, views: int) -> int:
        """Return the stamp of the view that is a number of views later, or earlier if negative."""
        stamps = [view.stamp_ns for view in self._views(self._end_ns)]
        if not stamps:
            return stamp_ns
        at = bisect_right(stamps, stamp_ns) - 1
        return stamps[min(max(at + views, 0), len(stamps) - 1)]

    def visits(self, experience_id: int, until_ns: int) -> list[ViewRecord]:
        """Return the first view of every visit of an experience up to a stamp, oldest first."""
        found, last = [], -1
        for view in self._views(until_ns):
            if view.target_id == experience_id != last:
                found.append(view)
            if view.target_id >= 0:
                last = view.target_id
        return found

    def closures(self, until_ns: int) -> list[ViewRecord]:
        """Return the views that closed a loop, or would have but for a reason, oldest first."""
        return [view for view in self._views(until_ns) if view.reason or view.action == 'link']
