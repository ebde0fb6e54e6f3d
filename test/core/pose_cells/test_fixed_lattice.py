# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""With ``pc_lattice: fixed``, the activity equals that of one matrix of cells, step by step."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import convolve1d, shift

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.pose_cells.attractor import Network, kernel
from ratslam_ros.core.pose_cells.pose_cells import PoseCells

EXCITATION, INHIBITION, CUTOFF = kernel(7, 1.0), kernel(5, 2.0), 0.00002


def convolved(matrix: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    for axis in range(3):
        matrix = convolve1d(matrix, weights, axis, mode='wrap')
    return matrix


def stepped(
    matrix: NDArray[np.float64], chord: float, turn: float, course: float
) -> NDArray[np.float64]:
    """Excite, inhibit, normalise, shift each plane along its heading, and shift the headings."""
    excited = convolved(matrix, EXCITATION)
    matrix = np.maximum(excited - convolved(excited, INHIBITION) - CUTOFF, 0.0)
    headings = (np.arange(len(matrix)) + 0.5 * turn + course) * 2.0 * math.pi / len(matrix)
    planes = [
        shift(plane, (chord * math.sin(a), chord * math.cos(a)), order=1, mode='grid-wrap')
        for plane, a in zip(matrix / matrix.sum(), headings, strict=True)
    ]
    return shift(np.array(planes), (turn, 0.0, 0.0), order=1, mode='grid-wrap')


@pytest.mark.parametrize('dims', [(36, 40, 60), (36, 12, 40), (8, 9, 25)], ids=str)
def test_activity_equals_one_matrix_of_cells(dims: tuple[int, int, int]) -> None:
    random = np.random.default_rng(sum(dims))
    network = Network(dims, EXCITATION, INHIBITION, CUTOFF, is_fixed=True)
    packets = network.start()
    matrix = network.dense(packets)
    most = 0
    for number in range(150):
        if number % 10 == 0:
            cell = [int(i) for i in random.integers(dims)]
            energy = random.uniform(0.05, 0.5)
            packets = network.inject(packets, *cell, energy, interpolate=False)
            matrix[tuple(cell)] += energy
        motion = random.uniform(-0.5, 2.5), random.uniform(-1.5, 1.5), random.choice([0.0, 9.0])
        packets = network.step(packets, *motion)
        matrix = stepped(matrix, *motion)
        np.testing.assert_allclose(network.dense(packets), matrix, atol=1e-9)
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
