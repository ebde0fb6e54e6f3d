# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One SQLite file of a rosbag2 recording, of every schema age, read and never written."""

import sqlite3
import struct
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
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

SQLITE_MAGIC = b'SQLite format 3\x00'
_ROWS = 64  # rows read at once where the index on the times cannot be used
_STEPS = 1_000_000  # of SQLite's machine, between two looks at whether it goes round in circles


@dataclass(slots=True)
class _Block:
    """A run of rows: what times it holds, the id of its first row, and how many there are."""

    start_ns: int
    end_ns: int
    first_id: int
    rows: int = 0


class SqliteFile:
    """The messages of one SQLite file of rosbag2.

    It is opened as immutable, so that SQLite writes no -shm or -wal file beside the recording.
    """

    def __init__(self, path: Path, warnings: Warnings, expected: int | None = None) -> None:
        self.path = path
        self._warnings = warnings
        self._expected = expected
        self._size = path.stat().st_size
        self._idle = 0
        self._blocks: list[_Block] | None = None  # where the index is missing or damaged
        self._counts: Counter[int] | None = None
        self._salvaged = False
        self._database = sqlite3.connect(
            f'file:{quote(str(path.resolve()))}?mode=ro&immutable=1',
            uri=True,
            check_same_thread=False,
        )
        self._database.text_factory = lambda text: text.decode(errors='replace')
        self._database.set_progress_handler(self._is_going_in_circles, _STEPS)
        try:
            self._channels = self._read_channels()
            start, end = self._read_times()
        except (sqlite3.Error, ValueError, TypeError) as error:
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
            None if self._counts is None else self._by_channel(self._counts),
            start,
            end,
            'rosbag2 (sqlite3)',
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

    def messages(self, topics: Collection[str], start_ns: int, stop_ns: int) -> Iterator[Message]:
        """Yield the messages of the topics with start_ns <= log_ns < stop_ns in order of time."""
        ids = [number for number, channel in self._channels.items() if channel.topic in topics]
        read = self._by_index if self._blocks is None else self._by_blocks
        at, done = start_ns, 0
        try:
            for message in read(ids, start_ns, stop_ns):
                done = done + 1 if message.log_ns == at else 1
                at = message.log_ns
                yield message
            return
        except sqlite3.Error as error:
            if self._salvaged:  # all of it could be read before: the disk, not the file
                self._warnings.add(f'{self.path.name} cannot be read on: {error}')
                return
            self._salvage()
        for message in self._by_blocks(ids, at, stop_ns):
            if message.log_ns == at and done:
                done -= 1  # this one came before the damage was met
            else:
                yield message

    def count(self) -> dict[Channel, int]:
        """Count the messages, by a scan."""
        if self._counts is None:
            _, self._counts, whole = self._find_rows('topic_id, timestamp')
            if not whole:
                self._salvage()
        return self._by_channel(self._counts)

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _is_going_in_circles(self) -> bool:
        """Stop a query that has run for longer than any file of this size could take."""
        self._idle += 1
        return self._idle * _STEPS > 4 * self._size + 100 * _STEPS

    def _query(self, query: str, values: Iterable[Any] = ()) -> Iterator[Any]:
        for row in self._database.execute(query, tuple(values)):
            self._idle = 0
            yield row

    def _by_channel(self, by_id: dict[int, int]) -> dict[Channel, int]:
        counts: Counter[Channel] = Counter()
        for number, count in by_id.items():
            if number in self._channels:
                counts[self._channels[number]] += count
        return counts

    def _read_channels(self) -> dict[int, Channel]:
        tables = "SELECT name FROM sqlite_master WHERE type = 'table'"
        try:
            names = {name for (name,) in self._query(tables)}
        except sqlite3.DatabaseError:
            # A file shorter than its header says is refused, unless SQLite is told to go on.
            self._database.execute('PRAGMA writable_schema = ON')
            names = {name for (name,) in self._query(tables)}
            self._salvage()
        if not {'topics', 'messages'} <= names:
            raise UnusableInput(
                f'{self.path} is an SQLite file with the tables {sorted(map(str, names))}: '
                'expected the tables topics and messages of a rosbag2 recording; give the .db3 '
                'file or the folder that "ros2 bag record" wrote'
            )
        return {
            int(number): Channel(str(name), str(kind), str(encoding))
            for number, name, kind, encoding in self._query(
                'SELECT id, name, type, serialization_format FROM topics ORDER BY id'
            )
        }

    def _read_times(self) -> tuple[int, int]:
        if self._blocks is None:
            try:
                if not self._has_index():
                    self._blocks, self._counts, whole = self._find_rows('topic_id, timestamp')
                    if not whole:
                        self._salvage()
                else:
                    # Two queries, as SQLite answers each by the index, but not both at once.
                    ((start,),) = self._query('SELECT MIN(timestamp) FROM messages')
                    ((end,),) = self._query('SELECT MAX(timestamp) FROM messages')
                    return (0, -1) if start is None else (int(start), int(end))
            except (sqlite3.Error, ValueError, TypeError):
                self._salvage()
        blocks = self._blocks or []
        return (
            min((block.start_ns for block in blocks), default=0),
            max((block.end_ns for block in blocks), default=-1),
        )

    def _has_index(self) -> bool:
        """Look whether the messages can be had in order of time without sorting them all."""
        return any(
            [column for _, _, column in self._query(f'PRAGMA index_info("{name}")')][:1]
            == ['timestamp']
            for _, name, *_ in list(self._query('PRAGMA index_list(messages)'))
        )

    def _by_index(self, ids: list[int], start_ns: int, stop_ns: int) -> Iterator[Message]:
        before = (start_ns, 0)
        for number, log_ns, data, row_id in self._query(
            'SELECT topic_id, timestamp, data, id FROM messages WHERE timestamp >= ? AND '
            f'timestamp < ? AND topic_id IN ({",".join("?" * len(ids))}) ORDER BY timestamp, id',
            (start_ns, stop_ns, *ids),
        ):
            if (log_ns, row_id) < before:
                raise sqlite3.DatabaseError('the index leads back')
            before = (log_ns, row_id)
            yield Message(log_ns, self._channels[number], _as_bytes(data))

    def _by_blocks(self, ids: list[int], start_ns: int, stop_ns: int) -> Iterator[Message]:
        def read(block: _Block) -> list[Message]:
            # LIMIT, as SQLite would look at the row after the last one otherwise: a broken one.
            rows = self._query(
                'SELECT topic_id, timestamp, data FROM messages NOT INDEXED '
                'WHERE id >= ? ORDER BY id LIMIT ?',
                (block.first_id, block.rows),
            )
            found = [
                Message(log_ns, self._channels[number], _as_bytes(data))
                for number, log_ns, data in rows
                if number in ids and isinstance(log_ns, int) and start_ns <= log_ns < stop_ns
            ]
            found.sort(key=lambda message: message.log_ns)
            return found

        return in_time_order(
            Part(block.start_ns, block.end_ns, partial(read, block))
            for block in self._blocks or []
            if block.end_ns >= start_ns and block.start_ns < stop_ns
        )

    def _find_rows(self, columns: str) -> tuple[list[_Block], Counter[int], bool]:
        """Find the rows that can be read, as blocks without gaps; count them; are they all."""
        blocks: list[_Block] = []
        counts: Counter[int] = Counter()
        block, whole = None, True
        for row in readable_rows(self._database, columns):
            self._idle = 0
            if row is None:
                block, whole = None, False
                continue
            row_id, topic, log_ns = row[:3]
            if not isinstance(log_ns, int) or not isinstance(topic, int):
                block, whole = None, False  # SQLite lets any type stand in any column
                continue
            counts[topic] += 1
            if block is None or block.rows == _ROWS:
                block = _Block(log_ns, log_ns, row_id)
                blocks.append(block)
            block.rows += 1
            block.start_ns, block.end_ns = min(block.start_ns, log_ns), max(block.end_ns, log_ns)
        return blocks, counts, whole

    def _salvage(self) -> None:
        """Find what can still be read of a damaged file, and say how much that is."""
        self._salvaged = True
        self._blocks, self._counts, _ = self._find_rows('topic_id, timestamp, data')
        read = sum(self._counts.values())
        if read == 0:
            raise UnusableInput(
                f'{self.path} is truncated or damaged and no message in it can be read: expected '
                'a rosbag2 recording; copy it again from where it was recorded'
            )
        with self.path.open('rb') as file:
            header = file.read(100)
        page, pages = *struct.unpack_from('>H', header, 16), *struct.unpack_from('>I', header, 28)
        whole = (65536 if page == 1 else page) * pages
        self._warnings.add(
            what_was_saved(
                self.path.name,
                'is truncated' if self._size < whole else 'is damaged',
                read,
                self._expected or (read * whole / self._size if self._size < whole else None),
                min(block.start_ns for block in self._blocks),
                max(block.end_ns for block in self._blocks),
            )
        )


def _as_bytes(data: Any) -> bytes:
    return data if isinstance(data, bytes) else b''
