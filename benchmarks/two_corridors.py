# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot in one of two similar corridors finds out in which, without a unique landmark.

Milford et al. (2005), section II.D: ambiguous visual input supports "any number of robot pose
hypotheses, which converge to a single hypothesis without ever seeing a unique landmark". Here
odometry and numbers of views drive pose cells along two corridors behind each other around the
torus. Each view is found in both. After six laps the robot is carried into one of them.

    python benchmarks/two_corridors.py [--config milford2005] [--energy E]
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from typing import NamedTuple

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.torus import Torus
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.files.config import load_config

CORRIDORS = (0, 1, 2, 0, 2, 1), (0, 2, 1, 0, 1, 2)
"""The views along two corridors. No view is unique: each is found twice in either."""

SPACING_CELLS, GAP_CELLS = 6, 15
"""From a view to the next one, and from a corridor to the other one."""

LENGTH_CELLS = 5 * SPACING_CELLS + GAP_CELLS

LAPS_COUNT = 6

ASTRAY_CELLS = 20
"""Length of each leg that the odometry adds while the robot is carried: along y, then along x."""

RIGHT_CELLS = 2.0
"""Distance from its true place within which the robot is found: that of the experience zones."""

STEPS_PER_CELL = 1
"""Iterations per cell. With 4, the hypotheses of a view have faded before the next one is seen:
here a view is seen once, and not at each iteration."""


class Hypotheses(NamedTuple):
    """Result of a run: at each view, the number of packets, and the error at the next view."""

    packets: tuple[int, ...]
    errors_cells: tuple[float, ...]

    @property
    def views_count(self) -> int:
        """Number of views after which the robot stays within ``RIGHT_CELLS``; 0 if it does not."""
        wrong = [n for n, error in enumerate(self.errors_cells, 1) if error >= RIGHT_CELLS]
        last = wrong[-1] if wrong else 0
        return last + 1 if last < len(self.errors_cells) else 0


def two_corridors_run(parameters: PoseCellsParameters, corridor: int) -> Hypotheses:
    """Drive along both corridors, carry the robot, and drive along one of them.

    Args:
        parameters: those of the pose cells; their torus has ``2 * LENGTH_CELLS`` cells along x.
        corridor: the one into which the robot is carried.
    """
    cells = PoseCells(parameters)
    cell_m = parameters.pc_cell_x_size
    start, torus = cells.peak, Torus(*cells.dims)

    def drive(distance_cells: int) -> None:
        for _ in range(distance_cells * STEPS_PER_CELL):
            cells.integrate(Motion(0.1, cell_m / STEPS_PER_CELL, 0.0))

    def see(view: int) -> None:
        cells.view(ViewMatch(view, False, 0.0, 0.0))

    for number in LAPS_COUNT * (0, 1):
        for at, view in enumerate(CORRIDORS[number]):
            see(view)
            drive(SPACING_CELLS if at < 5 else GAP_CELLS)
    for turn_rad in 0.5 * math.pi, -0.5 * math.pi:
        cells.integrate(Motion(0.1, 0.0, turn_rad))
        drive(ASTRAY_CELLS)
    packets, errors = [], []
    for at, view in enumerate(CORRIDORS[corridor]):
        see(view)
        packets.append(len(cells.packets()))
        drive(SPACING_CELLS)
        true_x = start.x - corridor * LENGTH_CELLS - (at + 1) * SPACING_CELLS
        errors.append(torus.distance(cells.peak, start._replace(x=true_x)))
    return Hypotheses(tuple(packets), tuple(errors))


def parameters_of(preset: str) -> PoseCellsParameters:
    """Return the pose cells of a preset, on a torus that both corridors fill along x."""
    return load_config(preset)[0].with_values({
        'pose_cells.pc_dim_x': 2 * LENGTH_CELLS, 'pose_cells.pc_dim_y': 80,
    }).pose_cells


def main() -> None:
    """Print the hypotheses in each corridor."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').partition('\n')[0])
    parser.add_argument('--config', default='milford2005', help='preset or file of parameters')
    parser.add_argument('--energy', type=float, help="pc_vt_inject_energy; default: the preset's")
    options = parser.parse_args()
    parameters = parameters_of(options.config)
    if options.energy is not None:
        parameters = replace(parameters, pc_vt_inject_energy=options.energy)
    for corridor in range(2):
        found = two_corridors_run(parameters, corridor)
        errors = ', '.join(f'{error:.1f}' for error in found.errors_cells)
        print(f'corridor {corridor}: {found.packets} packets, then {errors} cells off')


if __name__ == '__main__':
    main()
