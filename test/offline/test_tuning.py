# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tuning on small worlds with a known solution, and on real recordings."""

import csv
from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers import real_recording

from ratslam_ros.core.config import Config, LocalViewParameters
from ratslam_ros.core.vision.intensity import make_view
from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.offline.revisits import NO_MATCH, compare_all, measure, sample_frames
from ratslam_ros.offline.tuning import plot_proposal, propose
from ratslam_ros.recordings import open_recording

PER_LAP = 100
HEIGHT, WIDTH = 48, 64
START = LocalViewParameters(template_x_size=20, template_y_size=12, vt_shift_match=2)


def drive(frames, seed=0, per_lap=PER_LAP, floor=True, border=0):
    """Yield frames, 0.1 s apart, of a camera that turns in front of a random wall.

    The lower half shows a floor that is different in every frame; `border` px at the left show
    the robot itself.
    """
    rng = np.random.default_rng(seed)
    step = 8
    wall = cv2.GaussianBlur(rng.normal(size=(HEIGHT, per_lap * step)), (0, 0), 4.0)
    wall = np.tile(128.0 + 50.0 * wall / wall.std(), (1, 2))
    for i in range(frames):
        x = step * i % (per_lap * step)
        view = wall[:, x:x + WIDTH] + rng.normal(scale=6.0, size=(HEIGHT, WIDTH))
        if floor:
            noise = cv2.GaussianBlur(rng.normal(size=(HEIGHT // 2, WIDTH)), (0, 0), 4.0)
            view[HEIGHT // 2:] = 128.0 + 50.0 * noise / noise.std()
        view[:, :border] = 20.0
        yield i * 10**8, np.clip(view, 0, 255).astype(np.uint8)


@pytest.fixture(scope='module')
def laps():
    return propose(drive(int(2.4 * PER_LAP)), START)


def recognised(images, parameters, lap_of, place_of, tolerance, lap_length, first_lap):
    """Return precision and recall of a template memory on the laps from `first_lap` on."""
    view, learned = LocalView(parameters), []
    right = wrong = missed = 0
    for i, image in enumerate(images):
        match = view.match(image)
        if match.is_new:
            learned.append(i)
        if lap_of[i] < first_lap:
            continue
        apart = abs(place_of[i] - place_of[learned[match.template_id]]) % lap_length
        if match.is_new:
            missed += 1
        elif min(apart, lap_length - apart) <= tolerance:
            right += 1
        else:
            wrong += 1
    return right / max(right + wrong, 1), right / (right + wrong + missed)


def test_proposal_recognises_revisits(laps):
    assert laps.revisits
    images = [image for _, image in drive(int(2.4 * PER_LAP))]
    index = np.arange(len(images))
    precision, recall = recognised(images, laps.parameters, index // PER_LAP, index % PER_LAP, 3,
                                   PER_LAP, 1)
    assert precision > 0.97
    assert recall > 0.9


def test_random_floor_is_cropped(laps):
    assert laps.parameters.image_crop_y_min == 0
    assert 0 < laps.parameters.image_crop_y_max <= HEIGHT - HEIGHT // 3
    assert laps.window[3] == laps.parameters.image_crop_y_max


def test_visible_robot_is_cropped():
    proposal = propose(drive(240, floor=False, border=12), START)
    assert proposal.parameters.image_crop_x_min in (11, 12)


def test_recording_without_revisits_keeps_start_parameters():
    proposal = propose(drive(200, per_lap=300), START)
    assert not proposal.revisits
    assert 'no place is clearly seen twice' in proposal.format()
    start = replace(START, vt_match_threshold=proposal.parameters.vt_match_threshold)
    assert proposal.parameters == start
    passed = np.mean(proposal.unsupported <= proposal.parameters.vt_match_threshold)
    assert passed == pytest.approx(0.02, abs=0.02)


def test_settings_give_the_proposed_parameters(laps):
    values = {}
    for setting in laps.settings:
        name, value = setting.split('=')
        values[name] = float(value) if '.' in value else int(value)
    config = replace(Config(), local_view=START)
    assert config.with_values(values).local_view == laps.parameters
    assert laps.format().splitlines()[-1].startswith('--set local_view.')


def test_same_frames_give_same_proposal_and_plot(laps, tmp_path):
    again = propose(drive(int(2.4 * PER_LAP)), START)
    assert again.format() == laps.format()
    first = plot_proposal(laps, tmp_path / 'a.png').read_bytes()
    assert plot_proposal(again, tmp_path / 'b.png').read_bytes() == first


def test_proposal_without_revisits_is_drawn(tmp_path):
    path = plot_proposal(propose(drive(120, per_lap=300), START), tmp_path / 'a.png')
    assert path.stat().st_size > 10_000


@pytest.mark.parametrize('changes', [
    {}, {'vt_shift_match': 0}, {'vt_step_match': 2}, {'vt_panoramic': True},
    {'vt_panoramic': True, 'vt_step_match': 3}, {'vt_patch_normalise': 2},
])
def test_errors_equal_those_of_local_view(changes):
    parameters = replace(START, vt_match_threshold=0.0, **changes)
    images = [image for _, image in drive(8)]
    errors = compare_all(np.stack([make_view(image, parameters) for image in images]), parameters)
    assert np.all(errors[np.triu_indices(8)] == NO_MATCH)
    for later in range(8):
        for earlier in range(later):
            memory = LocalView(parameters)
            memory.match(images[earlier])
            error = memory.match(images[later]).error
            assert errors[later, earlier] == pytest.approx(error, abs=1e-6)


def test_revisits_are_distinguished_from_chance_matches():
    stamps, images = zip(*drive(240, floor=False), strict=True)
    evidence = measure(np.stack(images), np.array(stamps) / 1e9, START)
    lap = np.arange(240) // PER_LAP
    assert np.mean(evidence.is_supported[lap >= 1]) > 0.85
    assert np.mean(evidence.is_supported[lap == 0]) < 0.2


def test_number_and_size_of_frames_are_bounded():
    def large():
        for stamp_ns, image in drive(300):
            yield stamp_ns, cv2.resize(image, (640, 480))

    proposal = propose(large(), START, at_most=160)
    assert proposal.reasons[0].startswith('150 frames')
    assert proposal.sample.shape == (480, 640)
    assert proposal.parameters.image_crop_y_max in (-1, 240, 320)


def test_unusable_frames_are_rejected():
    with pytest.raises(UnusableInput, match='expected 50 or more'):
        propose(drive(20), START)
    with pytest.raises(UnusableInput, match='choose one camera'):
        propose([*drive(60), (10**10, np.zeros((10, 10), np.uint8))], START)
    with pytest.raises(UnusableInput, match=r'expected at least 6\.0 s'):
        propose([(stamp_ns // 10, image) for stamp_ns, image in drive(60)], START)
    with pytest.raises(UnusableParameter, match='image_crop'):
        propose(drive(60), replace(START, image_crop_x_max=1000))


@pytest.mark.parametrize(('name', 'lap_length', 'tolerance', 'at_most'), [
    ('rc_car_loops', 191, 8, 1000), ('donkeycar_track', 521, 15, 1000)])
def test_laps_of_real_recording_are_recognised(name, lap_length, tolerance, at_most):
    folder = real_recording(name)
    with (folder / 'lap_phase.csv').open() as file:
        rows = list(csv.DictReader(file))
    lap, place = ([int(row[key]) for row in rows] for key in ('lap', 'ref_frame'))
    with open_recording(folder) as recording:
        proposal = propose(sample_frames(recording, at_most=at_most))
        events = recording.events(recording.select(visual_odometry=True))
        images = [event.grey() for event in events]
    precision, recall = recognised(images, proposal.parameters, lap, place, tolerance, lap_length,
                                   2)
    assert proposal.revisits
    assert precision > 0.93
    assert recall > 0.85
