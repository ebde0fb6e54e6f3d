# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""States as arrays in chunks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays, scalar_dtypes
from map_states import same
from state_digest import digest_of

from ratslam_ros.maps.chunks import (
    CHUNK_BYTES,
    LONG_LIST,
    OUTLINE,
    Compressor,
    DamagedData,
    changed,
    decompressed,
    flat,
    pack,
    unpack,
)

TYPES = st.sampled_from(['?', 'i1', '<i2', '<i4', '<i8', 'u1', '<u4', '<f2', '<f4', '<f8'])
LEAVES = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
    | arrays(TYPES, array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4))
)
KEYS = st.text(max_size=4) | st.sampled_from(['$array', '$dict', 'a/b', '~', '0'])
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=4)
    | st.lists(st.integers(), min_size=LONG_LIST, max_size=40)
    | st.lists(st.floats(), min_size=LONG_LIST, max_size=40)
    | st.lists(LEAVES, min_size=1, max_size=2).map(lambda items: items * LONG_LIST),
    max_leaves=12,
)
STATES = st.dictionaries(KEYS, VALUES, max_size=5)


def restored(state: dict[str, Any]) -> dict[str, Any]:
    stored = pack(state)
    used = {OUTLINE}

    def load(name: str, kind: np.dtype[Any], shape: tuple[int, ...]) -> Any:
        used.add(name)
        return np.frombuffer(stored[name].tobytes(), kind).reshape(shape)

    found = unpack(stored[OUTLINE].tobytes(), load)
    assert used == stored.keys()
    return found


@settings(max_examples=60)
@given(STATES)
@example({'a': {'b/c': np.zeros(3)}, 'a/b': {'c': np.ones(3)}})
@example({'a': [0.0, float('nan'), -0.0] * LONG_LIST, 'b': [2**70] * LONG_LIST})
@example({'a': [[1, 2.0, 'b', None]] * LONG_LIST, 'b': [[]] * LONG_LIST, 'c': [(1,)] * 99})
@example({'a': [[[1, 2], [3.0, 4]]] * LONG_LIST, 'b': [[{'c': np.zeros(2)}, 1]] * LONG_LIST})
@example({'a': [True] * LONG_LIST, 'b': [1, 2.0] * LONG_LIST})
def test_states_survive_packing(state: dict[str, Any]) -> None:
    assert same(restored(state), state)
    assert digest_of(restored(state)) == digest_of(state)


def test_types_of_numpy_and_orders_of_memory_are_normalised() -> None:
    values = np.arange(12.0).reshape(3, 4)
    state = {'a': np.asfortranarray(values), 'b': values.astype('>f8'), 'c': np.float64(1.5)}
    found = restored(state)
    assert same(found, {'a': values, 'b': values, 'c': 1.5})
    assert digest_of(found) == digest_of(state)


@pytest.mark.parametrize(
    'value', [object(), b'bytes', {1: 2}, {1, 2}, np.array(['text']), np.array([object()]), 1j]
)
def test_other_types_are_refused(value: Any) -> None:
    with pytest.raises(TypeError):
        pack({'a': value})


def test_digest_depends_on_every_value_and_type() -> None:
    states: list[dict[str, Any]] = [
        {}, {'a': 1}, {'a': 1.0}, {'a': True}, {'b': 1}, {'a': [1]}, {'a': np.array([1])},
        {'a': np.array([1], np.int32)}, {'a': np.array([[1]])}, {'a': np.zeros(2 * CHUNK_BYTES)},
        {'a': np.eye(1, 2 * CHUNK_BYTES)[0]}, {'a': [1] * LONG_LIST}, {'a': [1.0] * LONG_LIST},
    ]
    assert len({digest_of(state) for state in states}) == len(states)


@given(
    st.integers(0, 5 * CHUNK_BYTES), st.integers(0, 5 * CHUNK_BYTES),
    st.lists(st.integers(0, 5 * CHUNK_BYTES), max_size=4),
)
def test_changed_chunks_are_those_with_other_bytes(new: int, old: int, at: list[int]) -> None:
    then = np.zeros(old, np.uint8)
    now = np.zeros(new, np.uint8)
    now[[position for position in at if position < new]] = 1
    expected = [
        now[start : start + CHUNK_BYTES].tobytes() != then[start : start + CHUNK_BYTES].tobytes()
        for start in range(0, new, CHUNK_BYTES)
    ]
    assert changed(now, then).tolist() == expected


@given(arrays(scalar_dtypes(), st.integers(1, 500)))
def test_chunks_survive_compression(values: np.ndarray) -> None:
    if values.dtype.kind not in 'biuf' or values.dtype.itemsize > 8:
        values = np.arange(len(values), dtype=np.int16)
    data = flat(values)
    frame = Compressor().compressed(data, values.dtype.itemsize)
    assert decompressed(frame, len(data), values.dtype.itemsize) == data.tobytes()


def test_chunk_of_other_size_is_refused_before_unpacking() -> None:
    bomb = Compressor().compressed(np.zeros(2**24, np.uint8), 1)
    assert len(bomb) < 2000
    with pytest.raises(DamagedData, match='claims 16777216 bytes, expected 8192'):
        decompressed(bomb, CHUNK_BYTES, 1)


@pytest.mark.parametrize('outline', [
    b'', b'[1]', b'{', b'\xff', b'{"a":{"$array":["|O",[1]]}}', b'{"a":{"$array":["<f8",[-1]]}}',
    b'{"a":{"$array":["<f8",[1e3]]}}', b'{"a":{"$array":["<f8",[99999999,99999999]]}}',
    b'{"a":{"$array":["<f8"]}}', b'{"a":{"$number":"one"}}', b'{"a":{"$dict":3}}',
    b'{"a":{"$array":["<f8",[1,1,1,1,1,1,1,1,1]]}}', b'{"a":' + b'[' * 100_000,
    b'{"a":{"$list":["<f8",[1]]}}', b'{"a":NaN}', b'{"a":' + b'1' * 5000 + b'}',
    b'{"a":{"$table":[[1],[1,2]]}}', b'{"a":{"$table":[1]}}',
    b'{"a":{"$dict":[[1,2]]}}', b'{"a":{"$dict":[[["x"],2]]}}', b'{"a":{"$array":[[],[1]]}}',
])
def test_damaged_outlines_are_refused(outline: bytes) -> None:
    with pytest.raises(DamagedData):
        unpack(outline, lambda name, kind, shape: np.zeros(shape, kind))
