# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records and states as bytes."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from records_for_tests import plain, plain_state, random_records

from ratslam_ros.history.encoding import (
    decoded,
    encode,
    unpacked,
)
from ratslam_ros.history.records import Record
from ratslam_ros.history.run_state import RunState
from ratslam_ros.maps.chunks import Compressor, DamagedData


@given(st.integers(0, 2**32), st.integers(0, 40))
def test_records_survive_encoding(seed: int, count: int) -> None:
    records = random_records(seed, count)
    data = encode(records)
    assert [*map(plain, decoded(data, list[Record]))] == [*map(plain, records)]


@given(st.lists(st.integers(-(2**63), 2**63 - 1)), st.integers(0, 2), st.booleans())
def test_integers_of_any_size_survive_packing(
    values: list[int], width: int, has_columns: bool
) -> None:
    column = np.array(values, np.int64) >> (20 * width)
    array = np.stack([column, column[::-1]], axis=1) if has_columns else column
    assert plain(decoded(encode(array), NDArray[np.int64])) == plain(array)


@pytest.mark.parametrize('kind', [np.uint8, np.int64, np.float32, np.float64])
@pytest.mark.parametrize('count', [0, 1, 16, 17])
def test_decoded_array_can_be_changed(kind: type, count: int) -> None:
    array = np.arange(count).astype(kind)
    found = decoded(encode(array), NDArray[kind])  # type: ignore[valid-type]
    assert plain(found) == plain(array)
    found[:] = 0


@given(st.integers(0, 2**32), st.integers(0, 120))
def test_state_survives_checkpoint(seed: int, count: int) -> None:
    state = RunState()
    for record in random_records(seed, count):
        state.apply(record)
    data = encode(state)
    found = decoded(data, RunState)
    assert len(found.map) == 0  # A record with the whole map follows.
    found.map = state.map
    assert plain_state(found) == plain_state(state)
    assert encode(found) == data


@given(st.integers(0, 2**32), st.data())
def test_damaged_records_are_refused_or_harmless(seed: int, data: st.DataObject) -> None:
    state = RunState()
    for record in random_records(seed % 7, 60):
        state.apply(record)
    damaged = bytearray(encode(state))
    for _ in range(3):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    # All of these are reported as a damaged file, see test_history_file.
    with suppress(DamagedData, ValueError):
        decoded(bytes(damaged[: data.draw(st.integers(0, len(damaged)))]), RunState)
    damaged = bytearray(encode(random_records(seed % 7, 60)))
    for _ in range(3):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    with suppress(DamagedData, ValueError, IndexError, TypeError, OverflowError):
        decoded(bytes(damaged), list[Record])


def test_oversized_claim_is_refused_before_decompression() -> None:
    bomb = zstandard.ZstdCompressor().compress(bytes(2**28 + 1))
    with pytest.raises(DamagedData, match='at most'):
        unpacked(bomb)


def test_flipped_bit_is_found_by_checksum() -> None:
    data = bytearray(Compressor().compressed(np.random.default_rng(1).bytes(1000)))
    data[500] ^= 1
    with pytest.raises(DamagedData, match='cannot be decompressed'):
        unpacked(bytes(data))
