# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the presets reach on real recordings: recognition, maps, errors and speed in one table.

    python benchmarks/real_recordings.py [--data ../shared/data]

The measures and what each preset was chosen on stand in `place_recognition.py` and
`lecture_hall.py`. The map's spread is the median distance on the final map of frames of different
laps that show the same place (equal ref_frame), over the map's diameter (the largest distance of
two frames on it); the same for dead reckoning. Recognition and spread come from one replay of the
whole recording by the preset of its name.
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
SPREAD_AIM = {'rc_car_loops': 0.025, 'donkeycar_track': 0.0073}
REPEATS = 5


@dataclass(frozen=True)
class Frames:
    """frames.csv: (n,) stamps in ns and template ids."""

    stamp_ns: NDArray[np.int64]
    template_id: NDArray[np.int64]


def read_frames(path: Path) -> Frames:
    with open(path, newline='') as file:
        rows = list(csv.DictReader(file))
    return Frames(
        np.array([int(row['stamp_ns']) for row in rows]),
        np.array([int(row['template_id']) for row in rows]),
    )


def map_spread(folder: Path, trajectory: str, lap_phase_csv: Path) -> float:
    """Return the median distance of frames of one place, over the diameter; see the module."""
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
        reckoned = map_spread(out, 'dead_reckoning', lap_phase)
    name = laps.folder
    aim = f'{laps.target[0]:.2f} / {laps.target[1]:.2f}'
    median, least, most = np.median(speeds), min(speeds), max(speeds)
    return [
        f'{name:16}  precision / recall, whole      {precision:.3f} / {recall:.3f}   aim {aim}',
        f'{name:16}  spread on the map              {spread:.4f}          '
        f'aim {SPREAD_AIM[name]} (dead reckoning {reckoned:.2f})',
        f'{name:16}  times real time, {REPEATS} replays     {median:.0f} '
        f'({least:.0f} to {most:.0f})',
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
            print(f'{laps.folder}: skipped, there is no {data / laps.folder}')
    report_corridors(data)
    print(lecture_hall.report(data))


if __name__ == '__main__':
    main()
