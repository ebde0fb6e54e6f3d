# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Maps of real recordings with parts cut out, with and without `max_odom_gap_s`.

    python benchmarks/odometry_gaps.py [--data ../shared/data]

All messages within a cut are dropped, as if the recorder had paused while the robot drove on. Each
recording is replayed with its preset: with the gaps integrated (60 s) and treated as
unknown motion (2 s).

- lecture_hall: ATE RMSE of trajectory_final in m.
- rc_car_loops, which has gaps of 3.4 and 5.6 s of its own: median distance in m between frames of
  different laps that show the same place, and the largest distance between two frames. The links
  of integrated gaps enlarge the latter.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lecture_hall
import numpy as np
from lap_measures import ROOT, Setup, distances_m, image_stamps, read_frames
from numpy.typing import NDArray
from recording_variants import ChangedRecording, Variant

from ratslam_ros.core.config import Config
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.files.config import load_config
from ratslam_ros.recordings import open_recording
from ratslam_ros.results.evaluation import evaluate
from ratslam_ros.results.trajectory import Trajectory, read_tum
from ratslam_tuning.lap_phases import read_lap_phases
from ratslam_tuning.map_score import poses_at

RC_CAR = 'rc_car_loops'

LIMITS_S = (60.0, 2.0)
Cuts = Sequence[tuple[float, float]]
"""Start and end of each cut, in seconds from the start of the recording."""

HALL_CUTS: Sequence[Cuts] = (
    (), ((100, 120),), ((300, 320),), ((600, 630),), ((900, 915),),
    ((200, 215), (650, 680), (1000, 1030)),
)
CAR_CUTS: Sequence[Cuts] = ((), ((5, 15),), ((70, 80),), ((30, 41), (100, 107)))


def run(
    path: Path, config: Config, cuts: Cuts, folder: Path
) -> tuple[dict[str, Any], NDArray[np.int64]]:
    """Replay a recording with cuts; return the summary and the stamps of all its images."""
    with open_recording(path) as recording:
        cut = ChangedRecording(recording, Variant(cuts=cuts))
        summary, _ = Setup(config, look_ahead=False).replay(cut, folder)
        return summary, image_stamps(recording, recording.select())


def configured(preset: str, limit_s: float) -> Config:
    """Return a preset with a limit of gaps."""
    return load_config(preset)[0].with_values({'inputs.max_odom_gap_s': limit_s})


def lap_distances_m(
    folder: Path, stamp_ns: NDArray[np.int64], lap_phase: Path
) -> tuple[float, float]:
    """Return the median distance between laps and the largest distance, in m."""
    used = np.isin(stamp_ns, read_frames(folder / 'frames.csv').stamp_ns)
    position_m, _ = poses_at(read_tum(folder / 'trajectory_final.tum'), stamp_ns)
    return distances_m(position_m, read_lap_phases(lap_phase).only(used))


def _described(cuts: Cuts) -> str:
    return ', '.join(f'{start:g} to {end:g} s' for start, end in cuts) or 'no cut'


def report_lecture_hall(data: Path, temporary: Path) -> None:
    """Print the error for each cut and limit."""
    recording, truth_path = lecture_hall.convert(data, temporary)
    truth: Trajectory = read_tum(truth_path)
    for cuts in HALL_CUTS:
        texts = []
        for limit_s in LIMITS_S:
            config = configured('lecture_hall', limit_s)
            summary, _ = run(recording, config, cuts, temporary / 'results')
            final = read_tum(temporary / 'results' / 'trajectory_final.tum')
            ate_m = evaluate(final, truth).ate.rmse
            texts.append(f'{ate_m:.2f} m ({summary.get("components", 1)} components)')
        print(f'lecture_hall  {_described(cuts):45} {"   ".join(texts)}', flush=True)


def report_rc_car(data: Path, temporary: Path) -> None:
    """Print the distances for each cut and limit."""
    for cuts in CAR_CUTS:
        texts = []
        for limit_s in LIMITS_S:
            folder = temporary / 'results'
            summary, stamps = run(data / RC_CAR, configured('rc_car', limit_s), cuts, folder)
            laps_m, largest_m = lap_distances_m(folder, stamps, data / RC_CAR / 'lap_phase.csv')
            components = summary.get('components', 1)
            texts.append(f'{laps_m:.3f} of {largest_m:.1f} m ({components} components)')
        print(f'{RC_CAR}  {_described(cuts):45} {"   ".join(texts)}', flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    data: Path = parser.parse_args().data
    warm_up()
    print(f'limits: {" and ".join(f"{limit_s:g} s" for limit_s in LIMITS_S)}')
    with tempfile.TemporaryDirectory() as temporary:
        report_lecture_hall(data, Path(temporary))
        report_rc_car(data, Path(temporary))


if __name__ == '__main__':
    main()
