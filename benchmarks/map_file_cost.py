# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Map files: time and size of the states that a live system saves every two seconds, and what
it costs to write them.

Maps of several sizes are made of random views along a winding route without returns, with a laser
scan for every experience. The landmarks of relocation are left out: their number is limited to
4,000. Run it with ``PYTHONPATH=. python benchmarks/map_file_cost.py``.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.common.state import State
from ratslam_ros.files.config import load_config
from ratslam_ros.maps import Cut, MapMeta, MapStore, read_map
from ratslam_ros.pipeline.ratslam import RatSLAM

SIZES = 1_000, 5_000, 20_000
REPETITIONS = 9
BEAMS = 361
STEP_NS = 100_000_000


def drive(slam: RatSLAM, steps: int, first: int) -> None:
    """Drive on, with a new place at every step."""
    rng = np.random.default_rng(first)
    height, width = 48, 64
    for n in range(first, first + steps):
        at_ns = (n + 1) * STEP_NS
        slam.odometry(Odometry(at_ns, Twist(5.0, 0.3), Pose(0.0, 0.0, 0.0)))
        ranges = rng.uniform(2.0, 7.5, BEAMS)
        slam.scan(Scan(at_ns, -np.pi / 2, np.pi / (BEAMS - 1), ranges))
        blocks = rng.integers(0, 256, (height // 8, width // 8), np.uint8)
        slam.image(at_ns, np.kron(blocks, np.ones((8, 8), np.uint8)))


def parts(slam: RatSLAM) -> dict[str, Callable[[], State]]:
    """Return the function of each part that returns its state."""
    assert slam.scan_matcher is not None
    found: dict[str, Callable[[], State]] = {
        'local_view': slam.local_view.state,  # type: ignore[attr-defined]
        'pose_cells': slam.pose_cells.state,
        'experience_map': slam.experience_map.state, 'scans': slam.scan_matcher.state,
    }
    if slam.goal_memory is not None:
        found['goal_memory'] = slam.goal_memory.state
    return found


def values(state: Any) -> Iterator[int]:
    """Yield the bytes of all arrays and other values."""
    if isinstance(state, np.ndarray):
        yield state.nbytes
    elif isinstance(state, dict):
        for value in state.values():
            yield from values(value)
    elif isinstance(state, (list, tuple)):
        for value in state:
            yield from values(value)
    else:
        yield 8


def writing_costs(slam: RatSLAM, step: int) -> str:
    """Return a row: what each cut writes after two seconds of driving, and what it costs."""
    hand_over_ms, processor_ms, written = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'a.map'
        states = slam.state()
        store = MapStore(path, list(states), MapMeta(), print)
        for number in range(REPETITIONS + 1):
            states = slam.state()
            bytes_before, processor_s = written_bytes(), time.process_time()
            start_s = time.perf_counter()
            store.cut(Cut(number, number), states)
            handed_s = time.perf_counter()
            assert store.flush(600.0)
            if number:  # The first cut writes everything.
                hand_over_ms.append((handed_s - start_s) * 1e3)
                processor_ms.append((time.process_time() - processor_s) * 1e3)
                written.append((written_bytes() - bytes_before) / 1e3)
            drive(slam, 20, step)
            step += 20
        store.close()
        start_s = time.perf_counter()
        read_map(path)
        read_s = time.perf_counter() - start_s
        size_mb = path.stat().st_size / 1e6
    return (
        f'| {len(slam.experience_map)} | {statistics.median(written):.0f} | '
        f'{statistics.median(processor_ms):.1f} | {statistics.median(hand_over_ms):.3f} | '
        f'{max(hand_over_ms):.3f} | {size_mb:.1f} | {read_s:.2f} |'
    )


def written_bytes() -> int:
    """Return the bytes that this process has written to files (Linux)."""
    lines = Path('/proc/self/io').read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith('wchar'))


def main() -> None:
    """Print a table: part, experiences, median and longest CPU time, and size of the state."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--preset', default='extended', help='preset or file')
    parser.add_argument('--sizes', type=int, nargs='+', default=SIZES, help='experiences')
    arguments = parser.parse_args()
    config = load_config(arguments.preset)[0].with_values({
        'experience_map.exp_align_scans': True, 'experience_map.exp_relocate': 'views',
        'goal_memory.goal_memory': True, 'local_view.vt_match_threshold': 0.01,
        'pose_cells.exp_delta_pc_threshold': 0.5, 'pose_cells.pc_cell_x_size': 0.5,
    })
    slam = RatSLAM(config)
    size_before: dict[str, tuple[int, int]] = {}
    print('| Experiences | Part | Median ms | Longest ms | Bytes | Bytes for each |')
    print('|---:|:---|---:|---:|---:|---:|')
    step = 0
    costs: list[str] = []
    for size in sorted(arguments.sizes):
        while len(slam.experience_map) < size:
            drive(slam, 50, step)
            step += 50
        times_ms: dict[str, list[float]] = {}
        kept: dict[str, State] = {}
        for _ in range(REPETITIONS):
            drive(slam, 20, step)  # what two seconds at 10 Hz add
            step += 20
            for name, state in parts(slam).items():
                start_s = time.thread_time()
                saved = state()
                times_ms.setdefault(name, []).append((time.thread_time() - start_s) * 1e3)
                kept[name] = saved
        count = len(slam.experience_map)
        for name, saved in kept.items():
            taken = sorted(times_ms[name])
            total = sum(values(saved))
            before, bytes_before = size_before.get(name, (0, 0))
            each = (total - bytes_before) / (count - before)
            size_before[name] = count, total
            print(f'| {count} | {name} | {taken[len(taken) // 2]:.2f} | {taken[-1]:.2f} | '
                  f'{total} | {each:.0f} |', flush=True)
        costs.append(writing_costs(slam, step))
        step += 20 * (REPETITIONS + 1)
    print()
    print('| Experiences | kB written per cut | Processor ms per cut | Hand-over ms: median '
          '| longest | File MB | Reading s |')
    print('|---:|---:|---:|---:|---:|---:|---:|')
    print('\n'.join(costs))


if __name__ == '__main__':
    main()
