# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run that is read from its history file, finished or growing in another process."""

from __future__ import annotations

import operator
import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.checkpoint import decode_state
from ratslam_ros.history.closures import MAX_CLOSURES
from ratslam_ros.history.encoding import MAX_BYTES, DamagedHistory, decoded, decompressed
from ratslam_ros.history.file import APPLICATION_ID, PART, SCHEMA_VERSION, TABLES, HistoryMeta
from ratslam_ros.history.recorded_images import RecordedImages
from ratslam_ros.history.records import ImageRecord, PoseRecord, Record, ViewRecord
from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.history.truth import Truth
from ratslam_ros.history.writer import is_locked
from ratslam_ros.limits import check_tables, guard_database
from ratslam_ros.results.trajectory import Trajectory

SECTION, VIEWS = '/**/pose_cells', 'pc_vt_agree_views'
"""Number of views that must agree on a place, in the configuration of the run."""

MAX_IMAGE_AGE_NS = 10 * NS_PER_S
"""Age up to which the last image is shown for a stamp."""

BUSY_S = 2.0
"""Time for which a reader waits while the writer closes the file."""



class HistoryRun:
    """A ``RunSource`` over a history file; it may be used from several threads.

    All methods raise UnusableInput if the file is damaged. The position of a record in time is the
    largest stamp up to it: records of late messages have the time of those before them. All stamps
    of the methods are such times. The state at a stamp is the sum of all records up to it;
    advancing in steps of any size gives the same state as seeking.

    While the file grows, the database is opened for each call, so that its writer can close it.
    """

    def __init__(self, path: Path) -> None:
        """Open a history file.

        Args:
            path: the file; with the suffix ``.part`` while it grows.

        Raises:
            UnusableInput: the file is no history, or of another version.
        """
        self._path = path
        self._lock = threading.Lock()
        self._database: sqlite3.Connection | None = None
        with self._connected() as database:
            if database.execute('PRAGMA application_id').fetchone() != (APPLICATION_ID,):
                raise UnusableInput(
                    f'{path} is a database, but no history of a run; give a results folder'
                )
            (version,) = database.execute('PRAGMA user_version').fetchone()
            if version != SCHEMA_VERSION:
                raise UnusableInput(
                    f'{path} has schema version {version}, expected {SCHEMA_VERSION}; '
                    'use the version of ratslam_ros that wrote it, or replay the recording again'
                )
            check_tables(database, path, TABLES)
            row = database.execute("SELECT value FROM meta WHERE key = 'run'").fetchone()
            if row is None:
                raise UnusableInput(f'{path} describes no run; replay the recording again')
            self.meta = HistoryMeta.from_json(row[0], path)
        self.title = self.meta.title
        """Name of the run, such as that of the recording."""
        self.added_notices: Sequence[str] = ()
        """What the user must know besides, set by the owner of the run."""
        self._trajectory: Trajectory | None = None
        self._truth: Truth | None = None
        self._images = RecordedImages(self.meta)
        self._begin_ns = self._end_ns = 0
        self._is_growing, self._has_ended = True, False
        self._poll()

    def close(self) -> None:
        """Close the file and the recording."""
        with self._lock:
            if self._database is not None:
                self._database.close()
                self._database = None
        self._images.close()

    def set_truth(self, trajectory: Trajectory) -> None:
        """Show a true trajectory from now on; it is aligned by the first pose of the run."""
        self._trajectory, self._truth = trajectory, None

    @property
    def begin_ns(self) -> int:
        """Stamp of the first record, 0 if there is none yet."""
        self._poll()
        return self._begin_ns

    @property
    def end_ns(self) -> int:
        """Stamp of the last record, 0 if there is none yet."""
        self._poll()
        return self._end_ns

    @property
    def is_growing(self) -> bool:
        """Whether more records may follow."""
        self._poll()
        return self._is_growing

    @property
    def notices(self) -> Sequence[str]:
        """What the user must know."""
        self._poll()
        notices = [*self.added_notices]
        if not self._is_growing and not self._has_ended:
            notices.append('the run was interrupted: the history ends with its last moments')
        if self._images.problem:
            notices.append(self._images.problem)
        return notices

    @cached_property
    def required_views(self) -> float | None:
        """Number of views that must agree on a place, None if unknown."""
        try:
            sections = yaml.safe_load(self.meta.configuration)
            return float(sections[SECTION]['ros__parameters'][VIEWS])
        except (yaml.YAMLError, LookupError, TypeError, ValueError):
            return None

    def seek(self, stamp_ns: int) -> RunState:
        """Return a new state: that of the last record whose stamp is not later."""
        row = self._first(
            'SELECT data FROM checkpoints WHERE stamp_ns <= ? ORDER BY stamp_ns DESC, '
            'record_count DESC LIMIT 1', stamp_ns,
        )
        with self._checking():
            state = RunState() if row is None else decode_state(decompressed(row[0]))
        self.advance(state, stamp_ns)
        return state

    def advance(self, state: RunState, stamp_ns: int) -> None:
        """Apply to a state all records between it and a later stamp."""
        with self._checking():
            for first_record, data in self._segments(state.record_count, stamp_ns):
                for record in _records(data)[state.record_count - first_record :]:
                    if record.stamp_ns > stamp_ns:
                        break
                    state.apply(record)
        if self._trajectory is not None and state.pose is not None:
            if self._truth is None:
                first = self._first_pose()
                self._truth = Truth(self._trajectory, first.stamp_ns, first.pose)
            self._truth.apply(state)

    def image_at(self, stamp_ns: int) -> bytes | None:
        """Return the best image of a stamp as JPEG, None if there is none near it.

        That of the recording if it is there, else the small one of the history.
        """
        view = self.view_at(stamp_ns)
        if view is not None and stamp_ns - view.stamp_ns <= MAX_IMAGE_AGE_NS:
            image = self._images.at(view.stamp_ns)
            if image is not None:
                return image
        return self._small_image(stamp_ns)

    def view_at(self, stamp_ns: int) -> ViewRecord | None:
        """Return the last view whose stamp is not later."""
        found = self._view(self._view_count(stamp_ns) - 1)
        return None if found is None else found[1]

    def step(self, stamp_ns: int, views: int) -> int:
        """Return the stamp of the view that is a number of views later, or earlier if negative.

        It is that of the first or last view if there are not as many, and the given one if there
        are none.
        """
        last = self._view_count(self.end_ns) - 1
        number = self._view_count(stamp_ns) - 1 + views
        found = self._view(min(max(number, 0), last))
        return stamp_ns if found is None else found[0]

    def visits(self, experience_id: int, until_ns: int) -> list[ViewRecord]:
        """Return the first view of every visit of an experience up to a stamp, oldest first.

        The id may have been that of another experience before, whose visits are left out.
        """
        views = self._views(
            'SELECT record FROM visits WHERE experience = ? AND stamp_ns <= ? ORDER BY view',
            experience_id, until_ns,
        )
        created = [n for n, view in enumerate(views) if view.action == 'create']
        return views[created[-1] :] if created else views

    def closures(self, until_ns: int) -> list[ViewRecord]:
        """Return the newest views that closed a loop, or would have but for a reason.

        At most ``MAX_CLOSURES`` up to a time, oldest first.
        """
        return self._views(
            'SELECT record FROM closures WHERE stamp_ns <= ? ORDER BY view DESC LIMIT ?',
            until_ns, MAX_CLOSURES,
        )[::-1]

    def _poll(self) -> None:
        """Read how far the run is, until it has ended."""
        if not self._is_growing:
            return
        final = self._path.with_name(self._path.name.removesuffix(PART))
        is_alive = is_locked(final)  # Asked first: the writer ends the run before it lets go.
        begin_ns, end_ns, ended = self._first(
            'SELECT (SELECT begin_ns FROM segments ORDER BY first_record LIMIT 1), '
            '(SELECT end_ns FROM segments ORDER BY first_record DESC LIMIT 1), '
            "(SELECT value FROM meta WHERE key = 'ended')"
        )
        with self._checking():
            self._begin_ns, self._end_ns = map(operator.index, (begin_ns or 0, end_ns or 0))
        self._has_ended = ended is not None
        self._is_growing = is_alive and not self._has_ended

    def _first_pose(self) -> PoseRecord:
        """Return the first record of poses, which must exist."""
        with self._connected() as database, self._checking():
            for (data,) in database.execute('SELECT data FROM segments ORDER BY first_record'):
                for record in _records(data):
                    if isinstance(record, PoseRecord):
                        return record
            raise DamagedHistory('a pose is missing')

    def _view_count(self, until_ns: int) -> int:
        """Return the number of views up to a time."""
        row = self._first(
            'SELECT first_view, data, begin_ns FROM segments WHERE begin_ns <= ? '
            'ORDER BY begin_ns DESC, first_record DESC LIMIT 1', until_ns,
        )
        if row is None:
            return 0
        first_view, *segment = row
        with self._checking():
            for at_ns, record in _timed(*segment):
                if at_ns > until_ns:
                    break
                first_view += isinstance(record, ViewRecord)
        return int(first_view)

    def _view(self, number: int) -> tuple[int, ViewRecord] | None:
        """Return time and content of a view by its number, counted from 0; None beyond the end."""
        row = self._first(
            'SELECT first_view, data, begin_ns FROM segments WHERE views > 0 AND first_view <= ? '
            'ORDER BY first_view DESC LIMIT 1', number,
        )
        if row is None:
            return None
        at_view, *segment = row
        with self._checking():
            for at_ns, record in _timed(*segment):
                if isinstance(record, ViewRecord):
                    if at_view == number:
                        return at_ns, record
                    at_view += 1
        return None

    def _small_image(self, until_ns: int) -> bytes | None:
        """Return the last image of the history up to a time, None if it is too old."""
        with self._connected() as database, self._checking():
            for end_ns, *segment in database.execute(
                'SELECT end_ns, data, begin_ns FROM segments WHERE begin_ns <= ? '
                'ORDER BY begin_ns DESC, first_record DESC', (until_ns,),
            ):
                if end_ns < until_ns - MAX_IMAGE_AGE_NS:
                    break
                found = None
                for at_ns, record in _timed(*segment):
                    if at_ns > until_ns:
                        break
                    found = record.jpeg if isinstance(record, ImageRecord) else found
                if found is not None:
                    return found
        return None

    def _segments(self, record_count: int, until_ns: int) -> Iterator[tuple[int, bytes]]:
        with self._connected() as database:
            for first_record, begin_ns, data in database.execute(
                'SELECT first_record, begin_ns, data FROM segments WHERE first_record >= coalesce('
                '(SELECT max(first_record) FROM segments WHERE first_record <= ?), 0) '
                'ORDER BY first_record', (record_count,),
            ):
                if begin_ns > until_ns:
                    break
                yield first_record, data

    def _views(self, query: str, *values: int) -> list[ViewRecord]:
        with self._connected() as database, self._checking():
            return [decoded(data, ViewRecord) for (data,) in database.execute(query, values)]

    def _first(self, query: str, *values: int) -> Any:
        with self._connected() as database:
            return database.execute(query, values).fetchone()

    @contextmanager
    def _checking(self) -> Iterator[None]:
        """Name the file in errors about damaged data."""
        try:
            yield
        # SQLite does not enforce the types of columns.
        except (DamagedHistory, ValueError, IndexError, OverflowError, TypeError) as error:
            raise UnusableInput(
                f'{self._path} is damaged ({error}); replay the recording again'
            ) from None

    @contextmanager
    def _connected(self) -> Iterator[sqlite3.Connection]:
        with self._lock:
            try:
                database = self._database or self._open()
                try:
                    yield database
                finally:
                    if database is not self._database:
                        database.close()
            except (sqlite3.Error, UnicodeError) as error:  # Errors quote damaged names.
                raise UnusableInput(
                    f'{self._path} is no readable history ({error}); replay the recording again'
                ) from None

    def _open(self) -> sqlite3.Connection:
        final = self._path.with_name(self._path.name.removesuffix(PART))
        while True:
            if not self._path.exists():
                self._path = final  # The run has ended.
            is_part = self._path != final
            try:
                if not self._path.is_file():
                    raise UnusableInput(f'{self._path} does not exist; give a results folder')
                uri = f'{self._path.absolute().as_uri()}?mode=ro'
                database = sqlite3.connect(
                    uri, uri=True, check_same_thread=False, timeout=BUSY_S
                )
                break
            except (UnusableInput, sqlite3.OperationalError):
                if not is_part or self._path.exists():
                    raise
        guard_database(database, MAX_BYTES)
        if not is_part:
            self._database = database
        return database


def _records(data: bytes) -> list[Record]:
    """Return the records of a segment."""
    return decoded(decompressed(data), list[Record])


def _timed(data: bytes, begin_ns: int) -> Iterator[tuple[int, Record]]:
    """Yield time and content of the records of a segment."""
    at_ns = begin_ns
    for record in _records(data):
        at_ns = max(at_ns, record.stamp_ns)
        yield at_ns, record
