# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
from ratslam_ros.core.mapping.id_map import NO_MEMORY_NS, DenseIdMap, IdMap


def test_a_neighbour_that_never_restarts_keeps_its_numbers() -> None:
    for numbering in (IdMap(), DenseIdMap()):
        assert not numbering.set_memory(NO_MEMORY_NS)
        assert not numbering.set_memory(7)
        assert [numbering.own_id(n) for n in (0, 1, 0, 2)] == [0, 1, 0, 2]
        assert not numbering.set_memory(7)
        assert not numbering.set_memory(NO_MEMORY_NS)
        assert numbering.restarts == 0


def test_ids_of_another_memory_mean_other_things() -> None:
    for numbering in (IdMap(), DenseIdMap()):
        numbering.set_memory(7)
        assert [numbering.own_id(n) for n in range(3)] == [0, 1, 2]
        assert numbering.set_memory(9)
        assert [numbering.own_id(n) for n in (0, 1)] == [3, 4]
        assert numbering.set_memory(7)  # it is never the same one again
        assert numbering.own_id(0) == 5
        assert numbering.restarts == 2


def test_ids_that_were_missed_leave_a_gap_or_none() -> None:
    sparse, dense = IdMap(), DenseIdMap()
    for numbering in (sparse, dense):
        numbering.set_memory(7)
    assert [sparse.own_id(n) for n in (57, 58, 57)] == [57, 58, 57]
    assert [dense.own_id(n) for n in (57, 58, 57)] == [0, 1, 0]
    assert dense.has(58)
    assert not dense.has(1)


def test_no_template_has_no_number() -> None:
    assert IdMap().own_id(-1) == -1
