# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Id maps: ids of a peer node that may be restarted."""

from __future__ import annotations

from copy import deepcopy

import pytest

from ratslam_ros.core.mapping.id_map import NO_MEMORY_NS, DenseIdMap, IdMap

both_maps = pytest.mark.parametrize('kind', [IdMap, DenseIdMap])


@both_maps
def test_peer_without_restart_keeps_its_ids(kind: type[IdMap]) -> None:
    ids = kind()
    assert not ids.set_memory(NO_MEMORY_NS)
    assert not ids.set_memory(7)
    assert [ids.own_id(n) for n in (0, 1, 0, 2)] == [0, 1, 0, 2]
    assert not ids.set_memory(7)
    assert not ids.set_memory(NO_MEMORY_NS)
    assert ids.restarts == 0


@both_maps
def test_ids_of_another_memory_are_new(kind: type[IdMap]) -> None:
    ids = kind()
    ids.set_memory(7)
    assert [ids.own_id(n) for n in range(3)] == [0, 1, 2]
    assert ids.set_memory(9)
    assert [ids.own_id(n) for n in (0, 1)] == [3, 4]
    assert ids.set_memory(7)  # ids of an earlier memory are not recovered
    assert ids.own_id(0) == 5
    assert ids.restarts == 2


@both_maps
def test_restart_with_same_memory_maps_ids_anew(kind: type[IdMap]) -> None:
    ids = kind()
    ids.set_memory(7)
    assert [ids.own_id(n) for n in range(3)] == [0, 1, 2]
    ids.restart()
    assert not ids.set_memory(7)
    assert [ids.own_id(n) for n in (0, 1)] == [3, 4]
    assert ids.restarts == 1


def test_missed_ids_leave_gaps_unless_map_is_dense() -> None:
    sparse, dense = IdMap(), DenseIdMap()
    for ids in (sparse, dense):
        ids.set_memory(7)
    assert [sparse.own_id(n) for n in (57, 58, 57)] == [57, 58, 57]
    assert [dense.own_id(n) for n in (57, 58, 57)] == [0, 1, 0]
    assert 58 in dense.own_ids
    assert 1 not in dense.own_ids


def test_used_ids_are_those_up_to_the_highest() -> None:
    ids = IdMap()
    ids.set_memory(7)
    ids.own_id(4)
    assert [ids.was_used(n) for n in (0, 4, 5)] == [True, True, False]
    ids.set_memory(9)
    assert not ids.was_used(0)


def test_negative_id_is_returned_unchanged() -> None:
    assert IdMap().own_id(-1) == -1


@both_maps
def test_restored_id_map_continues_identically(kind: type[IdMap]) -> None:
    ids, copy = kind(), kind()
    for memory_ns in (7, 9):
        ids.set_memory(memory_ns)
        ids.own_id(3)
        ids.own_id(1)
    copy.restore(deepcopy(ids.state()))
    assert copy.restarts == ids.restarts == 1
    assert not copy.set_memory(9)
    assert [copy.own_id(n) for n in (3, 1, 8)] == [ids.own_id(n) for n in (3, 1, 8)]
