# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is left in damaged files: partly decompressed chunks, and rows around broken pages."""

import bz2
import sqlite3
from collections.abc import Iterator
from typing import Any

import lz4.frame
import zstandard

_PIECE = 1 << 14  # bytes; small, as all that follows the last whole piece is lost
_LAST_ROW = 1 << 62


def what_was_saved(
    name: str, state: str, read: int, expected: float | None, first_ns: int, last_ns: int
) -> str:
    """Say how much of a damaged file was saved; ``expected`` is about how many messages it had."""
    about = f' of about {expected:.0f}' if expected and expected > read else ''
    return f'{name} {state}: read {read}{about} messages, up to {(last_ns - first_ns) / 1e9:.1f} s'


def decompress(data: bytes, compression: str, size: int = 0) -> tuple[bytes, bool]:
    """Return the plain bytes, as many as can be had, and whether they are all there.

    ``size`` is what the file says about the length of the result, where it says anything.
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
    except Exception:  # three libraries, each with errors of its own; a piece by piece try follows
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
        for begin in range(0, len(data), _PIECE):
            plain += stream.decompress(data[begin : begin + _PIECE])
    except Exception:  # what came out before the damage is what can be saved
        pass
    return bytes(plain)


def readable_rows(database: sqlite3.Connection, columns: str) -> Iterator[tuple[Any, ...] | None]:
    """Yield (id, *columns) of the messages that can be read, and None where some are lost.

    Reads the table itself, as the indices may be gone, and steps over what is broken. The ids
    increase, whatever the pages say: damaged ones may lead back to where they were reached from.
    """
    query = f'SELECT id, {columns} FROM messages NOT INDEXED WHERE id >= ? ORDER BY id'
    following: int | None = 0
    while following is not None:
        try:
            for row in database.execute(query, (following,)):
                if row[0] < following:
                    raise sqlite3.DatabaseError
                yield row
                following = row[0] + 1
            return
        except (sqlite3.Error, OverflowError):
            yield None
            following = _next_readable(database, query, following)


def _next_readable(database: sqlite3.Connection, query: str, broken: int) -> int | None:
    """Return the first id after a broken one from where reading works again, by bisection."""

    def works(row_id: int) -> bool:
        try:
            found = database.execute(f'{query} LIMIT 1', (row_id,)).fetchone()
        except sqlite3.Error:
            return False
        return found is None or found[0] >= row_id  # past the last row there is nothing to fail

    low, high = broken, broken + 1
    while not works(high):
        low, high = high, broken + 2 * (high - broken)
        if high > _LAST_ROW:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if works(middle) else (middle, high)
    return high
