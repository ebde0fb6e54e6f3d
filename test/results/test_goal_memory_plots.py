# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plot of the goal memory: reproducible files, and routes across edges and jumps."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers import original

from ratslam_ros.core.goal_memory.goal_memory import GoalMemory
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnusableInput
from ratslam_ros.results.goal_memory_plots import _route, _split_at_edges, draw_temporal_array

VERMILLION_BGR = (0x00, 0x5E, 0xD5)


@pytest.fixture
def memory() -> GoalMemory:
    """Learn a route along a row, across the edge of the torus and on in another row."""
    config = original().with_values({'pose_cells.pc_dim_x': 30, 'pose_cells.pc_dim_y': 20})
    learned = GoalMemory(config.pose_cells)
    for x in range(20, 36):
        learned.learn(1.0, np.array([5 * 30 + x % 30]), np.ones(1))
    for x in range(10, 20):
        learned.learn(1.0, np.array([15 * 30 + x]), np.ones(1))
    return learned


def test_route_leads_from_robot_to_goal(memory: GoalMemory) -> None:
    times = memory.recall(Place(19.0, 15.0, 0.0))
    route = _route(times, Place(20.3, 5.2, 0.0))
    assert route[0].tolist() == [20.0, 5.0]
    assert route[-1].tolist() == [19.0, 15.0]
    assert len(route) == 26
    gaps = np.flatnonzero(np.isnan(_split_at_edges(route, 30, 20)[:, 0]))
    assert gaps.tolist() == [10]  # between columns 29 and 0


def test_same_memory_gives_identical_file(memory: GoalMemory, tmp_path: Path) -> None:
    times, peak = memory.recall(Place(19.0, 15.0, 0.0)), Place(20.3, 5.2, 0.0)
    driven = np.array([[20.0, 5.0], [25.0, 5.0], [29.0, 5.0], [2.0, 5.0]])
    files = [
        draw_temporal_array(times, peak, tmp_path / name, driven) for name in ('a.png', 'b.png')
    ]
    assert files[0].read_bytes() == files[1].read_bytes()
    image = cv2.imread(str(files[0])).astype(int)
    assert (np.abs(image - VERMILLION_BGR).sum(axis=2) < 30).sum() > 300
    with pytest.raises(UnusableInput, match='cannot be written'):
        draw_temporal_array(times, peak, tmp_path / 'none' / 'a.png')
