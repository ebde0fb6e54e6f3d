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

from ratslam_ros.console import print_notice
from ratslam_ros.core.mapping.map_changes import MAX_ROWS, MapChange, MapMirror
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.text import check_output
from ratslam_ros.history.budget import Budget
from ratslam_ros.history.encoding import encode
from ratslam_ros.history.file import HISTORY, HistoryMeta, part_path
from ratslam_ros.history.records import ImageRecord, Record, ViewRecord
from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.maps.chunks import Compressor
from ratslam_ros.maps.locks import CAN_LOCK, MapLock
from ratslam_ros.maps.schema import NEW, beside, build, connect, end_log, remove

SEGMENT_NS = 5 * NS_PER_S
"""Duration of a segment, which a crash may lose. Longer ones compress better and cost less for
each record, but take longer to decode in a look-up."""

SEGMENT_RECORDS = 256
SEGMENT_BYTES = 2**16
"""Number of records, and size of their images, at which a segment ends early."""

MAX_SEGMENT_RECORDS, MAX_SEGMENT_BYTES = 2**14, 2**22
"""The same for stamps that stand still, so that memory is bounded."""

CHECKPOINT_RATIO = 3
"""A checkpoint is written when the segments since the last one are this many times as large as
it, so that checkpoints are at most a quarter of the file however large the map is."""

MIN_CHECKPOINT_BYTES = 2**18
"""Smallest size of the segments between two checkpoints; they are about 20 s of a run,
and are applied in about 20 ms."""

COMMIT_S = 0.25
"""Wall-clock time between two commits: readers see new segments that often. The content of the
file does not depend on it."""

MOST_END_S = 5
"""Number of times that the end waits 1 s for readers; a look-up takes less on an idle machine."""

FILE_BYTES = 'SELECT page_count * page_size FROM pragma_page_count, pragma_page_size'


class HistoryWriter:
    """Appends the records of a run to a file.

    The file has the suffix ``.part`` until it is closed, and a file of an earlier run stays until
    then. Readers in other processes can follow it. A killed writer leaves a readable file with all
    records but those of the last moments.

    If the file cannot be written, this is reported once, and later calls do nothing.
    """

    def __init__(
        self, path: Path, meta: HistoryMeta, report: Callable[[str], None] = print_notice
    ) -> None:
        """Create the file.

        Args:
            path: final name of the file.
            meta: what is known of the run.
            report: receives one line if the file cannot be written.
        """
        self.path = path
        self._meta = meta
        self.problem = ''
        """Why recording has ended, '' if it has not."""
        self._report = report
        self._budget = Budget()
        self._stamp_ns = 0
        self._records: list[Record] = []
        """The records of the next segment."""
        self._begin_ns = self._image_bytes = 0
        self._state = RunState(map=_NoMap())
        """Sum of all written records, without the map."""
        self._packed = Compressor().compressed
        self._since_checkpoint = self._checkpoint_bytes = 0
        self._visited_id = NO_EXPERIENCE
        self._database: sqlite3.Connection | None = None
        self._lock: MapLock | None = None
        self._has_part = False
        """Whether the unfinished file is that of this writer, and not of another one."""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            check_output(path)
            if CAN_LOCK:
                self._lock = MapLock(path)
                with self._lock.opening():
                    self._lock.take(['history'])
            self._has_part = True
            self._database = _created(part_path(path), meta)
        except (OSError, sqlite3.Error, UnusableInput) as error:
            self._fail(error)
        self._commit_s = time.monotonic()

    def wants(self, kind: type[Record], stamp_ns: int, is_special: bool = False) -> bool:
        """Return whether a record of a kind would be written now, and not left out.

        Args:
            kind: class of the record.
            stamp_ns: its stamp.
            is_special: it is worth more than others, such as the image of a new template.
        """
        return self._database is not None and self._budget.allows(kind, stamp_ns, is_special)

    @property
    def wants_whole_map(self) -> bool:
        """Whether the next change of the map should begin with an empty one, for a checkpoint."""
        return self._since_checkpoint >= max(
            CHECKPOINT_RATIO * self._checkpoint_bytes, MIN_CHECKPOINT_BYTES
        )

    def add(self, record: Record, is_special: bool = False) -> bool:
        """Write a record; return whether it is, as some are left out to save space.

        Changes of the map are never left out, because later ones rely on them: use ``add_map``.
        Arrays of the record must not be changed afterwards.
        """
        kind, stamp_ns = type(record), record.stamp_ns
        if self._database is None or (
            kind is not MapChange and not self._budget.allows(kind, stamp_ns, is_special)
        ):
            return False
        before_ns = self._stamp_ns
        at_ns = self._stamp_ns = max(stamp_ns, before_ns)
        if isinstance(record, MapChange) and record.is_restart and self.wants_whole_map:
            self._write()
            self._run(lambda database: self._write_checkpoint(database, at_ns, record))
        elif self._is_full(at_ns, before_ns):
            self._write()
            if time.monotonic() - self._commit_s >= COMMIT_S:
                self._run(self._commit)
        if not self._records:
            self._begin_ns = at_ns
        self._records.append(record)
        self._budget.written(kind, at_ns)
        if isinstance(record, ImageRecord):
            self._image_bytes += len(record.jpeg)
        return self._database is not None

    def add_map(
        self, restart: Callable[[], None], next_change: Callable[[int], MapChange]
    ) -> None:
        """Write a change of the map, which is a whole map if the writer wants one.

        Args:
            restart: makes the next change begin with an empty map.
            next_change: returns the next change with a largest number of rows.
        """
        if self.wants_whole_map:
            restart()
        self.add(next_change(MAX_ROWS if self.wants_whole_map else self._budget.map_rows))

    def _is_full(self, at_ns: int, before_ns: int) -> bool:
        """Return whether a segment ends before a record; records of one stamp stay together."""
        count, size = len(self._records), self._image_bytes
        if at_ns == before_ns:
            return count >= MAX_SEGMENT_RECORDS or size >= MAX_SEGMENT_BYTES
        return count >= SEGMENT_RECORDS or size >= SEGMENT_BYTES or (
            count > 0 and at_ns - self._begin_ns >= SEGMENT_NS
        )

    def configure(self, configuration: str) -> None:
        """Set the parameters of the run, as YAML, if they became known after it began."""
        self._meta = replace(self._meta, configuration=configuration)
        update, text = "UPDATE meta SET value = ? WHERE key = 'run'", self._meta.to_json()
        self._run(lambda database: database.execute(update, (text,)))

    def flush(self) -> None:
        """Make all records visible to readers."""
        self._write()
        self._run(self._commit)

    def close(self) -> None:
        """Write the last records, and give the file its final name."""
        self._write()
        self._run(self._finish)
        self._end()

    def discard(self) -> None:
        """Remove the file; that of an earlier run stays."""
        self._end()
        if self._has_part:
            remove(part_path(self.path))

    def _run(self, step: Callable[[sqlite3.Connection], object]) -> None:
        if self._database is None:
            return
        try:
            step(self._database)
        # The last two are of numbers that do not fit.
        except (OSError, sqlite3.Error, UnusableInput, ValueError, OverflowError) as error:
            self._fail(error)

    def _write(self) -> None:
        if self._records:
            self._run(self._write_segment)
            self._records.clear()
            self._image_bytes = 0

    def _write_segment(self, database: sqlite3.Connection) -> None:
        data = self._packed(encode(self._records))
        state, first_record = self._state, self._state.record_count
        visits = []
        for record in self._records:
            state.apply(record)
            if (
                isinstance(record, ViewRecord) and not record.reason
                and record.target_id not in (NO_EXPERIENCE, self._visited_id)
            ):
                self._visited_id = record.target_id
                visit = record.target_id, state.record_count, state.stamp_ns, encode(record)
                visits.append(visit)
        segment = first_record, self._begin_ns, state.stamp_ns, data
        database.execute('INSERT INTO segments VALUES (?, ?, ?, ?)', segment)
        database.executemany('INSERT INTO visits VALUES (?, ?, ?, ?)', visits)
        self._since_checkpoint += len(data)
        (size_bytes,) = database.execute(FILE_BYTES).fetchone()
        self._budget.update(state.stamp_ns, size_bytes)

    def _write_checkpoint(self, database: sqlite3.Connection, at_ns: int, whole: Record) -> None:
        """Write the state before the record of a whole map."""
        data = self._packed(encode(self._state))
        checkpoint = self._state.record_count, at_ns, data
        database.execute('INSERT INTO checkpoints VALUES (?, ?, ?)', checkpoint)
        self._since_checkpoint = 0
        self._checkpoint_bytes = len(data) + len(self._packed(encode([whole])))

    def _commit(self, database: sqlite3.Connection) -> None:
        database.execute('COMMIT')
        database.execute('BEGIN')
        self._commit_s = time.monotonic()

    def _finish(self, database: sqlite3.Connection) -> None:
        database.execute("INSERT INTO meta VALUES ('ended', '1')")
        database.execute('COMMIT')
        self._database = None
        database.close()
        part = part_path(self.path)
        if not any(end_log(part, HISTORY) for _ in range(MOST_END_S)):
            raise UnusableInput(f'another program reads {part}')
        os.replace(part, self.path)

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
            self._lock.end()
            self._lock = None
        self._records.clear()


class _NoMap(MapMirror):
    """Leaves out the map, which takes long: the record of a whole one follows a checkpoint."""

    def apply(self, change: MapChange) -> None:
        """Do nothing."""


def _created(path: Path, meta: HistoryMeta) -> sqlite3.Connection:
    """Create the file; readers see it only when it is complete, as SQLite cannot wait for them."""
    new = beside(path, NEW)
    remove(new)
    build(new, HISTORY)
    with closing(connect(new, layout=HISTORY)) as database:
        database.execute("INSERT INTO meta VALUES ('run', ?)", (meta.to_json(),))
    remove(path)  # only now, so that the new file has another inode
    new.replace(path)
    database = connect(path, layout=HISTORY)
    database.execute('BEGIN')
    return database
