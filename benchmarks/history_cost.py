# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cost of the history of a replay: time, size by kind of record, and seek times.

    python benchmarks/history_cost.py [RECORDING ...] [--pairs 3]

Without a recording, that of `ratslam demo` is made and measured. The parameters are those of the
defaults and an inspection, as of a replay without a configuration. Each pair replays once with and
once without history, in this process, after one replay that is not counted. The ratios are the
medians over the pairs: wall-clock time, processor time of the main thread, and of all threads.

Sizes are extrapolated to one hour; short recordings contain up to 1 MB more than their share,
which is the reserve of the history. Every kind is compressed for itself, so that their sum differs
from the size of the segments.
"""

from __future__ import annotations

import argparse
import random
import sqlite3
import statistics
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from ratslam_ros.files.config import load_config
from ratslam_ros.history.encoding import decoded, encode, unpacked
from ratslam_ros.history.file import HISTORY_NAME
from ratslam_ros.history.history_run import HistoryRun
from ratslam_ros.history.records import Record
from ratslam_ros.maps.chunks import Compressor
from ratslam_ros.offline.inspection import inspect
from ratslam_ros.offline.replay import ReplayOptions, replay
from ratslam_ros.recordings import open_recording
from ratslam_simulator.recording import write_recording

LOOK_UPS = 100
"""Number of random stamps at which look-ups are timed."""


class Times(NamedTuple):
    """Times of one replay in s."""

    wall_s: float
    main_thread_s: float
    process_s: float


def main() -> None:
    """Measure, and print tables."""
    parser = argparse.ArgumentParser(description='Measure the cost of the history of a replay.')
    parser.add_argument('recordings', nargs='*', type=Path)
    parser.add_argument('--pairs', type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        recordings = options.recordings or [write_recording(folder / 'demo', 1).recording]
        for recording in recordings:
            print(f'{recording.name}')
            print_times(recording, folder / 'results', options.pairs)
            print_sizes(folder / 'results' / HISTORY_NAME)
            print_look_ups(folder / 'results' / HISTORY_NAME)


def print_times(path: Path, folder: Path, pairs: int) -> None:
    """Replay with and without history, and print the ratios; a history stays in the folder."""
    with open_recording(path) as recording:
        config = inspect(recording, recording.select(), load_config(None)[0]).config

    def run(with_history: bool) -> Times:
        with open_recording(path) as recording:
            begin = Times(time.perf_counter(), time.thread_time(), time.process_time())
            replay(
                recording, recording.select(), config, folder,
                ReplayOptions(progress=False, history=with_history),
            )
            end = Times(time.perf_counter(), time.thread_time(), time.process_time())
        return Times(*(b - a for a, b in zip(begin, end, strict=True)))

    run(False)
    found = [(run(False), run(True)) for _ in range(pairs)]
    for number, name in enumerate(Times._fields):
        without, recorded = zip(*((a[number], b[number]) for a, b in found), strict=True)
        ratio = statistics.median(b / a for a, b in zip(without, recorded, strict=True))
        print(
            f'  {name:<14} without {statistics.median(without):7.3f}  with '
            f'{statistics.median(recorded):7.3f}  ratio {ratio:.3f}'
        )


def print_sizes(path: Path) -> None:
    """Print the bytes per hour of every kind of record."""
    packed, count = Compressor().compressed, Counter[str]()
    size = Counter[str]()
    with closing(sqlite3.connect(path)) as database:
        begin_ns, end_ns = database.execute(
            'SELECT min(begin_ns), max(end_ns) FROM segments'
        ).fetchone()
        for (data,) in database.execute('SELECT data FROM segments'):
            contents: dict[str, list[Record]] = defaultdict(list)
            for record in decoded(unpacked(data), list[Record]):
                contents[type(record).__name__].append(record)
            for name, records in contents.items():
                count[name] += len(records)
                size[name] += len(packed(encode(records)))
        count['checkpoints'], size['checkpoints'] = database.execute(
            'SELECT count(*), coalesce(sum(length(data)), 0) FROM checkpoints'
        ).fetchone()
    seconds = (end_ns - begin_ns) * 1e-9
    for name, number in size.most_common():
        per_hour = number * 3600 / seconds * 1e-6
        print(f'  {name:<14} {count[name] / seconds:7.2f} /s {per_hour:8.2f} MB per hour')
    total = path.stat().st_size
    print(
        f'  {"file":<14} {total * 1e-6:.2f} MB of {seconds:.0f} s: '
        f'{total * 3600 / seconds * 1e-6:.1f} MB per hour, '
        f'{max(total - 1e6, 0.0) * 3600 / seconds * 1e-6:.1f} without the reserve'
    )


def print_look_ups(path: Path) -> None:
    """Print median and 95th percentile of the times of look-ups at random stamps."""
    run = HistoryRun(path)
    look_ups: dict[str, Callable[[int], object]] = {
        'seek': run.seek, 'view_at': run.view_at,
    }
    for name, look_up in look_ups.items():
        choose = random.Random(1)
        times_ms = []
        for _ in range(LOOK_UPS):
            stamp_ns = choose.randint(run.begin_ns, run.end_ns)
            begin_s = time.perf_counter()
            look_up(stamp_ns)
            times_ms.append((time.perf_counter() - begin_s) * 1e3)
        times_ms.sort()
        print(
            f'  {name:<14} median {statistics.median(times_ms):6.2f} ms, 95 % within '
            f'{times_ms[LOOK_UPS * 95 // 100]:6.2f} ms'
        )
    run.close()


if __name__ == '__main__':
    main()
