# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recovery from damaged files: partial decompression, and rows outside broken pages."""

import bz2
import sqlite3
from collections.abc import Iterator
from typing import Any

import lz4.frame
import zstandard

from ratslam_ros.limits import MAX_CHUNK_BYTES, MAX_MESSAGE_BYTES

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
_PIECE_BYTES = 1 << 14  # Small, because everything after the last complete piece is lost.
_MAX_ROW_ID = 1 << 62


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
    if size > MAX_CHUNK_BYTES:
        return b'', False
    most = size or MAX_CHUNK_BYTES
    try:
        if compression == 'zstd':
            if zstandard.frame_content_size(data) <= most:  # It is -1 if unknown.
                return zstandard.decompress(data, max_output_size=size), True
        elif compression in ('lz4', 'bz2'):
            decompressor = _decompressor(compression)
            plain = decompressor.decompress(data, max_length=most)
            if not decompressor.eof:  # The end mark may follow the last byte.
                decompressor.decompress(b'', max_length=1)
            if decompressor.eof:
                return plain, True
        else:
            return b'', False
    except Exception:  # Each of the three libraries raises its own types.
        pass
    return _decompress_pieces(data, compression, most), False


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


def _decompressor(compression: str) -> Any:
    return bz2.BZ2Decompressor() if compression == 'bz2' else lz4.frame.LZ4FrameDecompressor()


def _decompress_pieces(data: bytes, compression: str, most: int) -> bytes:
    """Return the bytes before the first damage, at most ``most``."""
    plain = bytearray()
    try:
        if compression == 'zstd':
            reader = zstandard.ZstdDecompressor().stream_reader(data)
            while piece := reader.read(min(_PIECE_BYTES, most - len(plain))):
                plain += piece
        else:
            stream = _decompressor(compression)
            for begin in range(0, len(data), _PIECE_BYTES):
                if stream.eof or len(plain) == most:
                    break
                piece = data[begin : begin + _PIECE_BYTES]
                plain += stream.decompress(piece, max_length=most - len(plain))
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
