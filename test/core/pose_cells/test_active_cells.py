# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Active cells, packets and injections as arrays."""

from __future__ import annotations

import numpy as np
from helpers import extended

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.pose_cells.active_cells import active_cells
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.vision.local_view import ViewMatch


def seen(number: int) -> ViewMatch:
    return ViewMatch(number, False, 0.1, 0.0)


def lap(rounds: int) -> PoseCells:
    """Drive in a circle, with a view at every step, across the borders of the torus."""
    cells = PoseCells(extended('pose_cells', pc_dim_x=12, pc_dim_y=12, pc_vt_agree_views=0.0))
    for step in range(rounds):
        cells.integrate(Motion(0.5, 0.13, 0.21))
        cells.view(seen(step % 30))
    return cells


def test_active_cells_equal_the_dense_activity() -> None:
    cells = lap(50)
    active = active_cells(cells)
    dense = np.zeros_like(cells.activity())
    dense[tuple(active.cells[:, ::-1].T)] = active.activity
    np.testing.assert_allclose(dense, cells.activity(), atol=1e-12)
    assert (active.activity > 0.0).all()
    assert len(np.unique(active.cells, axis=0)) == len(active.cells)


def test_packets_sum_to_the_activity_strongest_first() -> None:
    cells = lap(34)
    packets = active_cells(cells).packets
    assert np.isclose(packets[:, 3].sum(), cells.activity().sum())
    assert (np.diff(packets[:, 3]) <= 0.0).all()
    assert np.allclose(packets[0, :3], cells.peak, atol=2.0)


def test_injections_are_those_of_the_last_view() -> None:
    cells = lap(40)  # the views of the first round are recognised
    ((x, y, theta, energy),) = active_cells(cells).injections
    assert 0.0 <= x < 12 and 0.0 <= y < 12 and 0.0 <= theta < 36
    assert energy > 0.0
    cells.integrate(Motion(0.5, 0.13, 0.21))
    assert len(active_cells(cells).injections) == 1
    cells.view(seen(1000))
    assert active_cells(cells).injections.shape == (0, 4)
