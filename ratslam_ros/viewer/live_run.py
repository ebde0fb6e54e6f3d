# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A live run: records that arrive from other processes, brought into one order."""

from __future__ import annotations

import heapq
import tempfile
import threading
import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from copy import deepcopy
from operator import attrgetter
from pathlib import Path

from ratslam_ros.core.mapping.map_changes import MapChange
from ratslam_ros.history.file import HISTORY_NAME
from ratslam_ros.history.records import (
    CommandRecord,
    ImageRecord,
    PoseRecord,
    Record,
    RouteRecord,
    StatusRecord,
    ViewRecord,
    restamped,
)
from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.viewer.live_history import LiveHistory

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

LATCHED = MapChange, RouteRecord, StatusRecord, CommandRecord
"""Records that may be much older than the moment at which they arrive: they do not begin a run."""

_stamp_of = attrgetter('stamp_ns')


class LiveRun:
    """Records in the order of their stamps, with the state at any moment; thread-safe.

    Records of different topics arrive out of order. Each is held until a record with a stamp that
    is ``HOLD_NS`` later has arrived, or until no record has arrived for ``SILENCE_S``. A record
    that arrives too late for its place gets the stamp after the last one. So the stamps of the
    run never decrease, and a reader that has applied all records up to ``end_ns`` misses none.

    The newest records stay in memory, the tail. All are written to a history file, from which
    earlier moments are read.

    If the stamps of the poses jump back, a new run begins, with a new file.
    """

    is_growing = True

    def __init__(
        self, title: str, path: Path | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Create an empty run.

        Args:
            title: name of the run.
            path: file of the history, replaced if it exists; None for a temporary one. That of a
                second run has a number appended to its name.
            clock: steady clock in s, which only detects silence.

        Raises:
            UnusableInput: the file cannot be written.
        """
        self.title = title
        self.problems: dict[str, str] = {}
        """Notices by key, set by the owner of the run."""
        self.required_views: float | None = None
        """Number of views that must agree on a place, set by the owner; None if unknown."""
        self._configuration = ''
        self._clock = clock
        self._lock = threading.RLock()
        self._sequence = self._runs = 0
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        if path is None:
            self._folder = tempfile.TemporaryDirectory(prefix='ratslam-view-')
            path = Path(self._folder.name) / HISTORY_NAME
        self._path = path
        self._begin()

    def _begin(self) -> None:
        self._held: list[tuple[int, int, Record]] = []
        self._newest_ns = self._pose_ns = 0
        self._added_s = self._clock()
        self._begin_ns = self._end_ns = 0
        self._dropped = 0
        """Number of records before the tail."""
        self._tail: list[Record] = []
        self._base = RunState()
        """The state before the first record of the tail."""
        self._runs += 1
        number = '' if self._runs == 1 else f'-{self._runs}'
        path = self._path.with_name(f'{self._path.stem}{number}{self._path.suffix}')
        self._history = LiveHistory(path, self.title)
        if self._configuration:
            self._history.configure(self._configuration)

    def close(self) -> None:
        """Write the records that are held, and close the file."""
        with self._lock:
            self._release_all()
            self._history.close()
            if self._folder is not None:
                self._folder.cleanup()

    # The executor's thread

    def configure(self, configuration: str) -> None:
        """Have the history contain the parameters of the nodes, as YAML."""
        with self._lock:
            self._configuration = configuration
            self._history.configure(configuration)

    def add(self, record: Record) -> bool:
        """Add a record; return whether a new run begins with it, as the stamps jumped back."""
        with self._lock:
            stamp_ns = record.stamp_ns
            begins = False
            if isinstance(record, PoseRecord):
                begins = 0 < stamp_ns < self._pose_ns - JUMP_BACK_NS
                if begins:
                    self._release_all()
                    self._history.close()
                    self._begin()
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

    def _release_all(self) -> None:
        self._release(max((stamp_ns for stamp_ns, _, _ in self._held), default=0))

    def _release(self, until_ns: int) -> None:
        """Append the held records up to a stamp to the run."""
        before_ns = self._end_ns
        while self._held and self._held[0][0] <= until_ns:
            stamp_ns, _, record = heapq.heappop(self._held)
            if not self._begin_ns and isinstance(record, LATCHED):
                stamp_ns = max(stamp_ns, self._first_ns())
            stamp_ns = max(stamp_ns, self._end_ns)
            if stamp_ns <= before_ns:  # readers have passed it
                stamp_ns = before_ns + 1
            if stamp_ns != record.stamp_ns:
                record = restamped(record, stamp_ns)
            self._append(record)

    def _first_ns(self) -> int:
        """Return the stamp of the first held record that is not latched, 0 if there is none."""
        stamps = [stamp for stamp, _, record in self._held if not isinstance(record, LATCHED)]
        return min(stamps, default=0)

    def _append(self, record: Record) -> None:
        self._begin_ns = self._begin_ns or record.stamp_ns
        self._end_ns = record.stamp_ns
        self._tail.append(record)
        self._history.add(record)
        tail = self._tail
        if len(tail) > 2 * MAX_TAIL or tail[0].stamp_ns < self._end_ns - 2 * TAIL_NS:
            drop = max(
                len(tail) - MAX_TAIL, bisect_left(tail, self._end_ns - TAIL_NS, key=_stamp_of)
            )
            for old in tail[:drop]:
                self._base.apply(old)
            del tail[:drop]
            self._dropped += drop

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
                self._release_all()
            return self._end_ns

    @property
    def notices(self) -> Sequence[str]:
        """What the user must know, such as which topics are silent."""
        problem = self._history.problem
        return [*self.problems.values(), *([problem] if problem else [])]

    def seek(self, stamp_ns: int) -> RunState:
        """Return a new state: that of the last record whose stamp is not later."""
        with self._lock:
            if self._dropped and stamp_ns < self._tail[0].stamp_ns:
                return self._history.reader.seek(stamp_ns)
            state = deepcopy(self._base)
            state.position = self._dropped
            self.advance(state, stamp_ns)
            return state

    def advance(self, state: RunState, stamp_ns: int) -> None:
        """Apply to a state all records between it and a later stamp."""
        with self._lock:
            if state.position is None and self._dropped and stamp_ns < self._tail[0].stamp_ns:
                self._history.reader.advance(state, stamp_ns)
                return
            at = (state.position or 0) - self._dropped
            if at < 0:  # it comes from the history, or was left alone for minutes
                found = self.seek(stamp_ns)
                for name in found.__struct_fields__:
                    setattr(state, name, getattr(found, name))
                return
            end = max(bisect_right(self._tail, stamp_ns, key=_stamp_of), at)
            for record in self._tail[at:end]:
                state.apply(record)
            state.position = self._dropped + end

    def image_at(self, stamp_ns: int) -> bytes | None:
        """Return the best image of a stamp as JPEG, None if there is none near it."""
        with self._lock:
            near = self._tail[
                bisect_left(self._tail, stamp_ns - NS_PER_S, key=_stamp_of) :
                bisect_right(self._tail, stamp_ns + NS_PER_S, key=_stamp_of)
            ]
        images = [record for record in near if isinstance(record, ImageRecord)]
        if not images:
            return self._history.reader.image_at(stamp_ns)
        return min(images, key=lambda image: abs(image.stamp_ns - stamp_ns)).jpeg

    def step(self, stamp_ns: int, views: int) -> int:
        """Return the stamp of the view that is a number of views later, or earlier if negative."""
        with self._lock:
            newest = [one.stamp_ns for one in self._tail if isinstance(one, ViewRecord)]
        if not newest or (stamp_ns < newest[0] or (self._dropped and stamp_ns == newest[0])):
            return self._history.reader.step(stamp_ns, views)
        later = views + (bisect_left if views < 0 else bisect_right)(newest, stamp_ns)
        at = later if views < 0 else later - 1
        return newest[min(max(at, 0), len(newest) - 1)] if views else stamp_ns

    def visits(self, experience_id: int, until_ns: int) -> list[ViewRecord]:
        """Return the first view of every visit of an experience up to a stamp, oldest first."""
        return self._history.reader.visits(experience_id, until_ns)
