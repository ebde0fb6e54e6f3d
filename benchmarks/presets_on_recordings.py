# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Results of the presets on real recordings: recognition, map quality, errors and speed.

    python benchmarks/presets_on_recordings.py [--data ../shared/data]

`place_recognition.py` and `lecture_hall.py` define the measures and list the data that each preset
was tuned on. The spread of a map is the median distance between frames of different laps that show
the same place (equal ref_frame), relative to the diameter of the map, which is the largest
distance between two frames; likewise for dead reckoning. Recognition and spread are computed from
a replay of the whole recording with the preset of that recording.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
from dataclasses import dataclass
from pathlib import Path

import lecture_hall
import numpy as np
from numpy.typing import NDArray
from place_recognition import LAPS, Laps, lap_recognition, report_corridors
from scipy.spatial.distance import pdist

from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.files.config import load_config
from ratslam_ros.offline.replay import ReplayOptions, replay
from ratslam_ros.recordings import open_recording
from ratslam_ros.results.trajectory import read_tum

ROOT = Path(__file__).resolve().parents[1]
SPREAD_TARGET = {'rc_car_loops': 0.025, 'donkeycar_track': 0.0073}
"""Targets for the spread of the maps."""

REPEATS = 5
"""Number of replays whose speed is measured."""


@dataclass(frozen=True)
class Frames:
    """Columns of frames.csv, (n,) each: stamps in ns and template ids."""

    stamp_ns: NDArray[np.int64]
    template_id: NDArray[np.int64]


def read_frames(path: Path) -> Frames:
    """Read stamps and template ids from frames.csv."""
    with open(path, newline='') as file:
        rows = list(csv.DictReader(file))
    return Frames(
        np.array([int(row['stamp_ns']) for row in rows]),
        np.array([int(row['template_id']) for row in rows]),
    )


def map_spread(folder: Path, trajectory: str, lap_phase_csv: Path) -> float:
    """Return the spread of a trajectory as defined in the module docstring."""
    frames = read_frames(folder / 'frames.csv')
    path = read_tum(folder / f'{trajectory}.tum')
    since = frames.stamp_ns[0]
    at = np.stack(
        [
            np.interp(frames.stamp_ns - since, path.stamp_ns - since, path.position_m[:, axis])
            for axis in (0, 1)
        ],
        1,
    )
    with open(lap_phase_csv, newline='') as file:
        rows = list(csv.DictReader(file))
    lap = np.array([int(row['lap']) for row in rows])
    place = np.array([int(row['ref_frame']) for row in rows])
    i, j = np.triu_indices(len(at), 1)
    same = (place[i] == place[j]) & (lap[i] != lap[j])
    return float(np.median(np.linalg.norm(at[i[same]] - at[j[same]], axis=1)) / pdist(at).max())


def report_lap_recording(data: Path, laps: Laps) -> list[str]:
    """Replay a recording of laps; return its results as lines of text."""
    config, _ = load_config(laps.preset)
    lap_phase = data / laps.folder / 'lap_phase.csv'
    speeds = []
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary)
        for _ in range(REPEATS):
            with open_recording(data / laps.folder) as recording:
                selection = recording.select()
                outcome = replay(
                    recording, selection, config, out, ReplayOptions(progress=False)
                )
            speeds.append(outcome.summary['times_realtime'])
        ids = read_frames(out / 'frames.csv').template_id
        precision, recall = lap_recognition(ids, lap_phase, laps.tolerance, laps.lap_length)
        spread = map_spread(out, 'trajectory_final', lap_phase)
        dead_reckoning = map_spread(out, 'dead_reckoning', lap_phase)
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
    for laps in LAPS:
        if (data / laps.folder).is_dir():
            print('\n'.join(report_lap_recording(data, laps)), flush=True)
        else:
            print(f'{laps.folder}: skipped, {data / laps.folder} not found')
    report_corridors(data)
    print(lecture_hall.report(data))


if __name__ == '__main__':
    main()
