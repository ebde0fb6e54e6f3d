# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy of path integration in the pose cells: packet motion compared with odometry.

    python benchmarks/path_integration.py
"""

from __future__ import annotations

import math

import numpy as np

from ratslam_ros.core.pose_cells.attractor import Network, kernel

DIMS = (36, 30, 30)
"""Extents of the network: heading planes, rows and columns."""


def network() -> Network:
    """Return a network with the default kernels."""
    return Network(DIMS, kernel(7, 1.0), kernel(5, 2.0), 0.00002)


def tracking_error(speed: float, headings: int = 24) -> float:
    """Return the worst relative error of the integrated path over several headings.

    Args:
        speed: distance per step, in cells.
        headings: number of headings, evenly spaced and not aligned with the heading planes.
    """
    net = network()
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


def main() -> None:
    print('cells per step   worst relative error of the path over 24 headings')
    for speed in (0.01, 0.1, 0.5, 1.0, 2.0, 3.0):
        print(f'{speed:14g}   {tracking_error(speed):.2%}')


if __name__ == '__main__':
    main()
