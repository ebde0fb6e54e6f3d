# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The score of `ratslam tune` against the truth, and the configurations that it proposes.

    python benchmarks/tuning_score.py [--data FOLDER] [--only NAME ...] [--folder FOLDER ...]

Recordings of laps with `lap_phase.csv` are used; `lap_measures.py` defines precision,
recall and the spread of the map. For each recording:
- the rank correlation (Spearman) of the score with the F-measure of the recognition and with the
  spread, over configurations of different quality: presets with thresholds, template sizes and
  cells drawn at random (seed 0);
- the results of the default, of the proposal, and of the proposal if the preset that was tuned on
  the recording is left out.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from lap_measures import LAPS, ROOT, spread
from scipy.stats import spearmanr

from ratslam_ros.core.config import Config
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.files.config import load_config, presets
from ratslam_ros.offline.inspection import inspect
from ratslam_ros.recordings import Recording, open_recording
from ratslam_tuning.lap_phases import LapPhases, read_lap_phases
from ratslam_tuning.map_score import PRECISION_WEIGHT, f_measure, poses_at, score_map
from ratslam_tuning.revisits import measure, sample_frames
from ratslam_tuning.trials import Trial, run_trials
from ratslam_tuning.tuning import propose

TUNED_ON = {'rc_car_loops': 'rc_car', 'donkeycar_track': 'donkeycar', 'lab_car': ''}
"""Preset that was tuned on a recording."""

TOLERANCE_FRAMES = 8
VARIATION_COUNT = 36


def truth(trial: Trial, phases: LapPhases, tolerance: int) -> tuple[float, float, float]:
    """Return precision, recall and spread of a map."""
    precision, recall = phases.recognition(trial.template_id, tolerance)
    return precision, recall, spread(poses_at(trial.map, trial.view_ns)[0], phases)


def variations() -> Iterator[Config]:
    """Yield configurations of different quality."""
    rng = np.random.default_rng(0)
    names = [name for name in sorted(presets()) if name != 'default']
    for index in range(VARIATION_COUNT):
        config, _ = load_config(names[index % len(names)])
        size = ((20, 12), (32, 16), (48, 24), (60, 20))[rng.integers(4)]
        try:
            yield config.with_values({
                'experience_map.exp_align_scans': False,
                'local_view.image_crop_x_min': 0, 'local_view.image_crop_x_max': -1,
                'local_view.image_crop_y_min': 0,
                'local_view.image_crop_y_max': int(rng.choice([-1, 60, 80])),
                'local_view.template_x_size': size[0], 'local_view.template_y_size': size[1],
                'local_view.vt_shift_match': int(rng.integers(0, 4)),
                'local_view.vt_shift_match_y': 0,
                'local_view.vt_patch_normalise': int(rng.choice([0, 4, 7])),
                'local_view.vt_match_threshold': round(float(rng.uniform(0.03, 0.15)), 3),
                'pose_cells.pc_cell_x_size': float(rng.choice([0.5, 1.0, 2.0])),
            })
        except UnusableParameter:
            continue


def report_correlation(recording: Recording, phases: LapPhases, tolerance: int) -> None:
    """Print the rank correlation of the score with the truth."""
    selection = recording.select()
    frames = list(sample_frames(recording, selection))
    evidence = measure(np.stack([image for _, image in frames]),
                       np.array([stamp for stamp, _ in frames], np.int64))
    trials = [trial for trial in run_trials(recording, selection, list(variations()))
              if isinstance(trial, Trial)]
    found = [truth(trial, phases, tolerance) for trial in trials]
    quality = [f_measure(precision, recall, PRECISION_WEIGHT) for precision, recall, _ in found]
    score = [score_map(trial, evidence).total for trial in trials]
    spread = [-spread for _, _, spread in found]
    print(f'  rank correlation over {len(trials)} configurations: with the F-measure '
          f'{spearmanr(score, quality)[0]:.2f}, with the spread {spearmanr(score, spread)[0]:.2f}',
          flush=True)


def report_proposals(recording: Recording, phases: LapPhases, own: str, tolerance: int) -> None:
    """Print the results of the default and of the proposals."""
    selection = recording.select()
    default = inspect(recording, selection, load_config(None)[0]).config
    named = {f'preset {name}': load_config(name)[0] for name in sorted(presets())}
    rows = {'default': default,
            'proposed': propose(recording, selection, default, named).config}
    if own:
        del named[f'preset {own}']
        rows[f'without {own}'] = propose(recording, selection, default, named).config
    trials = run_trials(recording, selection, list(rows.values()))
    for name, trial in zip(rows, trials, strict=True):
        values = truth(trial, phases, tolerance) if isinstance(trial, Trial) else (math.nan,) * 3
        print(f'  {name:20} precision / recall {values[0]:.3f} / {values[1]:.3f}, spread '
              f'{values[2]:.4f}', flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    parser.add_argument('--only', nargs='+', choices=TUNED_ON, default=list(TUNED_ON))
    parser.add_argument('--folder', nargs='+', type=Path, default=[],
                        help='other recordings with lap_phase.csv, instead of those in --data')
    options = parser.parse_args()
    warm_up()
    for folder in options.folder or [options.data / name for name in options.only]:
        own = TUNED_ON.get(folder.name, '')
        tolerance = LAPS[folder.name].tolerance if folder.name in LAPS else TOLERANCE_FRAMES
        if not folder.is_dir():
            print(f'{folder.name}: skipped, {folder} not found')
            continue
        print(folder.name)
        phases = read_lap_phases(folder / 'lap_phase.csv')
        with open_recording(folder) as recording:
            report_correlation(recording, phases, tolerance)
            report_proposals(recording, phases, own, tolerance)


if __name__ == '__main__':
    main()
