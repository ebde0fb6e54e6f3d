# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recovery from damaged files: partial decompression, and rows outside broken pages."""

import bz2
import sqlite3
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import Any

import lz4.frame
import zstandard

from ratslam_ros.limits import MAX_CHUNK_BYTES, MAX_MESSAGE_BYTES

_PIECE_BYTES = 1 << 14  # Small, because everything after the last complete piece is lost.
_MAX_ROW_ID = 1 << 62
_READERS: dict[str, Callable[[bytes], Any]] = {
    'zstd': lambda data: zstandard.ZstdDecompressor().stream_reader(data),
    'lz4': lambda data: lz4.frame.LZ4FrameFile(BytesIO(data)),
    'bz2': lambda data: bz2.BZ2File(BytesIO(data)),
}


def decompress(data: bytes, compression: str, size: int = 0) -> tuple[bytes, bool]:
    """Decompress data up to the first damage, and up to the size that the file states.

    Args:
        data: the compressed bytes.
        compression: 'zstd', 'lz4', 'bz2', or 'none' or '' for data that are not compressed.
        size: length of the result according to the file; 0 if unknown.

    Returns:
        The decompressed bytes, and whether they are complete. More than ``MAX_CHUNK_BYTES`` are
        not decompressed at all.
    """
    if compression in ('', 'none'):
        return data, not size or len(data) == size
    if size > MAX_CHUNK_BYTES or compression not in _READERS:
        return b'', False
    plain, most = bytearray(), size or MAX_CHUNK_BYTES
    try:
        with _READERS[compression](data) as reader:
            while len(plain) <= most and (piece := reader.read(_PIECE_BYTES)):
                plain += piece
    except Exception:  # Each library raises its own types; the output before it is kept.
        return bytes(plain[:most]), False
    return bytes(plain[:most]), len(plain) <= most and size in (0, len(plain))


def decompress_message(data: bytes) -> bytes:
    """Decompress a message that the recorder compressed by zstd.

    Raises:
        ValueError: it has more than ``MAX_MESSAGE_BYTES``.
        zstandard.ZstdError: it is damaged.
    """
    size = zstandard.frame_content_size(data)
    plain: bytes
    if size > MAX_MESSAGE_BYTES:
        plain = b''
    elif size >= 0:
        return zstandard.decompress(data)
    else:
        plain = zstandard.ZstdDecompressor().stream_reader(data).read(MAX_MESSAGE_BYTES + 1)
        size = len(plain)
    if size > MAX_MESSAGE_BYTES:
        raise ValueError(f'it has {size} bytes or more; expected at most {MAX_MESSAGE_BYTES}')
    return plain


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
