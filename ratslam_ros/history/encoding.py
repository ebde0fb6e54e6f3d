# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records and states as bytes: MessagePack of their declarations, compressed by zstd."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cache
from typing import Annotated, Any, TypeVar, cast

import numpy as np
import zstandard
from msgspec import Meta, Raw, convert
from msgspec.msgpack import Decoder, Encoder
from numpy.typing import NDArray

from ratslam_ros.core.mapping.map_changes import ROUNDING
from ratslam_ros.errors import UnusableInput

COMPRESSION_LEVEL = 3
"""Level of zstd. Higher ones save less than 5 %, and take several times as long."""

MAX_BYTES = 2**28
"""Largest accepted size of unpacked data. A checkpoint of 1,000,000 experiences is smaller."""

_ARRAYS: dict[Any, np.dtype[Any]] = {
    NDArray[np.bool_]: np.dtype('?'), NDArray[np.uint8]: np.dtype('u1'),
    NDArray[np.int64]: np.dtype('<i8'), NDArray[np.float32]: np.dtype('<f4'),
    NDArray[np.float64]: np.dtype('<f8'),
}
"""Types of declared arrays. Those of 8 bytes are stored as differences of integers, in double
precision in units of 1/``ROUNDING``: 1 mm and 1 mrad."""

FEW_ROWS = 16
"""Number of rows up to which an array is stored as plain numbers, which is faster."""

MAX_ROWS = 2**24
"""Largest accepted number of rows of an array, which bounds the memory for its columns."""

_Size = Annotated[int, Meta(ge=0, le=MAX_ROWS)]
_Packed = tuple[Annotated[tuple[_Size, ...], Meta(min_length=1, max_length=2)], list[bytes | int]]
"""Shape of an array, and its numbers or its columns, as planes of bytes of equal significance."""

_T = TypeVar('_T')


class DamagedHistory(UnusableInput):
    """The data of a history is damaged."""


def decoded(data: bytes, kind: type[_T]) -> _T:
    """Return the value of a type of which ``encode`` has made bytes; raises DamagedHistory."""
    decoder: Decoder[_T] = _decoder(cast(Hashable, kind))
    try:
        return decoder.decode(data)
    except ValueError as error:
        raise DamagedHistory(str(error)) from None


def encode_all(encoded: list[bytes]) -> bytes:
    """Return encoded values as one encoded list."""
    return encode([Raw(data) for data in encoded])


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


@cache
def _decoder(kind: Hashable) -> Decoder[Any]:
    return Decoder(kind, dec_hook=_unpacked)


def _packed(value: Any) -> object:
    """Return what MessagePack has no type for: an array, or a number of NumPy."""
    if isinstance(value, np.generic):
        return value.item()
    if value.dtype == np.float64:
        value = np.rint(np.clip(value * ROUNDING, -(2.0**53), 2.0**53)).astype(np.int64)
    if value.dtype != np.int64:
        return value.shape, [_planes(value)]
    if len(value) <= FEW_ROWS:
        return value.shape, value.ravel().tolist()
    # Neighbouring experiences, cells and points of a trail differ little.
    table = np.array(value.T, ndmin=2, order='C')
    table[:, 1:] -= table[:, :-1].copy()  # wraps on overflow, as does the sum
    sizes = np.maximum(table.max(axis=1), -1 - table.min(axis=1)).tolist()
    return value.shape, [_planes(_narrow(*column)) for column in zip(table, sizes, strict=True)]


encode = Encoder(enc_hook=_packed).encode
"""Return a record, a state or a list of records as bytes."""


def _unpacked(kind: Any, content: Any) -> NDArray[Any]:
    dtype = _ARRAYS[kind]
    shape, columns = convert(content, _Packed)
    values: NDArray[Any]
    try:
        if dtype.itemsize < 8:
            return _of_planes(b''.join(columns), dtype).reshape(shape)
        if shape[0] > FEW_ROWS:
            columns = np.array([
                np.cumsum(_of_planes(column, f'<i{len(column) // shape[0]}'), dtype=np.int64)
                for column in columns
            ]).T
        values = np.array(columns, np.int64).reshape(shape)
    except (TypeError, ValueError, LookupError, OverflowError):
        raise ValueError(f'an array of {shape} does not fit its {len(columns)} columns') from None
    return values if dtype.kind == 'i' else values / ROUNDING


def _narrow(steps: NDArray[np.int64], size: int) -> NDArray[Any]:
    """Return integers in the fewest bytes that fit; ``size``: the largest, or -1 - smallest."""
    return steps.astype(next(f'<i{n}' for n in (1, 2, 4, 8) if size < 2 ** (8 * n - 1)))


def _planes(values: NDArray[Any]) -> bytes:
    """Bytes of equal significance side by side compress better than whole numbers."""
    return values.reshape(-1, 1).view(np.uint8).T.tobytes()


def _of_planes(data: bytes, dtype: Any) -> NDArray[Any]:
    planes = np.frombuffer(data, np.uint8).reshape(np.dtype(dtype).itemsize, -1)
    values: NDArray[Any] = np.array(planes.T, order='C').view(dtype).reshape(-1)
    return values
