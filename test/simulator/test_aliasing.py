# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Perceptual aliasing: how often views of different places match each other."""

import math

import numpy as np

from ratslam_simulator.camera import CameraOptions
from ratslam_simulator.office_tour import OfficeTour
from ratslam_simulator.samples import ImageSample
from ratslam_simulator.simulation import SimulationOptions
from ratslam_simulator.world import WorldOptions

THRESHOLD = 0.05
"""Largest error at which two views match, as vt_match_threshold."""

SHIFT = 1
"""Largest column offset at which views are compared, as vt_shift_match."""

FAR_M = 5.0
"""Views further apart than this are of different places."""

NEAR_M, NEAR_RAD = 0.5, math.radians(15.0)
"""Largest distance and heading difference between a view and its revisit."""


def nearest_errors(views, poses, shift, pause):
    """Return the match errors of the best revisit and of the best look-alike of every view.

    Args:
        views: (n, height, width) uint8, the normalised templates, in time order.
        poses: (n, 3) x_m, y_m, heading_rad, the true poses at which they were taken.
        shift: as `SHIFT`.
        pause: smallest number of views between a view and its revisit.

    Returns:
        (2, n) mean absolute differences / 255: to the best revisit among the earlier views, and
        to the best look-alike among all views; inf if there is none.
    """
    width = views.shape[2] - 2 * shift
    shifted = [views[:, :, x : x + width].astype(np.int16) for x in range(2 * shift + 1)]
    found = np.full((2, len(views)), np.inf)
    for i, (*place_m, heading_rad) in enumerate(poses):
        differences = [np.abs(other - shifted[shift][i]).mean(axis=(1, 2)) for other in shifted]
        error = np.min(differences, axis=0) / 255.0
        distance_m = np.hypot(*(poses[:, :2] - place_m).T)
        turn_rad = np.angle(np.exp(1j * (poses[:, 2] - heading_rad)))
        again = (distance_m <= NEAR_M) & (np.abs(turn_rad) <= NEAR_RAD)
        again &= np.arange(len(views)) <= i - pause
        for row, compared in zip(found, (again, distance_m > FAR_M), strict=True):
            row[i] = error[compared].min(initial=np.inf)
    return found


def templates(image):
    """Return 12 x 8 block means, normalised by the mean and deviation of their neighbourhoods."""
    blocks = image[:, :156].reshape(8, 15, 12, 13).mean(axis=(1, 3))
    padded = np.pad(blocks, 2, mode='edge')
    patches = np.lib.stride_tricks.sliding_window_view(padded, (5, 5))
    deviation = (blocks - patches.mean(axis=(2, 3))) / np.maximum(patches.std(axis=(2, 3)), 1e-6)
    return np.floor(255 * np.clip((deviation + 3) / 6, 0, 1) + 0.5).astype(np.uint8)


def shares(aliasing):
    """Return how well single views of a tour distinguish places, as fractions.

    Args:
        aliasing: share of look-alike corners of the office.

    Returns:
        Views that match one of a different place; views at a place seen before in the same
        direction; those of these revisits that match an earlier view of their place; and those
        whose best match is of their place.
    """
    options = SimulationOptions(
        camera=CameraOptions(rate_hz=2), world=WorldOptions(aliasing=aliasing)
    )
    samples = [s for s in OfficeTour(2, options=options) if isinstance(s, ImageSample)]
    poses = np.array([(s.truth.x_m, s.truth.y_m, s.truth.heading_rad) for s in samples])
    views = np.stack([templates(s.image) for s in samples])
    revisit, look_alike = nearest_errors(views, poses, SHIFT, pause=100)
    revisited = np.isfinite(revisit)
    right = revisit < look_alike
    return (
        np.mean(look_alike <= THRESHOLD), np.mean(revisited),
        np.mean(revisit[revisited] <= THRESHOLD), np.mean(right[revisited]),
    )


def test_office_aliasing_adds_look_alikes_but_keeps_recognition():
    assert shares(0.0)[0] < 0.05
    look_alike, revisited, recognised, right = shares(0.8)
    assert 0.1 < look_alike < 0.4
    assert revisited > 0.5
    assert recognised > 0.8
    assert right > 0.8
