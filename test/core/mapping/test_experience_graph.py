# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Experience graph: experiences, neighbours and links."""

from __future__ import annotations

import pytest
from graphs import arrive, drive, go, new_map, pose_is_near
from helpers import ahead

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.graph import NotLinked
from ratslam_ros.core.pose_cells.torus import Place


def test_storage_grows_beyond_initial_capacity() -> None:
    graph = new_map(exp_loops=0)
    for target in range(300):
        arrive(graph, target)
        drive(graph, ahead(1.0))
    assert len(graph) == len(graph.experiences()) == 300
    assert graph.link_count == len(graph.links()) == 299
    assert pose_is_near(graph.pose_of(299), 299.0, 0.0, 0.0, 1e-9)
    assert graph.experiences()[123].template_id == 133
    assert graph.experiences()[123].place == Place(123.0, 0.0, 0.0)


def test_poses_are_returned_as_a_copy() -> None:
    graph = new_map()
    for target in range(5):
        arrive(graph, target)
        drive(graph, ahead(1.0))
    graph.poses[:] = 99.0
    assert graph.pose_of(0) == Pose(0.0, 0.0, 0.0)


def test_neighbours_are_linked_in_either_direction() -> None:
    graph = new_map()
    for target in (*range(22), 0):
        arrive(graph, target)
        drive(graph, ahead(1.0))
    assert graph.neighbours(4) == [3, 5]
    assert graph.neighbours(0) == [1, 21]
    with pytest.raises(NotLinked, match='no experience 22; expected 0 to 21'):
        graph.neighbours(22)


def test_behaviour_against_link_direction_is_mirrored() -> None:
    graph = new_map()
    for target, behaviour in enumerate(['', 'left_wall', 'right_wall', 'centreline']):
        go(graph, target, ahead(1.0), behaviour=behaviour)
    assert [graph.behaviour_between(n, n + 1) for n in range(3)] == [
        'left_wall', 'right_wall', 'centreline'
    ]
    assert [graph.behaviour_between(n + 1, n) for n in range(3)] == [
        'right_wall', 'left_wall', ''
    ]
    assert graph.behaviour_between(0, 3) == ''
