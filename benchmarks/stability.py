# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stability: how many maps are right under changes of a recording that should not matter.

    python benchmarks/stability.py [--data ../shared/data] [--only RECORDING ...]
                                   [--variant NAME ... | --drawn N [--first 0]] [--laps N]
                                   [--no-inspect] [--jobs N]

Each recording of laps is replayed with nothing configured, as by `ratslam replay RECORDING`: the
original, and ten variants of `recording_variants.py`; the variant 'camera only' leaves out the
odometry, and is replayed only if it is named. `--drawn` replays N variants of each recording
instead. Each has three changes of images, times or odometry, which are drawn at random with its
number as the seed. With another `--first`, the variants are unseen ones. `lap_measures.py` defines
the measures. A map is right if precision is at least 0.9, recall at least 0.7, the spread at most
0.05, and the turns for each lap are within 0.2 of the true number. Each row is printed when its
replay ends.

`--laps` replays the first laps alone: with `--no-inspect`, it shows after how many laps live nodes
have a right map, which know no more than what they have received.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from functools import partial
from pathlib import Path

from lap_measures import LAPS, LapRun, Setup, in_processes, run_laps
from recording_variants import CAMERA_ONLY, DRAWN, VARIANTS

from ratslam_ros.errors import RatslamError

RECORDINGS = (
    'rc_car_loops', 'home_robot', 'outdoor_car', 'hall_car', 'rc_car_eight', 'rc_car_other_way',
)
"""Recordings that are replayed by default."""


def run(data: Path, setup: Setup, count: int | None, task: tuple[str, str]) -> LapRun:
    """Replay the first laps of a recording with a variant, both given by name."""
    name, variant = task
    return run_laps(data, LAPS[name], setup, variant, count=count)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    Setup.add_options(parser)
    parser.add_argument('--only', action='append', choices=LAPS, metavar='RECORDING',
                        help=f'may be repeated; one of {", ".join(LAPS)} '
                             f'(default: {", ".join(RECORDINGS)})')
    which = parser.add_mutually_exclusive_group()
    which.add_argument('--variant', action='append', choices=VARIANTS,
                       metavar='NAME', help=f'may be repeated; one of {", ".join(VARIANTS)} '
                                            f'(default: all but {CAMERA_ONLY})')
    which.add_argument('--drawn', type=int, metavar='N', help='number of drawn variants')
    parser.add_argument('--first', type=int, default=0, help='number of the first drawn variant')
    parser.add_argument('--laps', type=int, help='number of laps from the start (default: all)')
    parser.add_argument('--jobs', type=int, default=2, help='number of processes (default: 2)')
    options = parser.parse_args()
    variants = options.variant or [name for name in VARIANTS if name != CAMERA_ONLY]
    if options.drawn is not None:
        variants = [f'{DRAWN}{options.first + number}' for number in range(options.drawn)]
    tasks = []
    for name in options.only or RECORDINGS:
        if LAPS[name].path(options.data).is_dir():
            tasks += [(name, variant) for variant in variants]
        else:
            print(f'{name}: skipped, {LAPS[name].path(options.data)} not found')
    print('recording        variant             precision recall spread turns templates '
          'experiences  gain', flush=True)
    right: Counter[str] = Counter()
    work = partial(run, options.data, Setup.of(options), options.laps)
    for (name, variant), found in in_processes(work, tasks, options.jobs):
        if isinstance(found, RatslamError):
            print(f'{name:16} {variant:18}  WRONG  {found}', flush=True)
            continue
        is_right = found.measures.is_right(LAPS[name].turns)
        right[name] += is_right
        precision, recall, spread, turns, _ = found.measures
        _, changes = LAPS[name].variant(variant)
        gain = found.summary.get('odom_calibration', {}).get('rotation_gain', math.nan)
        print(f'{name:16} {variant:18}  {precision:9.3f} {recall:6.3f} {spread:6.3f} {turns:5.2f} '
              f'{found.summary["templates"]:9} {found.summary["experiences"]:11} {gain:5.2f}  '
              f'{"right" if is_right else "WRONG"}  {changes}', flush=True)
    for name, count in Counter(name for name, _ in tasks).items():
        print(f'{name:16} {right[name]} of {count} right')
    print(f'{right.total()} of {len(tasks)} right')


if __name__ == '__main__':
    main()
