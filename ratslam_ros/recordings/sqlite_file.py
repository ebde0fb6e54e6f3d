# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read-only reader of one SQLite file of a rosbag2 recording, of any schema version."""

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
from ratslam_ros.limits import MAX_MESSAGE_BYTES, check_tables, guard_database
from ratslam_ros.recordings.salvage import readable_rows, recovery_message
from ratslam_ros.recordings.stream import (
    Channel,
    Contents,
    Message,
    Part,
    Warnings,
    merge_by_time,
)

SQLITE_MAGIC = b'SQLite format 3\x00'
_BLOCK_ROW_COUNT = 64  # Rows read at once if the index on the timestamps cannot be used.
_CHECK_STEP_COUNT = 1_000_000  # Steps of SQLite's virtual machine between checks for loops.


@dataclass(slots=True)
class _Block:
    """Consecutive rows of the messages table: time range, id of the first row and row count."""

    start_ns: int
    end_ns: int
    first_id: int
    rows: int = 0


class SqliteFile:
    """The messages of one SQLite file of rosbag2.

    The file is opened as immutable, so that SQLite creates no -shm or -wal file beside it.
    """

    def __init__(self, path: Path, warnings: Warnings, expected: int | None = None) -> None:
        """Open the file, and scan it if it has no usable index.

        Args:
            path: the file.
            warnings: receives messages for the user.
            expected: number of messages according to the metadata; None if unknown.

        Raises:
            UnusableInput: the file is not a rosbag2 recording, or no message can be read.
        """
        self.path = path
        self._warnings = warnings
        self._expected = expected
        self._size = path.stat().st_size
        self._idle_checks = 0
        self._blocks: list[_Block] | None = None  # Set if the index is unusable.
        self._counts: Counter[int] | None = None
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
        read = self._by_index if self._blocks is None else self._by_blocks
        last_ns, yielded_count = start_ns, 0
        try:
            for message in read(ids, start_ns, stop_ns):
                yielded_count = yielded_count + 1 if message.log_ns == last_ns else 1
                last_ns = message.log_ns
                yield message
            return
        except sqlite3.Error as error:
            if self._is_salvaged:  # Readable before, so the disk fails.
                self._warnings.add(f'{self.path.name} cannot be read any further: {error}')
                return
            self._salvage()
        for message in self._by_blocks(ids, last_ns, stop_ns):
            if message.log_ns == last_ns and yielded_count:
                yielded_count -= 1  # Already yielded before the damage.
            else:
                yield message

    def count(self) -> dict[Channel, int]:
        """Return the number of messages of each channel; scan the file on the first call."""
        if self._counts is None:
            _, self._counts, whole = self._find_rows('topic_id, timestamp')
            if not whole:
                self._salvage()
        return self._by_channel(self._counts)

    def close(self) -> None:
        """Close the file."""
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
            # SQLite rejects a file shorter than its header says, unless this is set.
            self._database.execute('PRAGMA writable_schema = ON')
            names = {name for (name,) in self._query(tables)}
            self._salvage()
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
        if self._blocks is None:
            try:
                if not self._has_index():
                    self._blocks, self._counts, whole = self._find_rows('topic_id, timestamp')
                    if not whole:
                        self._salvage()
                else:
                    # SQLite uses the index for MIN or MAX alone, but not for both in one query.
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

    def _by_blocks(self, ids: list[int], start_ns: int, stop_ns: int) -> Iterator[Message]:
        def read(block: _Block) -> list[Message]:
            # Without LIMIT, SQLite would also read the row after the block, which may be broken.
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

        return merge_by_time(
            Part(block.start_ns, block.end_ns, partial(read, block))
            for block in self._blocks or []
            if block.end_ns >= start_ns and block.start_ns < stop_ns
        )

    def _find_rows(self, columns: str) -> tuple[list[_Block], Counter[int], bool]:
        """Return readable rows as blocks without gaps, counts by topic id, and completeness."""
        blocks: list[_Block] = []
        counts: Counter[int] = Counter()
        block, whole = None, True
        for row in readable_rows(self._database, columns):
            self._idle_checks = 0
            if row is None:
                block, whole = None, False
                continue
            row_id, topic, log_ns = row[:3]
            if not isinstance(log_ns, int) or not isinstance(topic, int):
                block, whole = None, False  # SQLite does not enforce column types.
                continue
            counts[topic] += 1
            if block is None or block.rows == _BLOCK_ROW_COUNT:
                block = _Block(log_ns, log_ns, row_id)
                blocks.append(block)
            block.rows += 1
            block.start_ns, block.end_ns = min(block.start_ns, log_ns), max(block.end_ns, log_ns)
        return blocks, counts, whole

    def _salvage(self) -> None:
        """Find the readable rows of a damaged file and warn the user how many were read."""
        self._is_salvaged = True
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
            recovery_message(
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
