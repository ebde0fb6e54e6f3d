# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from aliasing import measure_aliasing, nearest_errors

from ratslam_simulator.camera import CameraOptions
from ratslam_simulator.office_tour import OfficeTour
from ratslam_simulator.samples import ImageSample
from ratslam_simulator.simulation import SimulationOptions
from ratslam_simulator.world import WorldOptions


def test_nearest_errors_separates_revisits_from_look_alikes():
    # A place, a distant place that looks similar, and the first place again.
    views = np.array([[[0, 0]], [[10, 10]], [[0, 20]]], np.uint8)
    poses = np.array([(0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (0.1, 0.0, 0.1)])
    revisit, look_alike = nearest_errors(views, poses, pause=1)
    assert revisit == pytest.approx([np.inf, np.inf, 10 / 255])
    assert look_alike == pytest.approx([10 / 255, 10 / 255, 10 / 255])


def test_nearest_errors_opposite_heading_is_no_revisit():
    views = np.zeros((2, 1, 2), np.uint8)
    poses = np.array([(0.0, 0.0, 3.1), (0.0, 0.0, 0.0)])
    assert np.isinf(nearest_errors(views, poses, pause=1)[0]).all()
    poses[1, 2] = -3.1  # close to 3.1 rad across the wrap
    assert nearest_errors(views, poses, pause=1)[0][1] == 0.0


def templates(image):
    """Return 12 x 8 block means, normalised by the mean and deviation of their neighbourhoods."""
    blocks = image[:, :156].reshape(8, 15, 12, 13).mean(axis=(1, 3))
    padded = np.pad(blocks, 2, mode='edge')
    patches = np.lib.stride_tricks.sliding_window_view(padded, (5, 5))
    deviation = (blocks - patches.mean(axis=(2, 3))) / np.maximum(patches.std(axis=(2, 3)), 1e-6)
    return np.floor(255 * np.clip((deviation + 3) / 6, 0, 1) + 0.5).astype(np.uint8)


def measured(aliasing):
    """Return the aliasing of a tour through an office with this share of look-alike corners."""
    options = SimulationOptions(
        camera=CameraOptions(rate_hz=2), world=WorldOptions(aliasing=aliasing)
    )
    samples = [s for s in OfficeTour(2, options=options) if isinstance(s, ImageSample)]
    poses = np.array([(s.truth.x_m, s.truth.y_m, s.truth.heading_rad) for s in samples])
    views = np.stack([templates(s.image) for s in samples])
    return measure_aliasing(views, poses, threshold=0.05, shift=1)


def test_office_aliasing_adds_look_alikes_but_keeps_recognition():
    none, some = (measured(aliasing) for aliasing in (0.0, 0.8))
    assert none.look_alike_share < 0.05
    assert 0.1 < some.look_alike_share < 0.4
    assert some.revisited_share > 0.5
    assert some.recognised_share > 0.8
    assert some.right_share > 0.8
