# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writer of a history: segments of records, checkpoints, and an index of the views."""

from __future__ import annotations

import os
import sqlite3
from collections import deque
from collections.abc import Mapping
from pathlib import Path

import zstandard

from ratslam_ros.core.mapping.map_changes import MapChange
from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.checkpoints import encode_state
from ratslam_ros.history.encoding import decode, encode
from ratslam_ros.history.records import (
    CellsRecord,
    ImageRecord,
    MatchRecord,
    PoseRecord,
    Record,
    RouteRecord,
    ScanRecord,
    StatusRecord,
    ViewRecord,
)
from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.history.schema import (
    APPLICATION_ID,
    CLOSURE,
    NO_VISIT,
    REJECTION,
    SCHEMA,
    SCHEMA_VERSION,
    VISIT,
)

SEGMENT_NS, SEGMENT_BYTES = NS_PER_S, 2**18
"""Largest extent of a segment. A reader in another process lags by one segment."""

BYTES_PER_HOUR = 50_000_000
"""Largest size of a file per hour of the run."""

FREE_BYTES = 4_000_000
"""Size that a run of any length may have."""

CHECKPOINT_SHARE = 0.25
"""Size of the checkpoints relative to that of the segments. A seek reads one checkpoint, and
segments of at most 1 / CHECKPOINT_SHARE of its size."""

PERIODS_S: dict[type[Record], float] = {
    PoseRecord: 0.1, MapChange: 0.5, CellsRecord: 0.25, MatchRecord: 0.5, ImageRecord: 0.5,
    ScanRecord: 0.5, RouteRecord: 0.5, StatusRecord: 0.2,
}  # fmt: skip
"""Shortest period of each kind of record, in s of the stamps; all views are stored."""

MAX_STRETCH = 32
"""Largest factor on the periods when the size grows too fast."""

NEWEST_EXPERIENCES_COUNT = 10
"""A transition to one of the newest experiences closes no loop."""


class HistoryWriter:
    """Writes the records of a run to a file while it runs.

    The content depends on the records alone. An error of the disk ends the writing, not the run:
    ``error`` says what happened.
    """

    def __init__(self, path: str | Path, meta: Mapping[str, str]) -> None:
        """Create the file; one that exists is replaced.

        Args:
            path: the file.
            meta: facts about the run, by name, such as the configuration.

        Raises:
            UnusableInput: the file cannot be written.
        """
        self.path = Path(path)
        self.error = ''
        """Why writing has ended early; '' if it has not."""
        self._state = RunState()
        self._records: list[bytes] = []
        self._views: list[tuple[int, int, int, int]] = []
        self._raw = self._first_ns = self._begin_ns = self._now_ns = 0
        self._next_ns: dict[type[Record], int] = {}
        self._newest: deque[int] = deque(maxlen=NEWEST_EXPERIENCES_COUNT)
        self._segment = self._spent = self._since_checkpoint = 0
        self._stretch = 1
        self._pack = zstandard.ZstdCompressor(level=6).compress
        try:
            for suffix in ('', '-wal', '-shm'):
                Path(f'{self.path}{suffix}').unlink(missing_ok=True)
            # Any thread may write, one at a time; Python's sqlite3 is serialised.
            self._file: sqlite3.Connection | None = sqlite3.connect(
                self.path, isolation_level=None, check_same_thread=False
            )
            self._file.execute(f'PRAGMA application_id={APPLICATION_ID}')
            self._file.execute(f'PRAGMA user_version={SCHEMA_VERSION}')
            self._file.execute('PRAGMA journal_mode=WAL')
            self._file.execute('PRAGMA synchronous=NORMAL')  # a history is not worth an fsync
            self._file.executescript(SCHEMA)
            facts = {**meta, 'writer': str(os.getpid())}
            self._file.executemany('INSERT INTO meta VALUES (?, ?)', facts.items())
        except (sqlite3.Error, OSError) as error:
            raise UnusableInput(
                f'no history can be written to {self.path}: {error}; choose another folder, or '
                'leave it out (--no-history)'
            ) from error

    def wants(self, kind: type[Record], stamp_ns: int) -> bool:
        """Return whether a record of a kind is due, so that others need not be made.

        The periods stretch while the file grows faster than BYTES_PER_HOUR.
        """
        return not self.error and stamp_ns >= self._next_ns.get(kind, stamp_ns)

    def add(self, record: Record) -> None:
        """Append a record; its place in the history is that of the latest stamp so far."""
        if self.error or self._file is None:
            return
        kind = type(record)
        self._now_ns = max(self._now_ns, record.stamp_ns)
        if not self._begin_ns:
            self._begin_ns = self._now_ns
        if kind in PERIODS_S:
            period_ns = round(PERIODS_S[kind] * NS_PER_S) * self._stretch
            self._next_ns[kind] = record.stamp_ns + period_ns
        if self._records and (
            self._now_ns - self._first_ns >= SEGMENT_NS or self._raw >= SEGMENT_BYTES
        ):
            self.flush()
        if not self._records:
            self._first_ns = self._now_ns
        data = encode(record, self._now_ns)
        self._records.append(data)
        self._raw += len(data)
        if isinstance(record, ViewRecord):
            self._views.append(
                (self._now_ns, self._segment, record.target_id, self._kind_of(record))
            )

    def flush(self) -> None:
        """Write what has been added, so that readers see it."""
        if not self._records or self._file is None or self.error:
            return
        raw = b''.join(self._records)
        for _, record in decode(raw):  # rounded, as a reader gets them
            self._state.apply(record)
        packed = self._pack(raw)
        written = len(packed)
        file = self._file
        try:
            file.execute('BEGIN')
            file.execute(
                'INSERT INTO segments VALUES (?, ?, ?, ?, ?, ?)',
                (self._segment, self._first_ns, self._now_ns, len(self._records), len(raw),
                 packed),
            )  # fmt: skip
            file.executemany(
                'INSERT INTO views (stamp_ns, segment, experience, kind) VALUES (?, ?, ?, ?)',
                self._views,
            )
            self._since_checkpoint += written
            written += self._write_checkpoint(file)
            file.execute('COMMIT')
        except sqlite3.Error as error:
            self._fail(error)
            return
        self._spent += written + 32 * len(self._views)
        self._records, self._views, self._raw = [], [], 0
        self._segment += 1
        self._adapt()

    def close(self) -> None:
        """Write everything and close the file, which is then a single one."""
        self.flush()
        file, self._file = self._file, None
        if file is None:
            return
        try:
            if not self.error:
                file.execute("INSERT INTO meta VALUES ('finished', '1')")
                file.execute('PRAGMA wal_checkpoint(TRUNCATE)')
                file.execute('PRAGMA journal_mode=DELETE')
        except sqlite3.Error as error:
            self.error = str(error)  # a reader still has it open, or the disk is full
        file.close()

    def _write_checkpoint(self, file: sqlite3.Connection) -> int:
        """Write the state after this segment if enough was written since the last one."""
        raw = encode_state(self._state) if self._checkpoint_is_due() else b''
        if not raw:
            return 0
        packed = self._pack(raw)
        self._last_checkpoint = len(packed)
        self._since_checkpoint = 0
        file.execute(
            'INSERT INTO checkpoints VALUES (?, ?, ?)', (self._segment, len(raw), packed)
        )
        return len(packed)

    _last_checkpoint = 2**14

    def _checkpoint_is_due(self) -> bool:
        return self._since_checkpoint * CHECKPOINT_SHARE >= self._last_checkpoint

    def _adapt(self) -> None:
        """Double or halve the periods, so that the size stays below the limit."""
        passed_s = (self._now_ns - self._begin_ns) / NS_PER_S
        allowed = FREE_BYTES + BYTES_PER_HOUR * passed_s / 3600.0
        if self._spent > allowed:
            self._stretch = min(2 * self._stretch, MAX_STRETCH)
        elif self._spent < 0.75 * allowed and self._stretch > 1:
            self._stretch //= 2

    def _kind_of(self, view: ViewRecord) -> int:
        if view.reason:
            return REJECTION
        if view.action == 'none' or view.target_id < 0:
            return NO_VISIT
        if view.action == 'create':
            self._newest.append(view.target_id)
            return VISIT
        is_closure = view.action == 'link' and view.target_id not in self._newest
        return CLOSURE if is_closure else VISIT

    def _fail(self, error: sqlite3.Error) -> None:
        self.error = f'the history ends here: {self.path}: {error}'
        self._records, self._views, self._raw = [], [], 0
