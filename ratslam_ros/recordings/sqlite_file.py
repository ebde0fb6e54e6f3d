# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read-only reader of one SQLite file of a rosbag2 recording, of any schema version."""

import sqlite3
import struct
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ratslam_ros.errors import UnusableInput
from ratslam_ros.limits import MAX_MESSAGE_BYTES, check_tables, guard_database, schema_of
from ratslam_ros.recordings.salvage import readable_rows
from ratslam_ros.recordings.stored_file import Span, StoredFile
from ratslam_ros.recordings.stream import Channel, Message, Warnings

SQLITE_MAGIC = b'SQLite format 3\x00'
_SPAN_ROW_COUNT = 64  # Rows read at once if the index on the timestamps cannot be used.
_CHECK_STEP_COUNT = 1_000_000  # Steps of SQLite's virtual machine between checks for loops.


class SqliteFile(StoredFile):
    """The messages of one SQLite file of rosbag2.

    The file is opened as immutable, so that SQLite creates no -shm or -wal file beside it. Its
    spans are rows without gaps, and only found if the index on the timestamps cannot be used.
    """

    KIND = 'rosbag2 (sqlite3)'
    UNREADABLE = (
        'is truncated or damaged and no message in it can be read: expected a rosbag2 recording'
    )

    def __init__(self, path: Path, warnings: Warnings, expected: int | None = None) -> None:
        """Open the file, and scan it if it has no usable index.

        Args:
            path: the file.
            warnings: receives messages for the user.
            expected: number of messages according to the metadata; None if unknown.

        Raises:
            UnusableInput: the file is not a rosbag2 recording, or no message can be read.
        """
        super().__init__(path, warnings, expected)
        self._idle_checks = 0
        self._has_spans = False
        self._is_salvaged = False
        self._database = sqlite3.connect(
            f'file:{quote(str(path.resolve()))}?mode=ro&immutable=1',
            uri=True,
            check_same_thread=False,
        )
        self._database.set_progress_handler(self._exceeds_step_limit, _CHECK_STEP_COUNT)
        try:
            guard_database(self._database, MAX_MESSAGE_BYTES)
            self._channels = self._read_channels()
            self.start_ns, self.end_ns = self._read_times()
        except (sqlite3.Error, ValueError, TypeError) as error:
            self.close()
            raise UnusableInput(
                f'{path} is an SQLite file that cannot be read ({error}): expected a rosbag2 '
                'recording; copy it again, or try "ros2 bag reindex" on its folder'
            ) from None
        except UnusableInput:
            self.close()
            raise

    @staticmethod
    def merge_log(path: Path) -> None:
        """Merge the write-ahead log beside a temporary copy of a file into that copy."""
        try:
            with closing(sqlite3.connect(path)) as database:
                database.execute('PRAGMA wal_checkpoint(TRUNCATE)')
                database.execute('PRAGMA journal_mode = DELETE')
        except sqlite3.Error:
            pass  # Reading the file reports the damage.

    def messages(self, topics: Collection[str], start_ns: int, stop_ns: int) -> Iterator[Message]:
        """Yield messages of the topics with start_ns <= log_ns < stop_ns in time order."""
        ids = [number for number, channel in self._channels.items() if channel.topic in topics]
        by_spans = super().messages
        last_ns, yielded_count = start_ns, 0
        try:
            for message in (
                by_spans(topics, start_ns, stop_ns) if self._has_spans
                else self._by_index(ids, start_ns, stop_ns)
            ):
                yielded_count = yielded_count + 1 if message.log_ns == last_ns else 1
                last_ns = message.log_ns
                yield message
            return
        except sqlite3.Error as error:
            if self._is_salvaged:  # Readable before, so the disk fails.
                self._warnings.add(f'{self.path.name} cannot be read any further: {error}')
                return
            self._salvage()
        for message in by_spans(topics, last_ns, stop_ns):
            if message.log_ns == last_ns and yielded_count:
                yielded_count -= 1  # Already yielded before the damage.
            else:
                yield message

    def _count_all(self) -> Counter[int]:
        if not self._find_rows('topic_id, timestamp'):
            self._salvage()
        return self._scanned()

    def close(self) -> None:
        """Close the file."""
        super().close()
        self._database.close()

    def _exceeds_step_limit(self) -> bool:
        """Return whether to stop a query that takes more steps than the file size can explain.

        Damaged pages can link to each other in a loop.
        """
        self._idle_checks += 1
        return self._idle_checks * _CHECK_STEP_COUNT > 4 * self._size + 100 * _CHECK_STEP_COUNT

    def _query(self, query: str, values: Iterable[Any] = ()) -> Iterator[Any]:
        for row in self._database.execute(query, tuple(values)):
            self._idle_checks = 0
            yield row

    def _read_channels(self) -> dict[int, Channel]:
        try:
            names = {name for kind, name, *_ in schema_of(self._database) if kind == 'table'}
        except sqlite3.DatabaseError:
            # SQLite rejects a file shorter than its header says, unless this is set.
            self._database.execute('PRAGMA writable_schema = ON')
            names = {name for kind, name, *_ in schema_of(self._database) if kind == 'table'}
            self._salvage()
        if {'chunks', 'cuts', 'sessions'} <= names:
            raise UnusableInput(
                f'{self.path} is a map: expected a recording; "ratslam map info" prints what the '
                'map contains, and "ratslam replay RECORDING --map FILE" continues it'
            )
        if not {'topics', 'messages'} <= names:
            raise UnusableInput(
                f'{self.path} is an SQLite file with the tables {sorted(map(str, names))}: '
                'expected the tables topics and messages of a rosbag2 recording; give the .db3 '
                'file or the folder that "ros2 bag record" wrote'
            )
        check_tables(self._database, self.path, ('topics', 'messages'))
        return {
            int(number): Channel(str(name), str(kind), str(encoding))
            for number, name, kind, encoding in self._query(
                'SELECT id, name, type, serialization_format FROM topics ORDER BY id'
            )
        }

    def _read_times(self) -> tuple[int, int]:
        if not self._has_spans:
            try:
                if self._has_index():
                    # SQLite uses the index for MIN or MAX alone, but not for both in one query.
                    ((start,),) = self._query('SELECT MIN(timestamp) FROM messages')
                    ((end,),) = self._query('SELECT MAX(timestamp) FROM messages')
                    return (0, -1) if start is None else (int(start), int(end))
                if not self._use_rows('topic_id, timestamp'):
                    self._salvage()
            except (sqlite3.Error, ValueError, TypeError):
                self._salvage()
        return self._times()

    def _has_index(self) -> bool:
        """Return whether an index allows reading the messages in time order without sorting."""
        return any(
            [column for _, _, column in self._query(f'PRAGMA index_info("{name}")')][:1]
            == ['timestamp']
            for _, name, *_ in list(self._query('PRAGMA index_list(messages)'))
        )

    def _by_index(self, ids: list[int], start_ns: int, stop_ns: int) -> Iterator[Message]:
        previous = (start_ns, 0)
        for number, log_ns, data, row_id in self._query(
            'SELECT topic_id, timestamp, data, id FROM messages WHERE timestamp >= ? AND '
            f'timestamp < ? AND topic_id IN ({",".join("?" * len(ids))}) ORDER BY timestamp, id',
            (start_ns, stop_ns, *ids),
        ):
            if (log_ns, row_id) < previous:
                raise sqlite3.DatabaseError('the index is not in time order')
            previous = (log_ns, row_id)
            yield Message(log_ns, self._channels[number], _as_bytes(data))

    def _messages_in(self, span: Span) -> Iterator[tuple[int, int, bytes]]:
        # Without LIMIT, SQLite would also read the row after the span, which may be broken.
        for number, log_ns, data in self._query(
            'SELECT topic_id, timestamp, data FROM messages NOT INDEXED '
            'WHERE id >= ? ORDER BY id LIMIT ?',
            (span.offset, span.length),
        ):
            if number in self._channels and isinstance(log_ns, int):
                yield log_ns, number, _as_bytes(data)

    def _find_rows(self, columns: str) -> bool:
        """Find the readable rows as spans without gaps; return whether these are all."""
        self._spans = []
        span, whole = None, True
        for row in readable_rows(self._database, columns):
            self._idle_checks = 0
            if row is None:
                span, whole = None, False
                continue
            row_id, topic, log_ns = row[:3]
            if not isinstance(log_ns, int) or not isinstance(topic, int):
                span, whole = None, False  # SQLite does not enforce column types.
                continue
            if span is None or span.length == _SPAN_ROW_COUNT:
                span = Span(row_id, 0, log_ns, log_ns)
                self._spans.append(span)
            span.counts[topic] += 1
            span.length += 1
            span.start_ns, span.end_ns = min(span.start_ns, log_ns), max(span.end_ns, log_ns)
        return whole

    def _use_rows(self, columns: str) -> bool:
        """Read by rows and not by the index from now on; return whether all are readable."""
        self._has_spans = True
        whole = self._find_rows(columns)
        self._counts = self._scanned()
        return whole

    def _salvage(self) -> None:
        """Find the readable rows of a damaged file and warn the user how many were read."""
        self._is_salvaged = True
        self._use_rows('topic_id, timestamp, data')
        read = self._scanned().total()
        self._file.seek(0)
        header = self._file.read(100)
        page, pages = *struct.unpack_from('>H', header, 16), *struct.unpack_from('>I', header, 28)
        whole = (65536 if page == 1 else page) * pages
        is_truncated = self._size < whole
        self._warn_of_recovery(
            'is truncated' if is_truncated else 'is damaged',
            self._expected or (read * whole / self._size if is_truncated else None),
        )


def _as_bytes(data: Any) -> bytes:
    return data if isinstance(data, bytes) else b''
