# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One SQLite file of a rosbag2 recording, of every schema age, read and never written."""

import sqlite3
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings.salvage import readable_rows, what_was_saved
from ratslam_ros.recordings.stream import (
    Channel,
    Contents,
    Message,
    Part,
    Warnings,
    in_time_order,
)

MAGIC = b'SQLite format 3\x00'
_ROWS = 64  # rows read at once out of a damaged file


class SqliteFile:
    """The messages of one SQLite file of rosbag2.

    It is opened as immutable, so that SQLite writes no -shm or -wal file beside the recording.
    """

    def __init__(self, path: Path, warnings: Warnings, expected: int | None = None) -> None:
        self.path = path
        self._warnings = warnings
        self._expected = expected
        self._parts: list[tuple[int, int, int, int]] | None = None  # start, end, first and last id
        self._salvaged: Counter[int] = Counter()
        self._database = sqlite3.connect(
            f'file:{quote(str(path.resolve()))}?mode=ro&immutable=1', uri=True,
            check_same_thread=False,
        )
        self._database.text_factory = lambda text: text.decode(errors='replace')
        try:
            self._channels = self._read_channels()
            start, end = self._read_times()
        except sqlite3.Error as error:
            self.close()
            raise UnusableInput(
                f'{path} is an SQLite file that cannot be read ({error}): expected a rosbag2 '
                'recording; copy it again, or try "ros2 bag reindex" on its folder'
            ) from None
        except UnusableInput:
            self.close()
            raise
        self.contents = Contents(
            tuple(dict.fromkeys(self._channels.values())),
            None if self._parts is None else self._by_channel(self._salvaged),
            start, end, 'rosbag2 (sqlite3)',
        )

    @staticmethod
    def merge_log(path: Path) -> None:
        """Let SQLite merge the log beside a temporary copy into it."""
        try:
            with closing(sqlite3.connect(path)) as database:
                database.execute('PRAGMA wal_checkpoint(TRUNCATE)')
                database.execute('PRAGMA journal_mode = DELETE')
        except sqlite3.Error:
            pass  # what is damaged in it is found, and told, when it is read

    def messages(
        self, topics: Collection[str], start_ns: int, stop_ns: int
    ) -> Iterator[Message]:
        """Yield the messages of the topics with start_ns <= log_ns < stop_ns in order of time."""
        ids = [number for number, channel in self._channels.items() if channel.topic in topics]
        at, done = start_ns, 0
        if self._parts is None:
            try:
                for message in self._ordered(ids, start_ns, stop_ns):
                    at, done = message.log_ns, done + 1 if message.log_ns == at else 1
                    yield message
                return
            except sqlite3.Error:
                self._salvage()
        for message in self._saved(ids, at, stop_ns):
            if message.log_ns == at and done:
                done -= 1  # this one came before the damage was met
            else:
                yield message

    def count(self) -> dict[Channel, int]:
        """Count the messages, by a scan."""
        if self._parts is None:
            try:
                return self._by_channel(dict(self._database.execute(
                    'SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id')))
            except sqlite3.Error:
                self._salvage()
        return self._by_channel(self._salvaged)

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _by_channel(self, by_id: dict[int, int]) -> dict[Channel, int]:
        counts: Counter[Channel] = Counter()
        for number, count in by_id.items():
            if number in self._channels:
                counts[self._channels[number]] += count
        return counts

    def _read_channels(self) -> dict[int, Channel]:
        tables = "SELECT name FROM sqlite_master WHERE type = 'table'"
        try:
            names = {name for (name,) in self._database.execute(tables)}
        except sqlite3.DatabaseError:
            # A file shorter than its header says is refused, unless SQLite is told to go on.
            self._database.execute('PRAGMA writable_schema = ON')
            names = {name for (name,) in self._database.execute(tables)}
            self._salvage()
        if not {'topics', 'messages'} <= names:
            raise UnusableInput(
                f'{self.path} is an SQLite file with the tables {sorted(names) or "none"}: '
                'expected the tables topics and messages of a rosbag2 recording; give the .db3 '
                'file or the folder that "ros2 bag record" wrote'
            )
        return {
            number: Channel(str(name), str(kind), str(encoding))
            for number, name, kind, encoding in self._database.execute(
                'SELECT id, name, type, serialization_format FROM topics ORDER BY id')
        }

    def _read_times(self) -> tuple[int, int]:
        if self._parts is None:
            try:
                # Two queries, as SQLite answers each from the index, but not both at once.
                (start,), = self._database.execute('SELECT MIN(timestamp) FROM messages')
                (end,), = self._database.execute('SELECT MAX(timestamp) FROM messages')
                return (0, -1) if start is None else (int(start), int(end))
            except (sqlite3.Error, ValueError, TypeError):  # SQLite lets text stand for numbers
                self._salvage()
        parts = self._parts or []
        return min((p[0] for p in parts), default=0), max((p[1] for p in parts), default=-1)

    def _ordered(self, ids: list[int], start_ns: int, stop_ns: int) -> Iterator[Message]:
        rows = self._database.execute(
            'SELECT topic_id, timestamp, data FROM messages WHERE timestamp >= ? AND '
            f'timestamp < ? AND topic_id IN ({",".join("?" * len(ids))}) ORDER BY timestamp, id',
            (start_ns, stop_ns, *ids),
        )
        return self._as_messages(rows)

    def _saved(self, ids: list[int], start_ns: int, stop_ns: int) -> Iterator[Message]:
        """Yield what a damaged file still gives."""

        def read(first: int, last: int) -> list[Message]:
            rows = self._database.execute(
                'SELECT topic_id, timestamp, data FROM messages NOT INDEXED '
                'WHERE id BETWEEN ? AND ? ORDER BY id', (first, last)
            )
            found = [
                message for message in self._as_messages(row for row in rows if row[0] in ids)
                if start_ns <= message.log_ns < stop_ns
            ]
            found.sort(key=lambda message: message.log_ns)
            return found

        return in_time_order(
            Part(start, end, partial(read, first, last))
            for start, end, first, last in self._parts or []
            if end >= start_ns and start < stop_ns
        )

    def _as_messages(self, rows: Any) -> Iterator[Message]:
        for number, log_ns, data in rows:
            if isinstance(log_ns, int):  # SQLite lets any type stand in any column
                yield Message(log_ns, self._channels[number],
                              data if isinstance(data, bytes) else b'')

    def _salvage(self) -> None:
        """Find the rows that can still be read, once."""
        parts: list[tuple[int, int, int, int]] = []
        rows = 0
        for number, (topic, log_ns, _), gap in readable_rows(
                self._database, 'topic_id, timestamp, data'):
            if not isinstance(log_ns, int) or not isinstance(topic, int):
                continue
            self._salvaged[topic] += 1
            if gap or rows % _ROWS == 0 or not parts:
                parts.append((log_ns, log_ns, number, number))
                rows = 0
            else:
                start, end, first, _ = parts[-1]
                parts[-1] = (min(start, log_ns), max(end, log_ns), first, number)
            rows += 1
        self._parts = parts
        read = sum(self._salvaged.values())
        if read == 0:
            raise UnusableInput(
                f'{self.path} is truncated or damaged and no message in it can be read: expected '
                'a rosbag2 recording; copy it again from where it was recorded'
            )
        with self.path.open('rb') as file:
            header = file.read(100)
        page, pages = *struct.unpack_from('>H', header, 16), *struct.unpack_from('>I', header, 28)
        bytes_expected = (65536 if page == 1 else page) * pages
        size = self.path.stat().st_size
        self._warnings.add(what_was_saved(
            self.path.name,
            'is truncated' if size < bytes_expected else 'is damaged',
            read,
            self._expected or read * bytes_expected / size,
            min(part[0] for part in parts), max(part[1] for part in parts),
        ))
