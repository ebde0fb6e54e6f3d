# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cost of map files: size, bytes and processor time per cut, and time of the hand-over.

    python benchmarks/map_files.py [--experiences 20000] [--cuts 20]

A RatSLAM learns 1,000 experiences from random views. Its state is repeated until it has as many
experiences as asked for, and changes as in 2 s of driving: rows are appended, and some or all
poses are moved, as by a relaxation.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.core.ratslam import RatSLAM
from ratslam_ros.maps import Cut, MapMeta, MapStore, read_map, save_map

LEARNED = 1000
NEW_ROWS = 16
"""New experiences within 2 s: 8 views per second that all differ."""
MOVED_ROWS = 200
GROWING_ROWS = 500
"""Arrays and lists of at least this length grow with the map."""


def main() -> None:
    """Measure, and print tables."""
    parser = argparse.ArgumentParser(description='Measure the cost of map files.')
    parser.add_argument('--experiences', type=int, default=20_000)
    parser.add_argument('--cuts', type=int, default=20)
    options = parser.parse_args()
    states = scaled(learned_states(), options.experiences / LEARNED)
    print_sizes(states, options.experiences)
    print_cuts(states, options.cuts)


def learned_states() -> dict[str, State]:
    """Return the states of a RatSLAM with many experiences."""
    slam = RatSLAM(Config())
    generator = np.random.default_rng(1)
    number = 0
    while len(slam.experience_map) < LEARNED:
        slam.odometry(Odometry(number * 10**8, Twist(0.3, 0.05), Pose(0.0, 0.0, 0.0)))
        small = generator.integers(0, 255, (12, 16), np.uint8)
        slam.image(number * 10**8 + 5, np.kron(small, np.ones((10, 10), np.uint8)))
        number += 1
    return slam.state()


def scaled(value: Any, factor: float) -> Any:
    """Return a state whose growing arrays and lists are repeated."""
    if isinstance(value, dict):
        return {key: scaled(item, factor) for key, item in value.items()}
    if isinstance(value, np.ndarray) and value.ndim and len(value) >= GROWING_ROWS:
        return np.resize(value, (round(len(value) * factor), *value.shape[1:]))
    if isinstance(value, list) and len(value) >= GROWING_ROWS:
        return (value * (int(factor) + 1))[: round(len(value) * factor)]
    if isinstance(value, list):
        return [scaled(item, factor) for item in value]
    return value


def changed(value: Any, moved: int, number: int) -> Any:
    """Return a state with appended rows, and with some of its newest poses moved."""
    if isinstance(value, dict):
        return {key: changed(item, moved, number) for key, item in value.items()}
    if isinstance(value, np.ndarray) and value.ndim and len(value) >= GROWING_ROWS:
        grown = np.concatenate([value, value[-NEW_ROWS:]])
        if moved > 0 and value.dtype == np.float64 and value.ndim == 2 and value.shape[1] == 3:
            grown[-min(moved, len(grown)) :] += 1e-3 * number
        return grown
    if isinstance(value, list) and len(value) >= GROWING_ROWS:
        return value + value[-NEW_ROWS:]
    return value


def print_sizes(states: dict[str, State], count: int) -> None:
    """Print the size of the map by part."""
    print('| part | bytes per experience in the file | time to save | time to read |')
    print('| --- | --- | --- | --- |')
    with tempfile.TemporaryDirectory() as folder:
        for name, some in [*((part, {part: state}) for part, state in states.items()),
                           ('all', states)]:  # fmt: skip
            path = Path(folder) / f'{name}.map'
            save_s = seconds(lambda path=path, some=some: save_map(path, some, MapMeta()))
            read_s = seconds(lambda path=path: read_map(path))
            size = path.stat().st_size / count
            print(f'| {name} | {size:.0f} | {save_s:.2f} s | {read_s:.2f} s |')


def print_cuts(states: dict[str, State], count: int) -> None:
    """Print what a cut costs after typical changes."""
    print()
    print('| since the previous cut | written per cut | processor time per cut | hand-over: '
          'median | largest |')  # fmt: skip
    print('| --- | --- | --- | --- | --- |')
    for title, moved in (
        ('nothing', -1), (f'{NEW_ROWS} new rows', 0),
        (f'{NEW_ROWS} new rows, {MOVED_ROWS} moved', MOVED_ROWS),
        (f'{NEW_ROWS} new rows, all moved', 10**9),
    ):  # fmt: skip
        with tempfile.TemporaryDirectory() as folder:
            store = MapStore.open(Path(folder) / 'a.map', list(states), MapMeta(), print)
            store.cut(Cut(0, 0), states)
            store.flush(60.0)
            before = written_bytes()
            current, hand_over, processor = states, [], []
            for number in range(1, count + 1):
                if moved >= 0:
                    current = changed(current, moved, number)
                start_s, begin = time.process_time(), time.perf_counter()
                store.cut(Cut(number, number), current)
                hand_over.append(time.perf_counter() - begin)
                store.flush(60.0)
                processor.append(time.process_time() - start_s)
            size = (written_bytes() - before) / count
            store.close()
        print(
            f'| {title} | {size / 1000:.0f} kB | {1000 * statistics.median(processor):.1f} ms | '
            f'{1e6 * statistics.median(hand_over):.0f} µs | {1e6 * max(hand_over):.0f} µs |'
        )


def written_bytes() -> int:
    """Return the bytes that this process has written to files so far (Linux)."""
    lines = Path('/proc/self/io').read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith('wchar'))


def seconds(step: Callable[[], object]) -> float:
    """Return the time that a step takes."""
    begin = time.perf_counter()
    step()
    return time.perf_counter() - begin


if __name__ == '__main__':
    main()
