# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stability: how many maps are right under changes of a recording that should not matter.

    python benchmarks/stability.py [--data ../shared/data] [--only RECORDING ...]
                                   [--variant NAME ...] [--jobs N]

Each recording of laps is replayed with nothing configured, as by `ratslam replay RECORDING`: the
original, and the variants of `recording_variants.py`. `lap_measures.py` defines the measures. A
map is right if precision is at least 0.9, recall at least 0.7, the spread at most 0.05, and the
turns for each lap are within 0.2 of the true number. Each row is printed when its replay ends.
"""

from __future__ import annotations

import argparse
import multiprocessing
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from lap_measures import LAPS, LapRun, Setup, run_laps
from recording_variants import VARIANTS

from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.errors import RatslamError

RECORDINGS = (
    'rc_car_loops', 'home_robot', 'outdoor_car', 'hall_car', 'rc_car_eight', 'rc_car_other_way',
)  # fmt: skip
"""Recordings that are replayed by default."""


def run_all(
    tasks: list[tuple[str, str]], data: Path, setup: Setup, jobs: int
) -> Iterator[tuple[str, str, LapRun | str]]:
    """Replay tasks in processes; yield recording, variant and result, or the error, at the end.

    Args:
        tasks: names of a recording and a variant.
        data: folder of the recordings.
        setup: configuration of all replays.
        jobs: number of processes.
    """
    context = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(jobs, context, warm_up) as pool:
        running = {
            pool.submit(run_laps, data, LAPS[name], setup, variant): (name, variant)
            for name, variant in tasks
        }
        for future in as_completed(running):
            try:
                yield *running[future], future.result()
            except RatslamError as error:
                yield *running[future], str(error)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    Setup.add_options(parser)
    parser.add_argument('--only', action='append', choices=LAPS, metavar='RECORDING',
                        help=f'may be repeated; one of {", ".join(LAPS)} '
                             f'(default: {", ".join(RECORDINGS)})')
    parser.add_argument('--variant', action='append', choices=VARIANTS, metavar='NAME',
                        help=f'may be repeated; one of {", ".join(VARIANTS)} (default: all)')
    parser.add_argument('--jobs', type=int, default=2, help='number of processes (default: 2)')
    options = parser.parse_args()
    tasks = []
    for name in options.only or RECORDINGS:
        if LAPS[name].path(options.data).is_dir():
            tasks += [(name, variant) for variant in options.variant or VARIANTS]
        else:
            print(f'{name}: skipped, {LAPS[name].path(options.data)} not found')
    print('recording        variant             precision recall spread turns templates '
          'experiences', flush=True)
    right: Counter[str] = Counter()
    for name, variant, run in run_all(tasks, options.data, Setup.of(options), options.jobs):
        if isinstance(run, str):
            print(f'{name:16} {variant:18}  WRONG  {run}', flush=True)
            continue
        is_right = run.measures.is_right(LAPS[name].turns)
        right[name] += is_right
        precision, recall, spread, turns = run.measures
        rotation = next((line for line in run.lines if line.startswith('rotation')), '')
        print(f'{name:16} {variant:18}  {precision:9.3f} {recall:6.3f} {spread:6.3f} {turns:5.2f} '
              f'{run.summary["templates"]:9} {run.summary["experiences"]:11}  '
              f'{"right" if is_right else "WRONG"}  {rotation[:100]}', flush=True)
    for name, count in Counter(name for name, _ in tasks).items():
        print(f'{name:16} {right[name]} of {count} right')
    print(f'{right.total()} of {len(tasks)} right')


if __name__ == '__main__':
    main()
