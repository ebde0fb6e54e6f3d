# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Results of the presets on real recordings: recognition, map quality, errors and speed.

    python benchmarks/presets_on_recordings.py [--data ../shared/data]

`lap_measures.py` and `lecture_hall.py` define the measures; `place_recognition.py` and
`lecture_hall.py` list the data that each preset was tuned on. Recognition and spread are computed
from a replay of the whole recording with the preset of that recording.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import lecture_hall
import numpy as np
from lap_measures import LAPS, ROOT, Setup, run_laps
from place_recognition import TUNED_LAPS, TunedLaps, report_corridors

from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.files.config import load_config

SPREAD_TARGET = {'rc_car_loops': 0.025, 'donkeycar_track': 0.0073}
"""Targets for the spread of the maps."""

REPEATS = 5
"""Number of replays whose speed is measured."""


def report_lap_recording(data: Path, laps: TunedLaps) -> list[str]:
    """Replay a recording of laps; return its results as lines of text."""
    setup = Setup(load_config(laps.preset)[0], look_ahead=False)
    runs = [run_laps(data, LAPS[laps.folder], setup) for _ in range(REPEATS)]
    speeds = [run.summary['times_realtime'] for run in runs]
    precision, recall, spread, _, dead_reckoning = runs[0].measures
    name = laps.folder
    target = f'{laps.target[0]:.2f} / {laps.target[1]:.2f}'
    median, slowest, fastest = np.median(speeds), min(speeds), max(speeds)
    return [
        f'{name:16}  precision / recall, whole      {precision:.3f} / {recall:.3f}   '
        f'target {target}',
        f'{name:16}  spread on the map              {spread:.4f}          '
        f'target {SPREAD_TARGET[name]} (dead reckoning {dead_reckoning:.2f})',
        f'{name:16}  times real time, {REPEATS} replays     {median:.0f} '
        f'({slowest:.0f} to {fastest:.0f})',
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    data: Path = parser.parse_args().data
    warm_up()
    for laps in TUNED_LAPS:
        if (data / laps.folder).is_dir():
            print('\n'.join(report_lap_recording(data, laps)), flush=True)
        else:
            print(f'{laps.folder}: skipped, {data / laps.folder} not found')
    report_corridors(data)
    print(lecture_hall.report(data))


if __name__ == '__main__':
    main()
