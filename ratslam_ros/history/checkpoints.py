# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The whole state of a run as bytes: a moment can be shown without reading everything before."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.history.encoding import DamagedHistory, decode, encode
from ratslam_ros.history.records import Record
from ratslam_ros.history.run_state import RunState, Trail

_SIZE = struct.Struct('<I')


def encode_state(state: RunState) -> bytes:
    """Return a state as bytes."""
    records = b''.join(encode(record, record.stamp_ns) for record in _records(state))
    arrays = list(_arrays(state))
    head = json.dumps(
        {
            'stamp_ns': state.stamp_ns, 'records': len(records),
            'arrays': [[str(array.dtype), list(array.shape)] for array in arrays],
        }
    ).encode()  # fmt: skip
    return b''.join([_SIZE.pack(len(head)), head, records, *(a.tobytes() for a in arrays)])


def decode_state(data: bytes) -> RunState:
    """Return the state that ``encode_state`` has stored.

    Raises:
        DamagedHistory: the bytes are no state.
    """
    try:
        (size,) = _SIZE.unpack_from(data)
        at = _SIZE.size + size
        head = json.loads(data[_SIZE.size : at])
        state = RunState()
        for _, record in decode(data[at : at + head['records']]):
            state.apply(record)
        at += head['records']
        arrays = []
        for kind, shape in head['arrays']:
            if kind not in ('int64', 'float64', 'float32'):
                raise DamagedHistory(f'an array of {kind}')
            count = int(np.prod(shape, dtype=np.int64))
            arrays.append(np.frombuffer(data, kind, count, at).reshape(shape).copy())
            at += arrays[-1].nbytes
        _set_arrays(state, arrays)
        state.stamp_ns = int(head['stamp_ns'])
    except (struct.error, ValueError, TypeError, KeyError) as error:
        raise DamagedHistory(f'a checkpoint is damaged: {error}') from error
    return state


def _records(state: RunState) -> Iterator[Record]:
    """Yield records that restore everything but visits and trails."""
    yield state.map.complete(state.stamp_ns)
    yield from state.recent
    for record in (
        state.pose, state.cells, state.image, state.match, state.scan, state.route, state.status
    ):  # fmt: skip
        if record is not None:
            yield record


def _arrays(state: RunState) -> Iterator[NDArray[np.int64 | np.float64 | np.float32]]:
    visits = state.visits
    yield from (visits.created_ns, visits.visited_ns, visits.counts, visits.errors)
    for trail in _trails(state):
        yield trail.points_m


def _set_arrays(state: RunState, arrays: list[NDArray[np.float64]]) -> None:
    visits = state.visits
    created_ns, visited_ns, counts, errors, *points = arrays
    visits.created_ns, visits.visited_ns = created_ns.astype(np.int64), visited_ns.astype(np.int64)
    visits.counts, visits.errors = counts.astype(np.int64), errors.astype(np.float64)
    for trail, points_m in zip(_trails(state), points, strict=True):
        trail.restore(points_m)


def _trails(state: RunState) -> tuple[Trail, Trail, Trail]:
    return state.trail, state.dead_reckoning, state.truth
