# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records as bytes: a short JSON object with the scalars, followed by the arrays.

Arrays are stored by columns, which compress better than rows, in the smallest type that keeps what
can be seen: positions to 1 mm, angles to 1 mrad. Decoding checks every size before it allocates.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.map_changes import ExperienceRows, LinkRows, MapChange
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.records import (
    CellsRecord,
    ImageRecord,
    MatchRecord,
    PoseRecord,
    Record,
    RouteRecord,
    ScanRecord,
    StatusRecord,
    ViewRecord,
)

MAX_HEAD_BYTES = 2**24
"""Largest JSON object of a record; the behaviours of 20,000 links take 0.5 MB."""

_HEADER = struct.Struct('<BqII')
"""Kind, stamp of the history in ns, bytes of the JSON object, bytes of the arrays."""


@dataclass(frozen=True, slots=True)
class Column:
    """How an array is stored: its type, and the type in memory; ``digits`` it is rounded to."""

    stored: str
    used: str
    digits: int | None = None

    def pack(self, values: NDArray[Any]) -> bytes:
        """Return the bytes of an array, column after column."""
        if self.digits is not None:
            values = np.round(values, self.digits)
        return np.ascontiguousarray(values.T).astype(self.stored).tobytes()

    def unpack(self, data: bytes, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return the array that ``pack`` has stored."""
        flat = np.frombuffer(data, self.stored)
        return np.ascontiguousarray(flat.reshape(shape[::-1]).T).astype(self.used)


_IDS = Column('<i4', 'i8')
_METRES = Column('<f4', 'f8', 3)
_SHARES = Column('<f4', 'f8', 4)
_FLAGS = Column('u1', '?')
_BYTES = Column('u1', 'u1')
_CELLS = Column('<u2', 'i8')
_ACTIVITY = Column('<f4', 'f8')

_COLUMNS: dict[type, dict[str, Column]] = {
    ExperienceRows: {
        'ids': _IDS, 'template_ids': _IDS, 'poses': _METRES, 'components': _IDS,
    },
    LinkRows: {
        'ends': _IDS, 'shapes': _METRES, 'durations_s': _METRES, 'confidences': _SHARES,
        'counts': _IDS, 'recognised': _FLAGS,
    },
    MapChange: {'removed_links': _IDS},
    CellsRecord: {
        'cells': _CELLS, 'activity': _ACTIVITY, 'packets': _SHARES, 'injections': _SHARES,
    },
    MatchRecord: {'view': _BYTES, 'template': _BYTES},
    ScanRecord: {'points_m': Column('<f4', 'f8', 2)},
    RouteRecord: {'points_m': _METRES},
}  # fmt: skip
"""How the arrays of every type are stored; all other fields are in the JSON object."""

_NESTED: dict[str, type] = {'experiences': ExperienceRows, 'links': LinkRows}
_TUPLES: dict[str, Callable[..., Any]] = {
    'pose': Pose, 'dead_reckoning': Pose, 'truth': Pose, 'place': Place,
}  # fmt: skip
_KINDS: tuple[type, ...] = (
    MapChange, ViewRecord, PoseRecord, CellsRecord, ImageRecord, MatchRecord, ScanRecord,
    RouteRecord, StatusRecord,
)  # fmt: skip
_NUMBERS = {kind: number for number, kind in enumerate(_KINDS)}


class DamagedHistory(UnusableInput):
    """Error: bytes that no history of this version contains."""


def encode(record: Record, stamp_ns: int) -> bytes:
    """Return a record as bytes, with its stamp in the history."""
    arrays: list[bytes] = []
    head = json.dumps(_plain(record, arrays), separators=(',', ':')).encode()
    data = b''.join(arrays)
    return _HEADER.pack(_NUMBERS[type(record)], stamp_ns, len(head), len(data)) + head + data


def decode(data: bytes) -> Iterator[tuple[int, Record]]:
    """Yield the stamp in the history and the record of everything that was encoded.

    Raises:
        DamagedHistory: the bytes are no sequence of records.
    """
    at = 0
    try:
        while at < len(data):
            number, stamp_ns, head_size, size = _HEADER.unpack_from(data, at)
            start = at + _HEADER.size
            at = start + head_size + size
            if at > len(data) or head_size > MAX_HEAD_BYTES or number >= len(_KINDS):
                raise DamagedHistory(f'a record of kind {number} claims {head_size + size} bytes')
            head = json.loads(data[start : start + head_size])
            arrays = _Arrays(data, start + head_size, at)
            yield stamp_ns, _restored(_KINDS[number], head, arrays)
    except (struct.error, ValueError, TypeError, KeyError) as error:
        raise DamagedHistory(f'a record is damaged: {error}') from error


class _Arrays:
    """Reader of the arrays of one record, one after the other."""

    def __init__(self, data: bytes, start: int, end: int) -> None:
        self._data, self._at, self._end = data, start, end

    def take(self, size: int) -> bytes:
        """Return the next bytes."""
        start, self._at = self._at, self._at + size
        if size < 0 or self._at > self._end:
            raise DamagedHistory(f'an array claims {size} bytes')
        return self._data[start : self._at]


def _plain(item: Any, arrays: list[bytes]) -> dict[str, Any]:
    """Return the JSON object of a dataclass, and append its arrays."""
    columns = _COLUMNS.get(type(item), {})
    plain: dict[str, Any] = {}
    for field in fields(item):
        value = getattr(item, field.name)
        if field.name in columns:
            plain[field.name] = list(value.shape)
            arrays.append(columns[field.name].pack(value))
        elif field.name in _NESTED:
            plain[field.name] = _plain(value, arrays)
        elif isinstance(value, bytes):
            plain[field.name] = len(value)
            arrays.append(value)
        elif isinstance(value, float):
            plain[field.name] = round(value, 6)
        elif field.name in _TUPLES and value is not None:
            plain[field.name] = [round(number, 4) for number in value]
        else:
            plain[field.name] = value
    return plain


def _restored(kind: type, plain: dict[str, Any], arrays: _Arrays) -> Any:
    """Return the dataclass of a JSON object and its arrays."""
    columns = _COLUMNS.get(kind, {})
    values: dict[str, Any] = {}
    for field in fields(kind):
        value = plain[field.name]
        if field.name in columns:
            shape = tuple(int(size) for size in value)
            column = columns[field.name]
            size = np.dtype(column.stored).itemsize
            for length in shape:
                size *= length
            value = column.unpack(arrays.take(size), shape)
        elif field.name in _NESTED:
            value = _restored(_NESTED[field.name], value, arrays)
        elif field.name == 'jpeg':
            value = arrays.take(value)
        elif field.name in _TUPLES and value is not None:
            value = _TUPLES[field.name](*value)
        elif isinstance(value, list):
            value = tuple(value)
        values[field.name] = value
    return kind(**values)
