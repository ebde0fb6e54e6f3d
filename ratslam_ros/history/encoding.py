# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records and states as bytes: MessagePack of their declarations, compressed by zstd."""

from __future__ import annotations

from collections.abc import Hashable
from functools import cache
from math import prod
from typing import Any, TypeVar, cast

import numpy as np
from msgspec.msgpack import Decoder, Encoder
from numpy.typing import NDArray

from ratslam_ros.core.mapping.map_changes import ROUNDING, MapMirror
from ratslam_ros.history.run_state import Trail
from ratslam_ros.maps.chunks import DamagedData, decompressed

MAX_BYTES = 2**26
"""Largest accepted size of unpacked data. A map of 1,000,000 experiences is smaller. Arrays need
up to 8 times as much memory."""

_ARRAYS: dict[Any, np.dtype[Any]] = {
    NDArray[np.bool_]: np.dtype('?'), NDArray[np.uint8]: np.dtype('u1'),
    NDArray[np.int64]: np.dtype('<i8'), NDArray[np.float32]: np.dtype('<f4'),
    NDArray[np.float64]: np.dtype('<f8'),
}
"""Types of declared arrays, which are stored as their shape and planes of bytes of equal
significance: these compress better than whole numbers. Arrays of 8 bytes are stored as differences
of integers, in double precision in units of 1/``ROUNDING``: 1 mm and 1 mrad."""

_T = TypeVar('_T')


def decoded(data: bytes, kind: type[_T]) -> _T:
    """Return the value of a type of which ``encode`` has made bytes; raises DamagedData."""
    decoder: Decoder[_T] = _decoder(cast(Hashable, kind))
    try:
        return decoder.decode(data)
    except ValueError as error:
        raise DamagedData(str(error)) from None


def unpacked(data: bytes) -> bytes:
    """Return what a ``Compressor`` has compressed; raises DamagedData."""
    return decompressed(data, MAX_BYTES, is_limit=True)


@cache
def _decoder(kind: Hashable) -> Decoder[Any]:
    return Decoder(kind, dec_hook=_from_plain)


def _to_plain(value: Any) -> object:
    """Return what MessagePack has no type for: an array, a trail, or a number of NumPy."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, MapMirror):
        return None  # A change with the whole map follows a state in a history.
    if isinstance(value, Trail):
        value = value.points_m
    if value.dtype == np.object_:  # names
        return value.tolist()
    if value.dtype == np.float64:
        value = np.rint(np.clip(value * ROUNDING, -(2.0**53), 2.0**53)).astype(np.int64)
    shape = value.shape
    if value.dtype == np.int64 and value.size:
        # Neighbouring experiences, cells and points of a trail differ little.
        value = np.array(value.T, ndmin=2, order='C')
        value[:, 1:] -= value[:, :-1].copy()  # wraps on overflow, as does the sum
        size = max(int(value.max()), -1 - int(value.min()))
        value = value.astype(next(f'<i{n}' for n in (1, 2, 4, 8) if size < 2 ** (8 * n - 1)))
    return shape, value.reshape(-1, 1).view(np.uint8).T.tobytes()


encode = Encoder(enc_hook=_to_plain).encode
"""Return a view, a state or a list of records as bytes.

Raises ValueError or OverflowError for numbers that do not fit.
"""


def _from_plain(kind: Any, content: Any) -> Any:
    if kind is MapMirror:
        return MapMirror()
    if kind is Trail:
        trail = Trail()
        trail.replace(_from_plain(NDArray[np.float64], content))
        return trail
    dtype = _ARRAYS[kind]
    try:
        # The bytes bound the memory, whatever the shape claims.
        shape, data = content
        planes: NDArray[Any] = np.frombuffer(data, np.uint8)
        if dtype.kind == 'b':
            planes = planes > 0
        if dtype.itemsize < 8 or not prod(shape):
            return _of_planes(planes, dtype).reshape(shape)
        steps = _of_planes(planes, np.dtype(f'<i{len(data) // prod(shape)}'))
        sums = np.cumsum(steps.reshape(*shape[1:], shape[0]), axis=-1, dtype=np.int64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError('the shape of an array does not fit its bytes') from None
    return sums.T if dtype.kind == 'i' else sums.T / ROUNDING


def _of_planes(planes: NDArray[np.uint8], dtype: np.dtype[Any]) -> NDArray[Any]:
    values: NDArray[Any] = np.array(planes.reshape(dtype.itemsize, -1).T, order='C').view(dtype)
    return values.reshape(-1)
