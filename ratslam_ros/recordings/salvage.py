# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recovery from damaged files: partial decompression, and rows outside broken pages."""

import bz2
import sqlite3
from collections.abc import Iterator
from typing import Any

import lz4.frame
import zstandard

_PIECE_BYTES = 1 << 14  # Small, because everything after the last complete piece is lost.
_MAX_ROW_ID = 1 << 62


def recovery_message(
    name: str, state: str, read: int, expected: float | None, first_ns: int, last_ns: int
) -> str:
    """Format a warning that states how much of a damaged file was read.

    Args:
        name: name of the file.
        state: the damage, as a predicate such as 'is truncated'.
        read: number of messages read.
        expected: estimated number of messages before the damage; None if unknown.
        first_ns: log time of the first message read.
        last_ns: log time of the last message read.
    """
    about = f' of about {expected:.0f}' if expected and expected > read else ''
    return f'{name} {state}: read {read}{about} messages, up to {(last_ns - first_ns) / 1e9:.1f} s'


def decompress(data: bytes, compression: str, size: int = 0) -> tuple[bytes, bool]:
    """Decompress data up to the first damage.

    Args:
        data: the compressed bytes.
        compression: 'zstd', 'lz4', 'bz2', or 'none' or '' for data that are not compressed.
        size: length of the result according to the file; 0 if unknown.

    Returns:
        The decompressed bytes, and whether they are complete.
    """
    if compression in ('', 'none'):
        return data, not size or len(data) == size
    try:
        if compression == 'zstd':
            return zstandard.decompress(data, max_output_size=size), True
        if compression == 'lz4':
            return lz4.frame.decompress(data), True
        if compression == 'bz2':
            return bz2.decompress(data), True
    except Exception:  # Each of the three libraries raises its own types.
        return _decompress_pieces(data, compression), False
    return b'', False


def _decompress_pieces(data: bytes, compression: str) -> bytes:
    stream: Any = {
        'zstd': lambda: zstandard.ZstdDecompressor().decompressobj(),
        'lz4': lz4.frame.LZ4FrameDecompressor,
        'bz2': bz2.BZ2Decompressor,
    }[compression]()
    plain = bytearray()
    try:
        for begin in range(0, len(data), _PIECE_BYTES):
            plain += stream.decompress(data[begin : begin + _PIECE_BYTES])
    except Exception:  # The output before the damage is kept.
        pass
    return bytes(plain)


def readable_rows(database: sqlite3.Connection, columns: str) -> Iterator[tuple[Any, ...] | None]:
    """Yield (id, *columns) of each readable row of the messages table, and None at each gap.

    The indices are not used because they may be damaged too. The ids always increase: pages that
    point back to earlier rows, which would cause an endless loop, count as damaged.
    """
    query = f'SELECT id, {columns} FROM messages NOT INDEXED WHERE id >= ? ORDER BY id'
    next_id: int | None = 0
    while next_id is not None:
        try:
            for row in database.execute(query, (next_id,)):
                if row[0] < next_id:
                    raise sqlite3.DatabaseError
                yield row
                next_id = row[0] + 1
            return
        except (sqlite3.Error, OverflowError):
            yield None
            next_id = _next_readable(database, query, next_id)


def _next_readable(database: sqlite3.Connection, query: str, broken: int) -> int | None:
    """Return the first id after a broken row from which reading succeeds, by bisection."""

    def is_readable(row_id: int) -> bool:
        try:
            found = database.execute(f'{query} LIMIT 1', (row_id,)).fetchone()
        except sqlite3.Error:
            return False
        return found is None or found[0] >= row_id  # None: row_id is past the last row.

    low, high = broken, broken + 1
    while not is_readable(high):
        low, high = high, broken + 2 * (high - broken)
        if high > _MAX_ROW_ID:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if is_readable(middle) else (middle, high)
    return high
