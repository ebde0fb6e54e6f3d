# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writer of a history file."""

from __future__ import annotations

import os
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import IO

from ratslam_ros.console import print_notice
from ratslam_ros.core.mapping.map_changes import MapChange
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.history.budget import Budget
from ratslam_ros.history.checkpoint import encode_state
from ratslam_ros.history.closures import ClosureDetector
from ratslam_ros.history.encoding import compressor, encode, encode_all
from ratslam_ros.history.file import (
    APPLICATION_ID,
    SCHEMA,
    SCHEMA_VERSION,
    HistoryMeta,
    lock_path,
    part_path,
)
from ratslam_ros.history.records import ImageRecord, Record, ViewRecord
from ratslam_ros.history.run_state import NS_PER_S, RunState

SEGMENT_NS = NS_PER_S
"""Duration of a segment: what a crash may lose, and what a look-up has to decompress."""

QUEUE_RECORDS = 128
"""Number of records that are encoded at once: many in a row take half as long as one after every
step of a run, which displaces their code and data from the caches of the processor."""

QUEUE_NS = 5 * NS_PER_S
"""Time that the records in the queue may span, so that few records are not withheld for long."""

SEGMENT_BYTES = 2**16
"""Size at which a segment ends early."""

MAX_SEGMENT_BYTES = 2**22
"""Size at which a segment ends even if the stamps stand still, so that memory is bounded."""

CHECKPOINT_RATIO = 3
"""A checkpoint is written when the segments since the last one are this many times as large as
it, so that checkpoints are at most a quarter of the file however large the map is."""

MIN_CHECKPOINT_BYTES = 2**18
"""Smallest size of the segments between two checkpoints; they are about 20 s of a run,
and are applied in about 20 ms."""

COMMIT_S = 0.25
"""Wall-clock time between two commits: readers see new segments that often. The content of the
file does not depend on it."""

PAGE_BYTES = 1024
"""Page size of SQLite. A segment wastes half a page on average: 2 MB per hour with 1024 bytes, 7
with the usual 4096."""

WAIT_S, MAX_WAIT_S = 0.02, 5.0
"""Time between attempts to end the log, and limit on their sum. A look-up takes less than 1 s."""


class HistoryWriter:
    """Appends the records of a run to a file.

    The file has the suffix ``.part`` until it is closed, and a file of an earlier run stays until
    then. Readers in other processes can follow it. A killed writer leaves a readable file with all
    records but those of the last moments.

    If the file cannot be written, this is reported once, and later calls do nothing.
    """

    def __init__(
        self, path: Path, meta: HistoryMeta, report: Callable[[str], None] | None = None
    ) -> None:
        """Create the file.

        Args:
            path: final name of the file.
            meta: what is known of the run.
            report: receives one line if the file cannot be written; None: standard error.
        """
        self.path = path
        self._meta = meta
        self.problem = ''
        """Why recording has ended, '' if it has not."""
        self._report = report or (lambda line: print_notice(f'warning: {line}'))
        self._budget = Budget()
        self._stamp_ns = 0
        self._queue: list[tuple[type[Record], int, Record | Callable[[], Record]]] = []
        self._queue_ns = self._queue_bytes = 0
        self._state = RunState()
        """Sum of all encoded records."""
        self._compressed = compressor()
        self._pending: list[bytes] = []
        self._pending_bytes = 0
        self._pending_views = 0
        self._visits: list[tuple[int, int, int, bytes]] = []
        self._closures: list[tuple[int, int, bytes]] = []
        self._begin_ns = 0
        self._first_record = self._first_view = 0
        self._since_checkpoint = 0
        self._checkpoint_bytes = 0
        self._visited_id = NO_EXPERIENCE
        self._closing = ClosureDetector()
        self._database: sqlite3.Connection | None = None
        self._lock: IO[bytes] | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._lock = _locked(lock_path(path))
            self._database = _created(part_path(path), meta)
        except (OSError, sqlite3.Error) as error:
            self._fail(error)
        self._commit_s = time.monotonic()

    @property
    def is_open(self) -> bool:
        """Whether records are still written."""
        return self._database is not None

    def wants(self, kind: type[Record], stamp_ns: int, is_special: bool = False) -> bool:
        """Return whether a record of a kind would be written now, and not left out.

        Args:
            kind: class of the record.
            stamp_ns: its stamp.
            is_special: it is worth more than others, such as the image of a new template.
        """
        if self._database is None:
            return False
        at_ns = stamp_ns if stamp_ns > self._stamp_ns else self._stamp_ns
        return self._budget.allows(kind, at_ns, is_special)

    @property
    def map_rows(self) -> int:
        """Largest number of rows that the next change of the map should have."""
        return self._budget.map_rows

    def add(self, record: Record, is_special: bool = False) -> bool:
        """Write a record; return whether it is, as some are left out to save space.

        Changes of the map are never left out, because later ones rely on them: make them with
        ``wants`` and ``map_rows``. Arrays of the record must not be changed afterwards.
        """
        kind = type(record)
        if kind is not MapChange and not self.wants(kind, record.stamp_ns, is_special):
            return False
        return self._enqueue(kind, record.stamp_ns, record)

    def add_later(self, kind: type[Record], stamp_ns: int, make: Callable[[], Record]) -> bool:
        """Write a record that is made when it is encoded, which is cheaper; see ``add``.

        Args:
            kind: class of the record, not ``MapChange``.
            stamp_ns: its stamp.
            make: makes the record, from values that do not change any more.
        """
        return self.wants(kind, stamp_ns) and self._enqueue(kind, stamp_ns, make)

    def _enqueue(
        self, kind: type[Record], stamp_ns: int, record: Record | Callable[[], Record]
    ) -> bool:
        if self._database is None:
            return False
        at_ns = self._stamp_ns = max(stamp_ns, self._stamp_ns)
        if not self._queue:
            self._queue_ns = at_ns
        self._queue.append((kind, at_ns, record))
        self._budget.written(kind, at_ns)
        if isinstance(record, ImageRecord):
            self._queue_bytes += len(record.jpeg)
        if (
            len(self._queue) >= QUEUE_RECORDS or at_ns - self._queue_ns >= QUEUE_NS
            or self._queue_bytes >= SEGMENT_BYTES
        ):
            self._encode_queue()
        return True

    def _encode_queue(self) -> None:
        """Encode the records in the queue, and write the segments that they fill."""
        state, queue, self._queue = self._state, self._queue, []
        try:
            records = [record() if callable(record) else record for _, _, record in queue]
            for (_, at_ns, _), record in zip(queue, records, strict=True):
                data = encode(record)
                if self._pending and self._is_full(at_ns):
                    self._write_pending()
                if not self._pending:
                    self._begin_ns = at_ns
                self._pending.append(data)
                self._pending_bytes += len(data)
                state.apply(record)
                if type(record) is ViewRecord:
                    self._index(record, data)
                    self._pending_views += 1
        except (ValueError, OverflowError) as error:
            self._fail(error)  # A number that does not fit.
        self._queue_bytes = 0
        if time.monotonic() - self._commit_s >= COMMIT_S:
            self._run(self._commit)

    def configure(self, configuration: str) -> None:
        """Set the parameters of the run, as YAML, if they became known after it began."""
        self._meta = replace(self._meta, configuration=configuration)
        text = self._meta.to_json()
        self._run(lambda database: database.execute(
            "UPDATE meta SET value = ? WHERE key = 'run'", (text,)
        ))

    def flush(self) -> None:
        """Make all records visible to readers."""
        self._flush()
        self._run(self._commit)

    def close(self) -> None:
        """Write the last records, and give the file its final name."""
        self._flush()
        self._run(self._finish)
        self._end()

    def discard(self) -> None:
        """Remove the file; that of an earlier run stays."""
        self._end()
        _remove(part_path(self.path))

    def _run(self, step: Callable[[sqlite3.Connection], object]) -> None:
        if self._database is None:
            return
        try:
            step(self._database)
        except (OSError, sqlite3.Error) as error:
            self._fail(error)

    def _index(self, view: ViewRecord, data: bytes) -> None:
        """Note a view for the tables of visits and closures."""
        row = self._first_view + self._pending_views, self._state.stamp_ns, data
        if view.target_id != NO_EXPERIENCE and not view.reason:
            if view.target_id != self._visited_id:
                self._visits.append((view.target_id, *row))
            self._visited_id = view.target_id
        if self._closing.add(view):
            self._closures.append(row)

    def _is_full(self, at_ns: int) -> bool:
        """Return whether a segment ends before a record; records of one stamp stay together."""
        if self._pending_bytes >= MAX_SEGMENT_BYTES:
            return True
        is_long = at_ns - self._begin_ns >= SEGMENT_NS or self._pending_bytes >= SEGMENT_BYTES
        return is_long and at_ns > self._state.stamp_ns

    def _flush(self) -> None:
        self._encode_queue()
        if self._pending:
            self._write_pending()

    def _write_pending(self) -> None:
        self._run(self._write_segment)
        self._pending.clear()
        self._visits.clear()
        self._closures.clear()
        self._pending_bytes = self._pending_views = 0

    def _write_segment(self, database: sqlite3.Connection) -> None:
        data = self._compressed(encode_all(self._pending))
        state = self._state
        database.execute(
            'INSERT INTO segments VALUES (?, ?, ?, ?, ?, ?, ?)',
            (
                self._first_record, len(self._pending), self._begin_ns, state.stamp_ns,
                self._first_view, self._pending_views, data,
            ),
        )
        database.executemany('INSERT INTO visits VALUES (?, ?, ?, ?)', self._visits)
        database.executemany('INSERT INTO closures VALUES (?, ?, ?)', self._closures)
        self._first_record += len(self._pending)
        self._first_view += self._pending_views
        self._since_checkpoint += len(data)
        if self._since_checkpoint >= max(
            CHECKPOINT_RATIO * self._checkpoint_bytes, MIN_CHECKPOINT_BYTES
        ):
            data = self._compressed(encode_state(state))
            database.execute(
                'INSERT INTO checkpoints VALUES (?, ?, ?)',
                (state.record_count, state.stamp_ns, data),
            )
            self._since_checkpoint, self._checkpoint_bytes = 0, len(data)
        (pages,) = database.execute('PRAGMA page_count').fetchone()
        self._budget.update(state.stamp_ns, pages * PAGE_BYTES)

    def _commit(self, database: sqlite3.Connection) -> None:
        database.execute('COMMIT')
        database.execute('BEGIN')
        self._commit_s = time.monotonic()

    def _finish(self, database: sqlite3.Connection) -> None:
        database.execute("INSERT INTO meta VALUES ('ended', '1')")
        database.execute('COMMIT')
        database.execute('PRAGMA synchronous = NORMAL')
        _end_log(database)
        database.close()
        self._database = None
        os.replace(part_path(self.path), self.path)

    def _fail(self, error: Exception) -> None:
        reason = getattr(error, 'strerror', None) or str(error)
        self.problem = (
            f'{self.path} cannot be written ({reason}): the run continues without history; free '
            'space or choose another folder'
        )
        self._end()
        self._report(self.problem)

    def _end(self) -> None:
        database, self._database = self._database, None
        if database is not None:
            database.close()
        if self._lock is not None:
            lock_path(self.path).unlink(missing_ok=True)
            self._lock.close()
            self._lock = None
        self._pending.clear()
        self._queue.clear()


def _created(path: Path, meta: HistoryMeta) -> sqlite3.Connection:
    """Create the file; readers see it only when it is complete, as SQLite cannot wait for them."""
    _remove(path)
    new = path.with_name(f'.{path.name}.new')
    _remove(new)
    with closing(sqlite3.connect(new, isolation_level=None)) as database:
        for pragma in (
            'synchronous = OFF',
            f'page_size = {PAGE_BYTES}',
            'journal_mode = WAL',  # Readers neither wait for the writer nor delay it.
            f'application_id = {APPLICATION_ID}', f'user_version = {SCHEMA_VERSION}',
        ):
            database.execute(f'PRAGMA {pragma}')
        database.executescript(f'BEGIN; {SCHEMA} COMMIT;')
        database.execute("INSERT INTO meta VALUES ('run', ?)", (meta.to_json(),))
    new.replace(path)
    database = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=2.0)
    # A killed process loses nothing committed; a power failure may damage an unfinished file.
    database.execute('PRAGMA synchronous = OFF')
    database.execute('BEGIN')
    return database


def _end_log(database: sqlite3.Connection) -> None:
    """Move the log into the file, once no reader is in the middle of a look-up."""
    waited_s = 0.0
    while True:
        try:
            database.execute('PRAGMA journal_mode = DELETE')
            return
        except sqlite3.OperationalError:  # SQLite itself does not wait here.
            if waited_s >= MAX_WAIT_S:
                raise
            time.sleep(WAIT_S)
            waited_s += WAIT_S


def _remove(path: Path) -> None:
    for suffix in ('', '-wal', '-shm', '-journal'):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def _locked(path: Path) -> IO[bytes]:
    """Create and lock a file, by which readers see that the writer lives."""
    file = open(path, 'ab')  # noqa: SIM115 - held until the history is closed
    try:
        import fcntl  # not on Windows, where a history that was interrupted seems to grow

        for _ in range(20):
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return file
            except BlockingIOError:
                time.sleep(0.05)  # A reader tests the lock for a moment.
        file.close()
        raise OSError(None, 'another run is writing there')
    except ImportError:
        return file


def is_locked(path: Path) -> bool:
    """Return whether the writer of a history lives; ``path``: final name of the history."""
    try:
        with open(lock_path(path), 'rb') as file:
            import fcntl

            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return True
            return False
    except FileNotFoundError:
        return False
    except ImportError:
        return True
