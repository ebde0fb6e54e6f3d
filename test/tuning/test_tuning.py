# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tuning: what is proposed, and when the default is kept."""

import shlex
from dataclasses import replace

import numpy as np
import pytest
from helpers import START_NS, odometry_message, string_message, template_text, write_bag
from loops import BLIND, FINE, frames, laps, write_loops

from ratslam_ros.cli.main import main
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.files.config import load_config, parse_setting, to_yaml
from ratslam_ros.recordings import open_recording
from ratslam_tuning import tuning, view_search
from ratslam_tuning.map_score import MapScore
from ratslam_tuning.revisits import FrameScaler, measure
from ratslam_tuning.trials import Span, run_trials
from ratslam_tuning.tuning import Candidate, is_better, plot_proposal, propose, ranked
from ratslam_tuning.view_search import ViewSearch

GOOD = MapScore(0.97, 0.9, 0.9, 0.02)


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    return write_loops(tmp_path_factory.mktemp('loops'))


def proposed(bag, default, others, monkeypatch, **changes):
    """Return the proposal among the given candidates, without variations of them."""
    for name in ('_views', '_variations'):
        monkeypatch.setattr(tuning, name, lambda *arguments: iter(()))
    for name, value in changes.items():
        monkeypatch.setattr(tuning, name, value)
    with open_recording(bag) as recording:
        return propose(recording, recording.select(), default, others)


def test_blind_default_is_replaced_by_a_map_with_closures(bag, monkeypatch):
    monkeypatch.setattr(view_search, 'SIZES',
                        {'intensity': ((20, 12),), 'gradients': ((8, 6), (12, 9))})
    monkeypatch.setattr(view_search, 'PATCHES', {'intensity': (0,)})
    lines = []
    with open_recording(bag) as recording:
        proposal = propose(recording, recording.select(), BLIND, {}, report=lines.append)
    assert proposal.default.trial.loop_closures == 0
    assert proposal.chosen.trial.loop_closures > 0
    assert proposal.chosen.held_out.total > 0.6
    assert proposal.config == proposal.chosen.trial.config
    assert BLIND.with_values(dict(map(parse_setting, proposal.settings))) == proposal.config
    assert 'searching 240 images' in lines[0]
    text = proposal.format()
    assert text.count('  proposed') == 1
    assert text.count('  runner-up') == 1
    assert 'default' in text


def test_good_default_is_kept(bag, monkeypatch):
    others = {'other': FINE.with_values({'local_view.vt_match_threshold': 0.055}), 'blind': BLIND}
    proposal = proposed(bag, FINE, others, monkeypatch)
    assert proposal.chosen is proposal.default
    assert proposal.config == FINE
    assert proposal.settings == ()
    assert 'the default is proposed' in proposal.format()


def test_preset_that_does_not_fit_is_skipped(bag, monkeypatch):
    wide = FINE.with_values({'local_view.image_crop_x_max': 1000})
    proposal = proposed(bag, BLIND, {'wide': wide, 'fine': FINE}, monkeypatch)
    assert proposal.chosen.name == 'fine'
    with pytest.raises(UnusableParameter, match='image_crop'):
        proposed(bag, wide, {}, monkeypatch)


def test_long_recording_is_screened_on_a_part(bag, monkeypatch):
    proposal = proposed(bag, BLIND, {'fine': FINE}, monkeypatch, SCREENED_FRAME_COUNT=170)
    assert proposal.chosen.name == 'fine'
    assert len(proposal.chosen.trial.view_ns) == 240


def test_recording_without_revisits_keeps_the_default(tmp_path, monkeypatch):
    bag = write_bag(tmp_path / 'once', laps(150, per_lap=300))
    proposal = proposed(bag, FINE, {'blind': BLIND}, monkeypatch)
    assert proposal.config == FINE
    assert proposal.candidates == ()
    assert 'too few revisits' in proposal.format()
    assert plot_proposal(proposal, tmp_path / 'tune.png').stat().st_size > 5_000


def test_few_images_are_rejected(tmp_path, monkeypatch):
    bag = write_bag(tmp_path / 'short', laps(20))
    with pytest.raises(UnusableInput, match='20 images to tune with, expected 50'):
        proposed(bag, FINE, {}, monkeypatch)


def test_small_gain_must_not_cost_precision_or_recall():
    assert not is_better(GOOD, GOOD)
    assert is_better(replace(GOOD, joined=0.93), GOOD)
    assert not is_better(replace(GOOD, joined=0.97, recall=0.87), GOOD)
    assert not is_better(replace(GOOD, joined=0.97, precision=0.95), GOOD)
    assert not is_better(replace(GOOD, joined=0.97, folded=0.04), GOOD)
    assert is_better(GOOD, MapScore(1.0, 0.1, 0.3, 0.0))


def test_ranking_prefers_closures_and_then_earlier_candidates(bag):
    with open_recording(bag) as recording:
        trial, = run_trials(recording, recording.select(), [FINE], Span(0.0, 2.0))

    def candidate(joined, closures):
        score = replace(GOOD, joined=joined)
        return Candidate('', replace(trial, loop_closures=closures), score, score)

    equal, best, worse, open_map = (
        candidate(0.895, 5), candidate(0.9, 5), candidate(0.8, 5), candidate(0.99, 0))
    order = ranked([open_map, equal, best, worse])
    assert [id(c) for c in order] == [id(c) for c in (equal, best, worse, open_map)]


def test_view_search_crops_what_is_different_in_every_frame():
    rng = np.random.default_rng(1)
    images = np.stack(list(frames(240)))
    images[:, 16:] = rng.integers(0, 256, images[:, 16:].shape, dtype=np.uint8)
    evidence = measure(np.stack(list(frames(240))), np.arange(240, dtype=np.int64) * 10**8)
    scaler = FrameScaler(FINE.local_view)
    scaler.shrink(images[0])
    best, *_ = ViewSearch(images, evidence).best(scaler.to_small(FINE.local_view), 2)
    assert best.parameters.image_crop_y_min == 0
    assert 12 <= best.parameters.image_crop_y_max <= 22
    assert best.score > 0.7
    assert len(best.right) > len(best.wrong)


def test_tune_writes_a_configuration_for_replay(bag, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(tuning, '_views', lambda *arguments: iter(()))
    monkeypatch.setattr(tuning, '_variations', lambda *arguments: iter(()))

    (tmp_path / 'fine.yaml').write_text(to_yaml(FINE))
    out = tmp_path / 'of bag'
    assert main(['tune', str(bag), '--config', str(tmp_path / 'fine.yaml'), '--start', '1',
                 '--duration', '20', '--out', str(out), '--image-topic', '/camera/image']) == 0
    shown = capfd.readouterr().out
    assert shlex.split(shown.splitlines()[-1]) == [
        'ratslam', 'replay', str(bag), '--image-topic=/camera/image',
        '--config', str(out / 'tuned.yaml'),
    ]
    assert '200 images' in shown or '201 images' in shown
    assert (out / 'tune.png').stat().st_size > 20_000
    tuned, _ = load_config(str(out / 'tuned.yaml'))
    runner_up, _ = load_config(str(out / 'runner_up.yaml'))
    assert tuned != runner_up


def test_tune_without_images_names_the_alternative(tmp_path, capfd):
    def templates():
        for i in range(5):
            stamp = START_NS + i * 10**8
            yield stamp, '/odom', 'odometry', odometry_message(stamp, 1, 0, Pose(0.0, 0.0, 0.0))
            text = template_text(stamp, i)
            yield stamp, '/local_view/template', 'string', string_message(text)

    assert main(['tune', str(write_bag(tmp_path / 'bag', templates()))]) == 2
    assert 'ratslam study' in capfd.readouterr().err
