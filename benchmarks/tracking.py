# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What single steps cost, warm, and how well a packet follows the odometry.

    python benchmarks/steps.py

The C++ figures are OpenRatSLAM's core, compiled -O3, one thread, on a machine of the same kind.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable

import numpy as np

from ratslam_ros.core.attractor import Network, kernel
from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.local_view import LocalView

REPEATS = 200
DIMS = (36, 30, 30)


def median_ms(step: Callable[[], object]) -> float:
    """Return the median time of a call."""
    times_s = []
    for _ in range(REPEATS):
        start_s = time.perf_counter()
        step()
        times_s.append(time.perf_counter() - start_s)
    return statistics.median(times_s) * 1e3


def network() -> Network:
    return Network(DIMS, kernel(7, 1.0), kernel(5, 2.0), 0.00002)


def pose_cells_ms() -> float:
    net = network()
    state = [net.start()]
    for _ in range(30):
        state[0] = net.step(state[0], 0.05, 0.01)

    def step() -> None:
        state[0] = net.step(state[0], 0.05, 0.01)
        net.peak(state[0])

    return median_ms(step)


def local_view_ms(templates: int) -> float:
    """Noise, 60x10, shift 5, a view that is not in memory: the exact minimum."""
    rng = np.random.default_rng(0)
    memory = LocalView(LocalViewParameters(template_x_size=60, template_y_size=10))
    for _ in range(templates):
        memory.learn(rng.integers(0, 256, (10, 60), dtype=np.uint8))
    view = rng.integers(0, 256, (10, 60), dtype=np.uint8)
    memory.match(view)
    return median_ms(lambda: memory.match(view))


def tracking_error(speed: float, headings: int = 24) -> float:
    """Return the worst error of the way, over the way, for headings off the lattice."""
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
        way = np.zeros(3)
        for _ in range(steps):
            packets = net.step(packets, speed, 0.0)
            now = np.array(net.peak(packets))
            way += (now - last + dims / 2) % dims - dims / 2
            last = now
        angle = start[0] * 2.0 * math.pi / DIMS[0]
        asked = speed * steps * np.array([math.sin(angle), math.cos(angle)])
        worst = max(worst, float(np.linalg.norm(way[1:] - asked)) / (speed * steps))
    return worst


def main() -> None:
    print(f'medians of {REPEATS} calls             C++ -O3      ours')
    print(f'pose cells 30x30x36, one packet      0.63 ms   {pose_cells_ms():6.3f} ms')
    print(f'local view 60x10, 1,000 templates    2.8 ms    {local_view_ms(1000):6.3f} ms')
    print(f'local view 60x10, 20,000 templates   56 ms     {local_view_ms(20000):6.3f} ms')
    print('cells a step   worst error of the way over 24 headings')
    for speed in (0.01, 0.1, 0.5, 1.0, 2.0, 3.0):
        print(f'{speed:12g}   {tracking_error(speed):.2%}')


if __name__ == '__main__':
    main()
