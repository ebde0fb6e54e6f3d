# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scores of maps: trials build the maps of replays, and better maps have higher scores."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from helpers import real_recording
from loops import BLIND, DAZED, FINE, write_loops

from ratslam_ros.core.pose_cells import pruning
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.files.config import load_config
from ratslam_ros.offline.replay import ReplayOptions, replay
from ratslam_ros.recordings import open_recording
from ratslam_ros.results.trajectory import read_tum
from ratslam_tuning.lap_phases import read_lap_phases
from ratslam_tuning.map_score import MapScore, f_measure, score_map
from ratslam_tuning.revisits import measure, sample_frames
from ratslam_tuning.trials import Span, run_trials


def evidence_of(recording, at_most=2000):
    kept = list(sample_frames(recording, recording.select(), at_most=at_most))
    return measure(np.stack([image for _, image in kept]), np.array([stamp for stamp, _ in kept]))


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    return write_loops(tmp_path_factory.mktemp('loops'))


@pytest.fixture(scope='module')
def trials(bag):
    with open_recording(bag) as recording:
        maps = run_trials(recording, recording.select(), [FINE, BLIND, DAZED])
        return maps, evidence_of(recording)


def test_trial_builds_the_map_of_a_replay(bag, trials, tmp_path):
    with open_recording(bag) as recording:
        outcome = replay(recording, recording.select(), FINE, tmp_path,
                         ReplayOptions(progress=False))
    trial = trials[0][0]
    for name, path in (('trajectory_final', trial.map), ('dead_reckoning', trial.dead_reckoning)):
        expected = read_tum(tmp_path / f'{name}.tum')
        assert np.array_equal(expected.stamp_ns, path.stamp_ns)
        assert np.allclose(expected.position_m, path.position_m, atol=1e-8)
    with (tmp_path / 'frames.csv').open() as file:
        assert [int(row['template_id']) for row in csv.DictReader(file)] == (
            trial.template_id.tolist())
    assert trial.loop_closures == outcome.summary['loop_closures'] > 0
    assert trial.experiences == outcome.summary['experiences']
    assert trial.templates == outcome.summary['templates']


def test_poses_of_pruned_experiences_are_those_of_a_replay(bag, tmp_path, monkeypatch):
    linked = FINE.with_values({'pose_cells.exp_view_links': True})
    with open_recording(bag) as recording:
        complete, = run_trials(recording, recording.select(), [linked])
        monkeypatch.setattr(pruning, 'SUPERSEDED_SHARE', 0.02)
        trial, = run_trials(recording, recording.select(), [linked])
        replay(recording, recording.select(), linked, tmp_path, ReplayOptions(progress=False))
    assert trial.experiences < complete.experiences
    expected = read_tum(tmp_path / 'trajectory_final.tum')
    assert np.allclose(expected.position_m, trial.map.position_m, atol=1e-8)


def test_unusable_configuration_does_not_stop_the_others(bag):
    wide = FINE.with_values({'local_view.image_crop_x_max': 1000})
    with open_recording(bag) as recording:
        error, trial = run_trials(recording, recording.select(), [wide, FINE], Span(0.0, 3.0))
    assert isinstance(error, UnusableParameter)
    assert len(trial.view_ns) == 30


def test_good_map_scores_above_missed_and_wrong_recognitions(trials):
    good, blind, dazed = (score_map(trial, trials[1]) for trial in trials[0])
    assert good.precision > 0.9
    assert good.recall > 0.8
    assert good.joined > 0.9
    assert blind.recall < 0.05
    assert blind.total < 0.1
    assert dazed.precision < 0.3
    assert good.total > 2.0 * max(blind.total, dazed.total)


def test_map_folded_onto_itself_scores_lower(trials):
    (good, *_), evidence = trials
    mirrored = replace(
        good.map, position_m=np.abs(good.map.position_m - good.map.position_m.mean(axis=0)),
        heading_rad=np.zeros(len(good.map)))
    folded = score_map(replace(good, map=mirrored), evidence)
    assert folded.folded > score_map(good, evidence).folded
    assert folded.total < score_map(good, evidence).total


def test_scale_and_rotation_of_the_map_do_not_matter(trials):
    (good, *_), evidence = trials
    x, y = good.map.position_m.T
    turned = replace(good.map, position_m=10.0 * np.stack([-y, x], 1))
    score, same = score_map(good, evidence), score_map(replace(good, map=turned), evidence)
    assert same.joined == pytest.approx(score.joined)
    assert same.folded == pytest.approx(score.folded)


def test_rows_restrict_the_judged_frames(trials):
    (good, *_), evidence = trials
    first_lap = np.arange(70)
    assert score_map(good, evidence, first_lap).recall == 0.0 or (
        np.sum(evidence.is_supported[first_lap]) > 0)
    halves = [score_map(good, evidence, np.arange(start, 240, 2)).total for start in (0, 1)]
    assert halves[0] == pytest.approx(halves[1], abs=0.15)


def test_precision_counts_more_than_recall():
    assert f_measure(0.9, 0.6, 0.5) > f_measure(0.6, 0.9, 0.5)
    assert MapScore(0.9, 0.6, 1.0, 0.0).total == pytest.approx(f_measure(0.9, 0.6, 0.5))


def test_score_ranks_real_maps_as_the_truth_does():
    folder = real_recording('donkeycar_track')
    preset, _ = load_config('donkeycar')
    threshold = preset.local_view.vt_match_threshold
    configs = [preset.with_values({'local_view.vt_match_threshold': threshold * factor})
               for factor in (1.0, 0.7, 1.6)]
    phases = read_lap_phases(folder / 'lap_phase.csv')
    with open_recording(folder) as recording:
        maps = run_trials(recording, recording.select(), configs)
        evidence = evidence_of(recording, 500)
    scores = [score_map(trial, evidence).total for trial in maps]
    truth = [f_measure(*phases.recognition(trial.template_id, 5), 0.5) for trial in maps]
    assert np.argsort(scores).tolist() == np.argsort(truth).tolist()
    assert scores[0] > 0.75
