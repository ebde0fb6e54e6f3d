# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""States as arrays in chunks: an outline in JSON, the arrays under their paths, and digests.

Nothing here can run code: the outline is JSON, arrays are numbers of known types, and every size
is checked before memory is allocated for it.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from contextlib import suppress
from itertools import chain
from types import NoneType
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from ratslam_ros.core.common.state import State
from ratslam_ros.errors import UnusableInput

CHUNK_BYTES = 8192
"""Size of a chunk before compression. A change of one value rewrites one chunk: smaller ones
write less, larger ones compress better and need fewer rows."""

LONG_LIST = 32
"""Lists of this length are stored as arrays of their own, so that a list that grows does not
shift the rest of the outline."""

COMPRESSION_LEVEL = 1
"""Level of zstd; level 3 saves 2 % of the size, and takes half as much time again."""

HASH_BYTES = 16

OUTLINE = ''
"""Name of the array with the outline."""

MAX_OUTLINE_BYTES = 2**26
MAX_STATE_BYTES = 2**32
"""Largest accepted size of the arrays of a part, 4 GB; a million experiences need less."""

MAX_ARRAYS = 2**20
MAX_DIMENSIONS = 8

_ARRAY, _LIST, _TABLE, _JSON, _NUMBER, _DICT = (
    '$array', '$list', '$table', '$json', '$number', '$dict',
)
_TYPES = {
    np.dtype(name).str: np.dtype(name)
    for name in ('?', 'i1', '<i2', '<i4', '<i8', 'u1', '<u2', '<u4', '<u8', '<f2', '<f4', '<f8')
}
_NUMBERS = {'nan': math.nan, 'inf': math.inf, '-inf': -math.inf}

Arrays = dict[str, NDArray[Any]]
Load = Callable[[str, np.dtype[Any], tuple[int, ...]], NDArray[Any]]


class DamagedData(UnusableInput):
    """The data of a map or history is damaged."""


def pack(state: State) -> Arrays:
    """Return the arrays of a state by their paths, and its outline under ''.

    Args:
        state: nested dictionaries with texts as keys, and lists, of numbers, texts and arrays.

    Raises:
        TypeError: it contains something else.
    """
    arrays: Arrays = {}
    outline = _outlined(state, '', arrays)
    arrays[OUTLINE] = _text(outline)
    return arrays


def unpack(outline: bytes, load: Load) -> State:
    """Return the state with an outline.

    Args:
        outline: content of the array ''.
        load: returns the array with a path, type and shape.

    Raises:
        DamagedData: the outline is damaged.
    """
    try:
        state = _Rebuilding(load).rebuilt(_parsed(outline), '')
    except (ValueError, TypeError, KeyError, RecursionError, OverflowError) as error:
        raise DamagedData(f'the outline of a state is damaged ({error})') from None
    if not isinstance(state, dict):
        raise DamagedData('the outline of a state is damaged')
    return state


def _text(value: Any) -> NDArray[np.uint8]:
    data = json.dumps(value, allow_nan=False, separators=(',', ':')).encode()
    return np.frombuffer(data, np.uint8)


def _parsed(text: bytes) -> Any:
    return json.loads(text, parse_constant=_refuse)


def _refuse(name: str) -> None:
    raise ValueError(f'{name} is not JSON')


def _joined(path: str, key: str) -> str:
    """Return the path of an item, a JSON pointer (RFC 6901)."""
    key = key.replace('~', '~0').replace('/', '~1')
    return f'{path}/{key}'


def _outlined(value: Any, path: str, arrays: Arrays) -> Any:
    """Return a value with each array and long list replaced by its type and shape."""
    kind = type(value)
    if value is None or kind in (bool, int, str):
        return value
    if isinstance(value, np.ndarray):
        array = np.asarray(value, value.dtype.newbyteorder('<'), order='C')
        if array.dtype.str not in _TYPES:
            raise TypeError(f'{path}: arrays of {value.dtype} cannot be saved')
        if array.nbytes:
            arrays[path] = array
        return {_ARRAY: [array.dtype.str, list(array.shape)]}
    if isinstance(value, np.generic):
        return _outlined(value.item(), path, arrays)
    if isinstance(value, float):
        return value if math.isfinite(value) else {_NUMBER: str(float(value))}
    if isinstance(value, dict):
        if not all(type(key) is str for key in value):
            raise TypeError(f'{path}: keys must be texts')
        items = {key: _outlined(item, _joined(path, key), arrays) for key, item in value.items()}
        is_marked = any(key.startswith('$') for key in items)
        return {_DICT: list(items.items())} if is_marked else items
    if isinstance(value, (list, tuple)):
        return _outlined_list(list(value), path, arrays)
    if isinstance(value, (int, str)):  # such as the members of an enumeration
        return int(value) if isinstance(value, int) else str(value)
    raise TypeError(f'{path}: {kind.__name__} cannot be saved')


def _outlined_list(values: list[Any], path: str, arrays: Arrays) -> Any:
    if len(values) >= LONG_LIST:
        kinds = set(map(type, values))
        if kinds == {float} or kinds == {int}:
            with suppress(OverflowError):  # an integer of more than 64 bits
                array = np.array(values, '<f8' if kinds == {float} else '<i8')
                arrays[path] = array
                return {_LIST: [array.dtype.str, len(values)]}
        if kinds <= {str, bool, int, NoneType}:
            arrays[path] = _text(values)
            return {_JSON: len(arrays[path])}
        if kinds <= {list, tuple} and len(set(map(len, values))) == 1 and len(values[0]):
            # A table: columns of one type are much faster to convert than rows of several.
            cells, width = list(chain.from_iterable(values)), len(values[0])
            columns = [
                _outlined_list(cells[n::width], _joined(path, str(n)), arrays)
                for n in range(width)
            ]
            return {_TABLE: columns}
    count = len(arrays)
    items = [_outlined(item, _joined(path, str(n)), arrays) for n, item in enumerate(values)]
    if len(values) < LONG_LIST or len(arrays) > count:
        return items
    array = _text(items)
    arrays[path] = array
    return {_JSON: len(array)}


class _Rebuilding:
    """Replaces the types and shapes in an outline by the arrays."""

    def __init__(self, load: Load) -> None:
        self._load = load
        self._bytes = self._arrays = 0

    def rebuilt(self, value: Any, path: str) -> Any:
        if isinstance(value, list):
            return [self.rebuilt(item, _joined(path, str(n))) for n, item in enumerate(value)]
        if not isinstance(value, dict):
            return value
        if len(value) == 1:
            ((mark, content),) = value.items()
            if mark == _ARRAY:
                name, shape = content
                return self._loaded(path, name, shape)
            if mark == _LIST:
                name, length = content
                return self._loaded(path, name, [length]).tolist()
            if mark == _TABLE:
                columns = [
                    self.rebuilt(item, _joined(path, str(n))) for n, item in enumerate(content)
                ]
                if not all(isinstance(column, list) for column in columns):
                    raise TypeError('a column is not a list')
                return list(map(list, zip(*columns, strict=True)))
            if mark == _JSON:
                text = self._loaded(path, '|u1', [content]).tobytes()
                return _Rebuilding(_no_array).rebuilt(_parsed(text), path)
            if mark == _NUMBER:
                return _NUMBERS[content]
            if mark == _DICT:
                content = dict(content)
                if all(type(key) is str for key in content):
                    return {key: self.rebuilt(v, _joined(path, key)) for key, v in content.items()}
                raise TypeError('keys must be texts')
        return {key: self.rebuilt(item, _joined(path, key)) for key, item in value.items()}

    def _loaded(self, path: str, name: str, shape: list[int]) -> NDArray[Any]:
        kind = _TYPES[name]
        if len(shape) > MAX_DIMENSIONS or not all(
            type(size) is int and 0 <= size <= MAX_STATE_BYTES for size in shape
        ):
            raise DamagedData(f'{path} has the shape {str(shape)[:100]}')
        count = math.prod(shape)
        self._bytes += count * kind.itemsize
        self._arrays += 1
        if self._bytes > MAX_STATE_BYTES or self._arrays > MAX_ARRAYS:
            raise DamagedData(
                f'a state claims {self._bytes} bytes in {self._arrays} arrays, expected at most '
                f'{MAX_STATE_BYTES} in {MAX_ARRAYS}'
            )
        if not count:
            return np.empty(shape, kind)
        return self._load(path, kind, tuple(shape)).copy()


def _no_array(path: str, kind: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    raise DamagedData(f'{path}: an array within a text')


# Chunks


def chunk_count(size: int) -> int:
    """Return the number of chunks of an array of a size in bytes."""
    return -(-size // CHUNK_BYTES)


def flat(array: NDArray[Any]) -> NDArray[np.uint8]:
    """Return a view of the bytes of a contiguous array."""
    return array.reshape(-1).view(np.uint8)


def changed(new: NDArray[Any], old: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which chunks of an array differ from those of an earlier one.

    Args:
        new: contiguous array.
        old: contiguous array.

    Returns:
        (chunks of the new array,) flags.
    """
    flags = np.ones(chunk_count(new.nbytes), np.bool_)
    if new.dtype != old.dtype:
        return flags
    if new is old:
        flags[:] = False
        return flags
    now, then = flat(new), flat(old)
    full = min(len(now), len(then)) // CHUNK_BYTES
    if full:
        words = (full, CHUNK_BYTES // 8)
        end = full * CHUNK_BYTES
        differs = now[:end].view(np.uint64) != then[:end].view(np.uint64)
        flags[:full] = differs.reshape(words).any(axis=1)
    rest = slice(full * CHUNK_BYTES, (full + 1) * CHUNK_BYTES)
    if len(flags) > full and np.array_equal(now[rest], then[rest]):
        flags[full] = False
    return flags


def chunk_hash(data: bytes | memoryview) -> bytes:
    """Return the hash of the content of a chunk."""
    return hashlib.blake2b(data, digest_size=HASH_BYTES).digest()


def array_digest(name: str, array: NDArray[Any], hashes: list[bytes]) -> bytes:
    """Return the hash of an array from the hashes of its chunks."""
    head = json.dumps([name, array.dtype.str, list(array.shape)]).encode()
    return chunk_hash(b''.join([chunk_hash(head), *hashes]))


def state_digest(digests: dict[str, bytes]) -> bytes:
    """Return the hash of a state from the digests of its arrays."""
    return chunk_hash(b''.join(digests[name] for name in sorted(digests)))


class Compressor:
    """Compresses chunks, in one thread: its tables are allocated once."""

    def __init__(self) -> None:
        self._compress = zstandard.ZstdCompressor(COMPRESSION_LEVEL, write_checksum=True).compress

    def compressed(self, data: Any, width: int = 1) -> bytes:
        """Return a chunk of numbers of ``width`` bytes, or bytes, as a zstd frame with a checksum.

        Bytes of equal significance side by side compress better than whole numbers.
        """
        if width > 1:
            data = np.ascontiguousarray(np.asarray(data).reshape(-1, width).T)
        return self._compress(memoryview(data))


def decompressed(frame: bytes, size: int, width: int = 1, is_limit: bool = False) -> bytes:
    """Return the content of a chunk.

    Args:
        frame: the zstd frame.
        size: expected size in bytes.
        width: bytes of each number, see ``Compressor``.
        is_limit: the content may be smaller.

    Raises:
        DamagedData: it is damaged, or of another size.
    """
    try:
        claimed = zstandard.frame_content_size(frame)
        if not (claimed == size or (is_limit and 0 <= claimed < size)):
            limit = 'at most ' if is_limit else ''
            raise DamagedData(f'a chunk claims {claimed} bytes, expected {limit}{size}')
        data = zstandard.ZstdDecompressor().decompress(frame, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise DamagedData(f'a chunk cannot be decompressed ({error})') from None
    if width == 1:
        return data
    return np.frombuffer(data, np.uint8).reshape(width, -1).T.tobytes()
