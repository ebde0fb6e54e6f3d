# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""With ``pc_lattice: fixed``, the activity equals that of one matrix of cells, step by step."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import DenseNetwork, extended

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.pose_cells.attractor import Network, kernel
from ratslam_ros.core.pose_cells.pose_cells import PoseCells


@pytest.mark.parametrize('dims', [(36, 12, 60), (8, 9, 25)], ids=str)
def test_activity_equals_one_matrix_of_cells(dims: tuple[int, int, int]) -> None:
    random = np.random.default_rng(sum(dims))
    network = Network(dims, kernel(7, 1.0), kernel(5, 2.0), 0.00002, is_fixed=True)
    n_theta, n_y, n_x = dims
    dense = DenseNetwork(extended('pose_cells', pc_dim_th=n_theta, pc_dim_y=n_y, pc_dim_x=n_x))
    packets = network.start()
    most = 0
    for number in range(150):
        if number % 10 == 0:
            place, energy = random.uniform(0.0, dims), random.uniform(0.05, 0.5)
            packets = network.inject(packets, *place, energy)
            dense.inject(*place, energy)
        chord, turn = random.uniform(-0.5, 2.5), random.uniform(-1.5, 1.5)
        # The reference moves each plane along its heading before the turn.
        packets = network.step(packets, chord, turn, -0.5 * turn)
        dense.step(chord, turn)
        np.testing.assert_allclose(network.dense(packets), dense.activity, atol=1e-9)
        most = max(most, len(packets))
    assert all(not packet.frame.any() for packet in packets)
    assert most > 1 or max(dims) < 60


def test_parameter_selects_the_lattice() -> None:
    fixed = PoseCells(PoseCellsParameters(pc_cell_x_size=0.25, pc_lattice='fixed'))
    moving = PoseCells(PoseCellsParameters(pc_cell_x_size=0.25))
    for _ in range(50):
        for cells in fixed, moving:
            cells.integrate(Motion(0.1, 0.004, 0.0))
    travelled_m = [abs(cells.peak.x - 150.0) * 0.25 for cells in (fixed, moving)]
    # Competition pulls slow packets of a fixed lattice back.
    assert 0.1 < travelled_m[0] < 0.16
    assert travelled_m[1] == pytest.approx(0.2, abs=0.001)
