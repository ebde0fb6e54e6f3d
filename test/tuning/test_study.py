# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameter studies: the plan, the objective, the search and its report."""

import sys

import pytest
from loops import BLIND, FINE, write_loops

from ratslam_ros.cli.main import main
from ratslam_ros.core.config import SECTIONS
from ratslam_ros.errors import RatslamError, UnusableInput
from ratslam_ros.files.config import load_config, to_yaml
from ratslam_tuning.study import search
from ratslam_tuning.study_plan import Judge, Range, StudyRecording, read_plan

PARAMETERS = """
parameters:
  local_view.vt_match_threshold: {low: 0.0001, high: 0.1}
  pose_cells.exp_current_by:
"""


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder with a bag of loops, its truth, its laps, and a configuration."""
    path = tmp_path_factory.mktemp('study')
    write_loops(path, 200)
    (path / 'start.yaml').write_text(to_yaml(BLIND))
    return path


def plan_of(folder, text, name='plan.yaml'):
    (folder / name).write_text(text)
    return read_plan(folder / name)


def study(folder, trials=4, extra=''):
    return plan_of(folder, f"""
config: start.yaml
recordings:
  - {{path: loops, truth: truth.tum, duration: 10.5}}
  - {{path: loops, lap_phase: lap_phase.csv, lap_tolerance: 4, use: validation}}
trials: {trials}
{PARAMETERS}{extra}""", 'loops.yaml')


def trials_in(optuna, path, plan):
    """Return the trials in the file of a study."""
    journal = optuna.storages.journal.JournalFileBackend(str(path))
    storage = optuna.storages.JournalStorage(journal)
    return optuna.load_study(study_name=plan.name, storage=storage).trials


def test_ranges_default_to_those_of_the_parameters(folder):
    plan = plan_of(folder, """
recordings: [loops]
parameters:
  local_view.template_x_size:
  local_view.vt_recent_threshold: {}
  local_view.vt_panoramic: {}
  pose_cells.pc_cell_x_size: {low: 0.1}
  pose_cells.pc_vt_agree_views: [0, 2, 3]
""")
    width, recent, panoramic, cells, views = plan.ranges
    assert width == Range('local_view.template_x_size', (), 1, 1024, None, True)
    assert recent == Range('local_view.vt_recent_threshold', (), 0.0, 1.0)
    assert panoramic.values == (False, True)
    info = {name: info for name, info, _ in SECTIONS['pose_cells'].parameters()}['pc_cell_x_size']
    assert (cells.low, cells.high, cells.log) == (0.1, info.high, True)
    assert views.values == (0, 2, 3)
    assert plan.trials == 100
    assert [recording.search for recording in plan.recordings] == [True]


@pytest.mark.parametrize(('text', 'message'), [
    ('recordings: [loops]', 'nothing to vary'),
    (PARAMETERS, 'no recording to search on'),
    ('- x', 'expected keys'),
    ('recordings: [loops]\nparameters: {local_view.nothing: }', 'names no parameter'),
    ('recordings: [loops]\nparameters: {pose_cells.pc_dim_x: {high: -3}}', 'out of range'),
    ('recordings: [loops]\nparameters: {pose_cells.pc_dim_x: {low: 9, high: 3}}', 'low < high'),
    ('recordings: [loops]\nparameters: {pose_cells.pc_dim_x: {lower: 9}}', "key 'lower'"),
    ('recordings: [loops]\nparameters: {pose_cells.pc_w_e_var: {low: x}}', 'not a number'),
    ('recordings: [loops]\nparameters: {experience_map.map_frame: }', 'a list of two or more'),
    ('recordings: [{path: loops, truth: none.tum}]', 'none.tum does not exist'),
    ('recordings: [{path: loops, use: test}]', 'expected search or validation'),
    ('recordings: [{path: loops, trut: x}]', "key 'trut'"),
    ('recordings: [{path: loops, images_rate: fast}]', 'images_rate is not a number'),
    (f'recordings: [loops]\ntrials: many{PARAMETERS}', 'expected a whole number'),
    (f'recordings: [loops]\nconfig: none{PARAMETERS}', 'no such file or preset'),
    ('recordings: [loops', 'expected a study file in YAML'),
])
def test_wrong_plan_is_reported_in_one_line(folder, text, message):
    with pytest.raises(RatslamError, match=message) as error:
        plan_of(folder, text)
    assert '\n' not in str(error.value)


def test_objective_is_higher_for_better_maps(folder):
    plan = study(folder)
    by_images = StudyRecording(folder / 'loops')
    for recording in (*plan.recordings, by_images):
        judge = Judge(recording, plan.config)
        good, blind = judge.judge(FINE), judge.judge(BLIND)
        assert good.value > blind.value + 0.1, good
        assert 0.0 <= blind.value <= good.value <= 1.0
    assert 'precision' in good.text
    assert Judge(plan.recordings[0], plan.config).judge(BLIND).value == pytest.approx(0.5)


def test_laps_of_another_recording_are_rejected(folder):
    recording = StudyRecording(folder / 'loops', lap_phase=folder / 'short.csv')
    (folder / 'short.csv').write_text('frame,lap,ref_frame\n0,0,0\n')
    with pytest.raises(UnusableInput, match='one row per frame'):
        Judge(recording, FINE).judge(FINE)


def test_missing_recording_is_reported_before_the_search(folder, tmp_path, refusal):
    pytest.importorskip('optuna')
    plan_of(folder, f'recordings: [nothing]{PARAMETERS}')
    words = 'study', str(folder / 'plan.yaml'), '--out', str(tmp_path), '--jobs', '2'
    assert 'nothing does not exist' in refusal(*words)


def test_missing_optuna_is_reported_with_the_command(folder, refusal, monkeypatch):
    monkeypatch.setitem(sys.modules, 'optuna', None)
    study(folder)
    assert "pip install '.[study]'" in refusal('study', str(folder / 'loops.yaml'))


def test_study_is_resumed_and_reported(folder, tmp_path, capfd):
    optuna = pytest.importorskip('optuna')
    plan = study(folder)
    arguments = ['study', str(folder / 'loops.yaml'), '--out', str(tmp_path)]
    assert main([*arguments, '--trials', '2']) == 0
    assert main(arguments) == 0
    progress = capfd.readouterr().err
    assert progress.count('trial 1: ') == 1
    assert progress.count('trial 3: ') == 1
    trials = trials_in(optuna, tmp_path / 'study.journal', plan)
    assert len(trials) == 4
    assert trials[0].params == plan.initial
    assert trials[0].value == pytest.approx(0.5)
    report = (tmp_path / 'report.md').read_text()
    assert '| initial | 0.5000 |' in report
    assert 'loops (validation)' in report
    assert 'On the 1 validation recordings' in report
    for name in ('history.png', 'slices.png'):
        assert (tmp_path / name).stat().st_size > 5_000
    best = max(trials, key=lambda trial: trial.value)
    assert load_config(str(tmp_path / 'best.yaml'))[0] == plan.config.with_values(best.params)

    study(folder, extra='  pose_cells.pc_cell_x_size: {low: 0.1, high: 1}\n')
    assert main(arguments) == 2
    assert 'give another --out or name' in capfd.readouterr().err


def test_equal_seeds_try_equal_configurations(folder, tmp_path):
    optuna = pytest.importorskip('optuna')

    tried = []
    for name in ('a', 'b'):
        plan = study(folder, 3)
        search(plan, str(tmp_path / name), 1, lambda line: None)
        trials = trials_in(optuna, tmp_path / name, plan)
        tried.append([(trial.params, trial.value) for trial in trials])
    assert tried[0] == tried[1]
    assert len(tried[0]) == 3
