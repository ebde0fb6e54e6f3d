# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Packing of numbers, arrays and texts to bytes, and checked unpacking.

The bytes contain no types and no code. Every length is compared with the bytes that are left
before memory is allocated for it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
import zstandard
from numpy.typing import NDArray

from ratslam_ros.errors import UnusableInput

ROUNDING = 1000.0
"""Lengths and angles are stored in units of 1/1000: 1 mm and 1 mrad."""

COMPRESSION_LEVEL = 3
"""Level of zstd. Higher ones save less than 5 %, and take several times as long."""

MAX_BYTES = 2**28
"""Largest accepted size of unpacked data. A checkpoint of 1,000,000 experiences is smaller."""

_TYPES = {1: '<i1', 2: '<i2', 4: '<i4', 8: '<i8'}
_COLUMN = struct.Struct('<BI')
_EMPTY_COLUMN = _COLUMN.pack(1, 0)
_LENGTH = struct.Struct('<I')


class DamagedHistory(UnusableInput):
    """The data of a history is damaged."""


def pack_bytes(data: bytes) -> bytes:
    """Return the bytes with their length in front."""
    return _LENGTH.pack(len(data)) + data


def pack_text(text: str) -> bytes:
    """Return a text as UTF-8 with its length in front."""
    return pack_bytes(text.encode())


def pack_ints(*columns: NDArray[np.int64]) -> bytes:
    """Pack columns of equal length as differences of successive integers, in few bytes.

    Neighbouring experiences, cells and points of a trail differ little, so that their differences
    are short and compress well.
    """
    table = np.stack(columns)
    count = table.shape[1]
    if not count:
        return _EMPTY_COLUMN * len(columns)
    table[:, 1:] -= table[:, :-1].copy()  # wraps on overflow, as does the sum
    sizes = np.maximum(table.max(axis=1), -1 - table.min(axis=1)).tolist()
    packed: list[bytes] = []
    for steps, size in zip(table, sizes, strict=True):
        width = next((width for width in _TYPES if size < 2 ** (8 * width - 1)), 8)
        narrow = steps.astype(_TYPES[width])
        # Bytes of equal significance side by side compress better than whole numbers.
        planes = narrow.view(np.uint8).reshape(count, width).T
        packed += _COLUMN.pack(width, count), planes.tobytes()
    return b''.join(packed)


def pack_rounded(*columns: NDArray[np.float64]) -> bytes:
    """Pack columns of equal length, with numbers rounded to 1/1000."""
    return pack_ints(*rounded(np.stack(columns)))


def rounded(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return finite numbers as integers in units of 1/1000, clipped to 2**53."""
    return np.rint(np.clip(values * ROUNDING, -(2.0**53), 2.0**53)).astype(np.int64)


def pack_floats(values: NDArray[np.float64]) -> bytes:
    """Pack (n,) numbers in single precision."""
    return pack_bytes(values.astype('<f4').view(np.uint8).reshape(-1, 4).T.tobytes())


class Unpacker:
    """Reads packed data from the start to the end."""

    def __init__(self, data: bytes | memoryview) -> None:
        self._data = memoryview(data)
        self._at = 0

    @property
    def is_at_end(self) -> bool:
        """Whether all data has been read."""
        return self._at == len(self._data)

    def raw(self, length: int) -> memoryview:
        """Return the next bytes; raises DamagedHistory if there are fewer."""
        end = self._at + length
        if length < 0 or end > len(self._data):
            raise DamagedHistory(
                f'the data ends after {len(self._data)} bytes, expected at least {end}'
            )
        data = self._data[self._at : end]
        self._at = end
        return data

    def fields(self, layout: struct.Struct) -> tuple[float, ...]:
        """Return the numbers of a struct."""
        return layout.unpack(self.raw(layout.size))

    def bytes(self) -> bytes:
        """Return what ``pack_bytes`` has packed."""
        (length,) = _LENGTH.unpack(self.raw(_LENGTH.size))
        return self.raw(length).tobytes()

    def text(self) -> str:
        """Return what ``pack_text`` has packed."""
        try:
            return self.bytes().decode()
        except UnicodeDecodeError:
            raise DamagedHistory('a text is not UTF-8') from None

    def ints(self, length: int | None = None) -> NDArray[np.int64]:
        """Return what ``pack_ints`` has packed; ``length``: the expected number, if known."""
        width, count = _COLUMN.unpack(self.raw(_COLUMN.size))
        if width not in _TYPES or (length is not None and count != length):
            raise DamagedHistory(
                f'a column has {count} numbers of {width} bytes, expected {length}'
            )
        planes = np.frombuffer(self.raw(width * count), np.uint8).reshape(width, count)
        steps = np.ascontiguousarray(planes.T).view(_TYPES[width]).reshape(count)
        return np.cumsum(steps, dtype=np.int64)

    def rounded(self, length: int | None = None) -> NDArray[np.float64]:
        """Return what ``pack_rounded`` has packed."""
        return self.ints(length) / ROUNDING

    def floats(self, length: int | None = None) -> NDArray[np.float64]:
        """Return what ``pack_floats`` has packed."""
        data = np.frombuffer(self.bytes(), np.uint8)
        if len(data) % 4 or (length is not None and len(data) != 4 * length):
            raise DamagedHistory(f'a column has {len(data)} bytes, expected 4 for each number')
        planes = np.ascontiguousarray(data.reshape(4, -1).T)
        return planes.view('<f4').reshape(-1).astype(np.float64)


def compressor() -> Callable[[bytes], bytes]:
    """Return a function that returns data as a zstd frame with its size and a checksum.

    Its tables are allocated once. It must not be called by two threads at once.
    """
    return zstandard.ZstdCompressor(COMPRESSION_LEVEL, write_checksum=True).compress


def decompressed(data: bytes) -> bytes:
    """Return the data of a zstd frame; raises DamagedHistory."""
    try:
        size = zstandard.frame_content_size(data)
        if not 0 <= size <= MAX_BYTES:
            raise DamagedHistory(
                f'the data claims {size} bytes, expected at most {MAX_BYTES}'
            )
        return zstandard.ZstdDecompressor().decompress(data)
    except zstandard.ZstdError as error:
        raise DamagedHistory(f'the data cannot be decompressed ({error})') from None
