# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy of path integration in the pose cells: packet motion compared with odometry.

Lattices of packets move, or are fixed as published; then the time of a step is printed as well.

    python benchmarks/path_integration.py
"""

from __future__ import annotations

import math
import statistics
import time

import numpy as np

from ratslam_ros.core.pose_cells.attractor import Network, kernel
from ratslam_ros.core.pose_cells.packet import Packet

DIMS = (36, 30, 30)
"""Extents of the network: heading planes, rows and columns."""


def network(is_fixed: bool) -> Network:
    """Return a network with the default kernels."""
    return Network(DIMS, kernel(7, 1.0), kernel(5, 2.0), 0.00002, is_fixed)


def tracking_error(speed: float, is_fixed: bool, headings: int = 24) -> float:
    """Return the worst relative error of the integrated path over several headings.

    Args:
        speed: distance per step, in cells.
        is_fixed: whether the lattices of packets stay where they are.
        headings: number of headings, evenly spaced and not aligned with the heading planes.
    """
    net = network(is_fixed)
    dims = net.dims
    settled = net.start()
    for _ in range(30):
        settled = net.step(settled, 0.0, 0.0)
    worst = 0.0
    for heading in range(headings):
        packets = net.step(settled, 0.0, heading * DIMS[0] / headings + 0.37)
        start = last = np.array(net.peak(packets))
        steps = math.ceil(max(10.0 / speed, min(40.0 / speed, 4000)))
        path = np.zeros(3)
        for _ in range(steps):
            packets = net.step(packets, speed, 0.0)
            now = np.array(net.peak(packets))
            path += (now - last + dims / 2) % dims - dims / 2
            last = now
        angle = start[0] * 2.0 * math.pi / DIMS[0]
        expected = speed * steps * np.array([math.sin(angle), math.cos(angle)])
        worst = max(worst, float(np.linalg.norm(path[1:] - expected)) / (speed * steps))
    return worst


def dense_step_s(dims: tuple[int, int, int]) -> float:
    """Return the median CPU time of a step of a network whose cells are all active."""
    net = Network(dims, kernel(7, 1.0), kernel(5, 2.0), 0.0, is_fixed=True)
    activity = np.random.default_rng(1).uniform(0.9, 1.0, dims)
    full = [Packet(activity, np.array([0, 0, 0, *dims]), np.zeros(3))]
    times_s = []
    for _ in range(11):
        began_s = time.process_time()
        net.step(full, 0.3, 0.1)
        times_s.append(time.process_time() - began_s)
    return statistics.median(times_s)


def main() -> None:
    print('Worst relative error of the path over 24 headings')
    print('cells per step   moving    fixed lattice')
    for speed in (0.01, 0.1, 0.5, 1.0, 2.0, 3.0):
        moving, fixed = (tracking_error(speed, is_fixed) for is_fixed in (False, True))
        print(f'{speed:14g}   {moving:6.2%}    {fixed:6.2%}')
    dims = 36, 150, 150
    print(f'{math.prod(dims)} cells, all active, fixed lattice: {1.0 / dense_step_s(dims):.1f} Hz')


if __name__ == '__main__':
    main()
