# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reading access to a history file, which may be growing in another process."""

from __future__ import annotations

import operator
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.checkpoint import decode_state
from ratslam_ros.history.closures import MAX_CLOSURES
from ratslam_ros.history.encoding import KINDS, decode, heads
from ratslam_ros.history.file import (
    APPLICATION_ID,
    PART,
    SCHEMA_VERSION,
    TABLES,
    HistoryMeta,
)
from ratslam_ros.history.packing import MAX_BYTES, DamagedHistory, decompressed
from ratslam_ros.history.records import PoseRecord, Record, ViewRecord
from ratslam_ros.history.run_state import LATEST, RunState
from ratslam_ros.history.writer import is_locked
from ratslam_ros.limits import check_tables, guard_database

_VIEW = KINDS[ViewRecord]
_LATEST_ONLY = frozenset(KINDS[kind] for kind in LATEST)

BUSY_S = 2.0
"""Time for which a reader waits while the writer closes the file."""


class Progress(NamedTuple):
    """How far a run is.

    begin_ns, end_ns: times of the first and of the last record, 0 if there are none. is_growing:
    whether more records may follow. has_ended: whether the run has ended, and all its records are
    in the file.
    """

    begin_ns: int
    end_ns: int
    is_growing: bool
    has_ended: bool


class HistoryFile:
    """A history file. All methods may be called from any thread, and raise UnusableInput.

    The position of a record in time is the largest stamp up to it: records of late messages have
    the time of those before them. All stamps of the methods are such times.

    While the file grows, the database is opened for each call, so that its writer can close it.
    """

    def __init__(self, path: Path) -> None:
        """Open a file.

        Args:
            path: the file; with the suffix ``.part`` while it grows.
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

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            if self._database is not None:
                self._database.close()
                self._database = None

    @property
    def is_part(self) -> bool:
        """Whether the file has the suffix of one that has not been finished."""
        return self._path.name.endswith(PART)

    def progress(self) -> Progress:
        """Return how far the run is."""
        final = self._path.with_name(self._path.name.removesuffix(PART))
        is_alive = is_locked(final)  # Asked first: the writer ends the run before it lets go.
        begin_ns, end_ns, ended = self._first(
            'SELECT (SELECT begin_ns FROM segments ORDER BY first_record LIMIT 1), '
            '(SELECT end_ns FROM segments ORDER BY first_record DESC LIMIT 1), '
            "(SELECT value FROM meta WHERE key = 'ended')"
        )
        has_ended = ended is not None
        with self._checking():
            begin_ns, end_ns = (operator.index(value or 0) for value in (begin_ns, end_ns))
        return Progress(begin_ns, end_ns, is_alive and not has_ended, has_ended)

    def state_at(self, stamp_ns: int) -> RunState:
        """Return the state of the last checkpoint up to a stamp, an empty one if there is none."""
        row = self._first(
            'SELECT data FROM checkpoints WHERE stamp_ns <= ? ORDER BY stamp_ns DESC, '
            'record_count DESC LIMIT 1', stamp_ns,
        )  # fmt: skip
        with self._checking():
            return RunState() if row is None else decode_state(decompressed(row[0]))

    def apply(self, state: RunState, until_ns: int) -> None:
        """Apply all records to a state that follow it, up to a time."""
        latest: dict[int, memoryview] = {}
        count, at_ns = state.record_count, state.stamp_ns
        with self._checking():
            for first_record, data in self._segments(state.record_count, until_ns):
                for number, (kind, stamp_ns, content) in enumerate(
                    heads(decompressed(data)), first_record + 1
                ):
                    if number <= count:
                        continue
                    if max(stamp_ns, at_ns) > until_ns:
                        break
                    at_ns, count = max(stamp_ns, at_ns), number
                    if kind in _LATEST_ONLY:
                        latest[kind] = content
                    else:
                        state.apply(decode(kind, content))
            for kind, content in latest.items():
                state.apply(decode(kind, content))
        state.stamp_ns, state.record_count = at_ns, count

    def first_pose(self) -> PoseRecord | None:
        """Return the first record of poses, None if there is none yet."""
        number = KINDS[PoseRecord]
        with self._connected() as database, self._checking():
            for (data,) in database.execute('SELECT data FROM segments ORDER BY first_record'):
                for kind, _, content in heads(decompressed(data)):
                    if kind == number:
                        record = decode(kind, content)
                        return record if isinstance(record, PoseRecord) else None
        return None

    def view_count(self, until_ns: int) -> int:
        """Return the number of views up to a time."""
        row = self._first(
            'SELECT first_view, data, begin_ns FROM segments WHERE begin_ns <= ? '
            'ORDER BY begin_ns DESC, first_record DESC LIMIT 1', until_ns,
        )  # fmt: skip
        if row is None:
            return 0
        first_view, *segment = row
        with self._checking():
            for at_ns, kind, _ in _timed(*segment):
                if at_ns > until_ns:
                    break
                first_view += kind == _VIEW
        return int(first_view)

    def view(self, number: int) -> tuple[int, ViewRecord] | None:
        """Return time and content of a view by its number, counted from 0; None beyond the end."""
        row = self._first(
            'SELECT first_view, data, begin_ns FROM segments WHERE views > 0 AND first_view <= ? '
            'ORDER BY first_view DESC LIMIT 1', number,
        )  # fmt: skip
        if row is None:
            return None
        at_view, *segment = row
        with self._checking():
            for at_ns, kind, content in _timed(*segment):
                if kind == _VIEW:
                    if at_view == number:
                        return at_ns, _as_view(decode(kind, content))
                    at_view += 1
        return None

    def visits(self, experience_id: int, until_ns: int) -> list[ViewRecord]:
        """Return the first view of every visit of an experience up to a time."""
        return self._views(
            'SELECT record FROM visits WHERE experience = ? AND stamp_ns <= ? ORDER BY view',
            experience_id, until_ns,
        )  # fmt: skip

    def closures(self, until_ns: int) -> list[ViewRecord]:
        """Return the newest views that closed a loop, or would have but for a reason.

        At most ``MAX_CLOSURES`` up to a time, oldest first.
        """
        return self._views(
            'SELECT record FROM closures WHERE stamp_ns <= ? ORDER BY view DESC LIMIT ?',
            until_ns, MAX_CLOSURES,
        )[::-1]  # fmt: skip

    def last(self, kind: type[Record], until_ns: int, since_ns: int) -> Record | None:
        """Return the last record of a kind up to a time, None if there is none since another."""
        number = KINDS[kind]
        with self._connected() as database, self._checking():
            for end_ns, *segment in database.execute(
                'SELECT end_ns, data, begin_ns FROM segments WHERE begin_ns <= ? '
                'ORDER BY begin_ns DESC, first_record DESC', (until_ns,),
            ):  # fmt: skip
                if end_ns < since_ns:
                    break
                found = None
                for at_ns, other, content in _timed(*segment):
                    if at_ns > until_ns:
                        break
                    found = content if other == number else found
                if found is not None:
                    return decode(number, found)
        return None

    def _segments(self, record_count: int, until_ns: int) -> Iterator[tuple[int, bytes]]:
        with self._connected() as database:
            for first_record, begin_ns, data in database.execute(
                'SELECT first_record, begin_ns, data FROM segments WHERE first_record >= coalesce('
                '(SELECT max(first_record) FROM segments WHERE first_record <= ?), 0) '
                'ORDER BY first_record', (record_count,),
            ):  # fmt: skip
                if begin_ns > until_ns:
                    break
                yield first_record, data

    def _views(self, query: str, *values: int) -> list[ViewRecord]:
        with self._connected() as database, self._checking():
            return [
                _as_view(decode(kind, content))
                for (data,) in database.execute(query, values)
                for kind, _, content in heads(data)
            ]

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
            if self.is_part and not self._path.exists():
                self._path = final  # The run has ended.
            try:
                if not self._path.is_file():
                    raise UnusableInput(f'{self._path} does not exist; give a results folder')
                uri = f'{self._path.absolute().as_uri()}?mode=ro'
                database = sqlite3.connect(
                    uri, uri=True, check_same_thread=False, timeout=BUSY_S
                )
                break
            except (UnusableInput, sqlite3.OperationalError):
                if not self.is_part or self._path.exists():
                    raise
        guard_database(database, MAX_BYTES)
        if not self.is_part:
            self._database = database
        return database


def _timed(data: bytes, begin_ns: int) -> Iterator[tuple[int, int, memoryview]]:
    """Yield time, kind and content of the records of a segment."""
    at_ns = begin_ns
    for kind, stamp_ns, content in heads(decompressed(data)):
        at_ns = max(at_ns, stamp_ns)
        yield at_ns, kind, content


def _as_view(record: Record) -> ViewRecord:
    if not isinstance(record, ViewRecord):
        raise DamagedHistory('a view is of another kind')
    return record
