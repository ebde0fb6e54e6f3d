# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Revisits are found in sequences of images, without ground truth."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import extended, picture
from loops import PER_LAP, frames, write_loops

from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings import open_recording
from ratslam_tuning.revisits import NO_MATCH, compare_all, measure, sample_frames

COUNT = 240
P = extended('local_view', template_x_size=20, template_y_size=12, vt_shift_match=2)


def evidence(images, period_s=0.1):
    stamps = np.arange(len(images), dtype=np.int64) * round(period_s * 1e9)
    return measure(np.stack(images), stamps)


@pytest.fixture(scope='module')
def laps():
    return evidence(list(frames(COUNT)))


def test_revisits_are_distinguished_from_chance_matches(laps):
    lap = np.arange(COUNT) // PER_LAP
    assert laps.revisits
    assert np.mean(laps.is_supported[lap >= 1]) > 0.85
    assert np.mean(laps.is_supported[lap == 0]) < 0.2


def test_same_place_is_high_only_near_the_diagonals(laps):
    later, earlier = np.nonzero(np.isfinite(laps.same_place))
    apart = (later - earlier) % PER_LAP
    apart = np.minimum(apart, PER_LAP - apart)
    same = laps.same_place[later, earlier]
    revisit = laps.is_supported[later]
    assert same[revisit & (apart == 0)].mean() > 0.9
    assert same[apart > 4 * laps.lag].mean() < 0.05
    assert same.min() >= 0.0
    assert same.max() <= 1.0


def test_single_lap_has_no_revisits():
    assert not evidence(list(frames(200, per_lap=300))).revisits


def test_constant_images_are_not_revisits():
    assert not evidence([np.full((32, 48), 90, np.uint8)] * 120).revisits


def test_short_recording_is_rejected():
    with pytest.raises(UnusableInput, match=r'expected at least 6\.0 s'):
        evidence(list(frames(60)), period_s=0.01)


@pytest.mark.parametrize('changes', [{}, {'vt_shift_match': 0}, {'vt_patch_normalise': 2}])
def test_errors_equal_those_of_local_view(changes):
    parameters = replace(P, vt_match_threshold=0.0, **changes)
    images = [picture(seed, 24, 48) for seed in range(8)]
    view = LocalView(parameters)
    errors = compare_all(np.stack([view.encode(image) for image in images]), parameters)
    assert np.all(errors[np.triu_indices(8)] == NO_MATCH)
    for later in range(8):
        for earlier in range(later):
            memory = LocalView(parameters)
            memory.match(images[earlier])
            error = memory.match(images[later]).error
            assert errors[later, earlier] == pytest.approx(error, abs=1e-6)


def test_frames_are_sampled_within_the_span(tmp_path):
    with open_recording(write_loops(tmp_path)) as recording:
        selection = recording.select()
        whole = [stamp for stamp, _ in sample_frames(recording, selection)]
        part = [stamp for stamp, _ in sample_frames(recording, selection, 5.0, 10.0, 50)]
    assert len(whole) == COUNT
    assert 45 <= len(part) <= 60
    assert part[0] - whole[0] == pytest.approx(5.0e9, abs=2e8)
    assert part[-1] - part[0] == pytest.approx(10.0e9, abs=5e8)
