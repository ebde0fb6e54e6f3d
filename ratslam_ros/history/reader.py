# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reader of a history, finished or growing."""

from __future__ import annotations

import os
import sqlite3
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import zstandard

from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.checkpoints import decode_state
from ratslam_ros.history.encoding import DamagedHistory, decode
from ratslam_ros.history.records import ImageRecord, Record, ViewRecord
from ratslam_ros.history.run_state import RunState
from ratslam_ros.history.schema import APPLICATION_ID, CLOSURE, SCHEMA_VERSION, VISIT

MAX_RAW_BYTES = 2**28
"""Largest size of an unpacked segment or checkpoint; a map of 100,000 experiences has 10 MB."""

KEPT_SEGMENTS = 16
"""Number of decoded segments that are kept."""

MAX_LISTED = 200
"""Largest number of visits or closures in a list; the latest ones."""

Segment = list[tuple[int, Record]]


class HistoryRun:
    """A run that can be shown at any moment, from its history file."""

    def __init__(
        self, path: str | Path, title: str = '',
        image_of: Callable[[int], bytes | None] = lambda stamp_ns: None,
    ) -> None:  # fmt: skip
        """Open a history.

        Args:
            path: the file; it may still grow.
            title: name of the run; '' for that of the folder.
            image_of: returns the recorded image of a stamp as JPEG, None if there is none. The
                history itself has small ones.

        Raises:
            UnusableInput: the file is no history, of another version, or damaged.
        """
        self._path = Path(path)
        self._title, self._image_of = title or self._path.resolve().parent.name, image_of
        self.notices: Sequence[str] = ()
        self._lock = threading.RLock()
        self._segments: OrderedDict[int, Segment] = OrderedDict()
        self._unpack = zstandard.ZstdDecompressor()
        self._file = self._open()
        self.meta: dict[str, str] = dict(self._rows('SELECT key, value FROM meta'))
        self._finished = False
        self._count = 0
        self._begin_ns = self._end_ns = 0
        self._refresh()

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._file.close()

    def _open(self) -> sqlite3.Connection:
        if not self._path.is_file():
            raise UnusableInput(f'{self._path} does not exist: expected the history of a run')
        try:
            uri = f'{self._path.resolve().as_uri()}?mode=ro'
            file = sqlite3.connect(uri, uri=True, check_same_thread=False)
            file.execute('PRAGMA trusted_schema=OFF')
            (kind,) = file.execute('PRAGMA application_id').fetchone()
            (version,) = file.execute('PRAGMA user_version').fetchone()
        except sqlite3.Error as error:
            raise UnusableInput(f'{self._path} cannot be read as a history: {error}') from error
        if kind != APPLICATION_ID:
            file.close()
            raise UnusableInput(f'{self._path} is not a history of ratslam_ros')
        if version != SCHEMA_VERSION:
            file.close()
            raise UnusableInput(
                f'{self._path} has version {version}; this version of ratslam_ros reads '
                f'{SCHEMA_VERSION}: replay the recording again'
            )
        return file

    # What is there

    @property
    def title(self) -> str:
        """Name of the run."""
        return self._title

    @property
    def begin_ns(self) -> int:
        """Stamp of the first record, 0 if there is none yet."""
        return self._begin_ns

    @property
    def end_ns(self) -> int:
        """Stamp of the last record that has been written, 0 if there is none yet."""
        self._refresh()
        return self._end_ns

    @property
    def is_growing(self) -> bool:
        """Whether the writer has neither finished nor died."""
        if self._finished:
            return False
        writer = int(self.meta.get('writer', '0') or 0)
        alive = _is_alive(writer)
        self._refresh()
        if not alive:
            self._finished = True
            if not self._rows("SELECT 1 FROM meta WHERE key = 'finished'"):
                self.notices = (*self.notices, 'The run ended before it was finished.')
        return not self._finished

    def _refresh(self) -> None:
        if self._finished:
            return
        finished = bool(self._rows("SELECT 1 FROM meta WHERE key = 'finished'"))
        last = self._rows('SELECT id, last_ns FROM segments ORDER BY id DESC LIMIT 1')
        if last:
            self._count, self._end_ns = last[0][0] + 1, last[0][1]
            if not self._begin_ns:
                self._begin_ns = self._rows('SELECT first_ns FROM segments WHERE id = 0')[0][0]
        self._finished = finished  # read before the segments: nothing follows it

    # The state at a stamp

    def seek(self, stamp_ns: int) -> RunState:
        """Return a new state: that of the last record whose stamp is not later."""
        found = self._rows(
            'SELECT id FROM segments WHERE first_ns <= ? ORDER BY first_ns DESC, id DESC LIMIT 1',
            stamp_ns,
        )
        state = RunState()
        if not found:
            return state
        checkpoint = self._rows(
            'SELECT segment, raw_bytes, data FROM checkpoints WHERE segment < ? '
            'ORDER BY segment DESC LIMIT 1', found[0][0],
        )  # fmt: skip
        if checkpoint:
            segment, size, data = checkpoint[0]
            state = decode_state(self._unpacked(data, size))
            state.position = segment + 1, 0
        self.advance(state, stamp_ns)
        return state

    def advance(self, state: RunState, stamp_ns: int) -> None:
        """Apply to a state all records between it and a later stamp."""
        self._refresh()
        segment, done = state.position
        while segment < self._count:
            records = self._segment(segment)
            while done < len(records):
                at_ns, record = records[done]
                if at_ns > stamp_ns:
                    state.position = segment, done
                    return
                state.apply(record)
                done += 1
            segment, done = segment + 1, 0
        state.position = segment, done

    # Single views

    def image_at(self, stamp_ns: int) -> bytes | None:
        """Return the best image of a stamp as JPEG, None if there is none near it."""
        image = self._image_of(stamp_ns)
        if image is not None:
            return image
        nearest: ImageRecord | None = None
        for segment in self._segments_at(stamp_ns):
            for _, record in self._segment(segment):
                if isinstance(record, ImageRecord) and (
                    nearest is None
                    or abs(record.stamp_ns - stamp_ns) < abs(nearest.stamp_ns - stamp_ns)
                ):
                    nearest = record
        return None if nearest is None else nearest.jpeg

    def view_at(self, stamp_ns: int) -> ViewRecord | None:
        """Return the last view whose stamp is not later."""
        found = self._views(
            'WHERE stamp_ns <= ? ORDER BY stamp_ns DESC, id DESC LIMIT 1', stamp_ns
        )
        return found[0] if found else None

    def step(self, stamp_ns: int, views: int) -> int:
        """Return the stamp of the view that is a number of views later, or earlier if negative."""
        if views == 0:
            return stamp_ns
        sign, order = ('>', 'ASC') if views > 0 else ('<', 'DESC')
        found = self._rows(
            f'SELECT DISTINCT stamp_ns FROM views WHERE stamp_ns {sign} ? '
            f'ORDER BY stamp_ns {order} LIMIT 1 OFFSET ?', stamp_ns, abs(views) - 1,
        )  # fmt: skip
        if found:
            return int(found[0][0])
        return self._end_ns if views > 0 else self._begin_ns

    def visits(self, experience_id: int, until_ns: int) -> list[ViewRecord]:
        """Return the first view of every visit of an experience up to a stamp, oldest first."""
        return self._views(
            f'WHERE experience = ? AND kind IN ({VISIT}, {CLOSURE}) AND stamp_ns <= ? '
            f'ORDER BY id DESC LIMIT {MAX_LISTED}', experience_id, until_ns,
        )[::-1]  # fmt: skip

    def closures(self, until_ns: int) -> list[ViewRecord]:
        """Return the views that closed a loop, or would have but for a reason, oldest first."""
        return self._views(
            f'WHERE kind >= {CLOSURE} AND stamp_ns <= ? ORDER BY id DESC LIMIT {MAX_LISTED}',
            until_ns,
        )[::-1]  # fmt: skip

    def _views(self, condition: str, *values: int) -> list[ViewRecord]:
        found = []
        for stamp_ns, segment in self._rows(
            f'SELECT stamp_ns, segment FROM views {condition}', *values
        ):
            found += [
                record for at_ns, record in self._segment(segment)
                if isinstance(record, ViewRecord) and at_ns == stamp_ns
            ][-1:]  # fmt: skip
        return found

    # Reading

    def _segments_at(self, stamp_ns: int) -> list[int]:
        """Return the segment of a stamp and the one before it."""
        found = self._rows(
            'SELECT id FROM segments WHERE first_ns <= ? ORDER BY first_ns DESC, id DESC LIMIT 1',
            stamp_ns,
        )
        last = found[0][0] if found else 0
        return [segment for segment in (last - 1, last) if 0 <= segment < self._count]

    def _segment(self, number: int) -> Segment:
        with self._lock:
            known = self._segments.get(number)
            if known is not None:
                self._segments.move_to_end(number)
                return known
            size, data = self._rows('SELECT raw_bytes, data FROM segments WHERE id = ?', number)[0]
            segment = list(decode(self._unpacked(data, size)))
            self._segments[number] = segment
            while len(self._segments) > KEPT_SEGMENTS:
                self._segments.popitem(last=False)
            return segment

    def _unpacked(self, data: bytes, size: int) -> bytes:
        if not 0 <= size <= MAX_RAW_BYTES:
            raise DamagedHistory(f'{self._path} is damaged: a part claims {size} bytes')
        try:
            # The size in the frame is not trusted: it is unpacked to `size` bytes at most.
            with self._unpack.stream_reader(data) as reader:
                raw = reader.read(size + 1)
        except zstandard.ZstdError as error:
            raise DamagedHistory(f'{self._path} is damaged: {error}') from error
        if len(raw) != size:
            raise DamagedHistory(f'{self._path} is damaged: a part has another size')
        return raw

    def _rows(self, query: str, *values: int) -> list[Any]:
        with self._lock:
            try:
                return self._file.execute(query, values).fetchall()
            except sqlite3.Error as error:
                raise DamagedHistory(f'{self._path} cannot be read: {error}') from error


def _is_alive(process: int) -> bool:
    if process <= 0:
        return False
    with suppress(PermissionError):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return False
    return True
