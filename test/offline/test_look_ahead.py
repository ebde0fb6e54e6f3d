# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the images of a recording show before it is replayed: field of view and look-alikes."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from helpers import PERIOD_NS, START_NS, extended
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.config import AUTOMATIC
from ratslam_ros.descriptors import encoder_of
from ratslam_ros.offline.look_ahead import Look, field_of_view_deg, look_alike_ratio

LAP, COUNT = 100, 300
HEIGHT, WIDTH, STEP_PX = 36, 48, 5
PERIOD_S = PERIOD_NS * 1e-9
ROUND_RADPS = 2.0 * math.pi / (LAP * PERIOD_S)
"""Turn rate of a robot on a circle that it drives in ``LAP`` frames."""

CONFIG = extended().with_values(
    {
        'local_view.vt_descriptor': 'gradients', 'local_view.template_x_size': 12,
        'local_view.template_y_size': 9, 'local_view.vt_shift_match': 1,
        'local_view.vt_match_threshold': AUTOMATIC, 'inputs.max_odom_gap_s': 2.0,
    }
)
FOV_DEG = CONFIG.visual_odometry.camera_fov_deg


def wall(period: int, likeness: float = 0.0) -> NDArray[np.float64]:
    """Return a wall whose pattern repeats after some frames, with halves that resemble."""
    rng = np.random.default_rng(5)
    pattern = rng.normal(size=(HEIGHT, period * STEP_PX))
    half = period * STEP_PX // 2
    pattern[:, half : 2 * half] += likeness * (pattern[:, :half] - pattern[:, half : 2 * half])
    pattern = cv2.GaussianBlur(np.tile(pattern, -(-COUNT // period) + 3), (0, 0), 2.0)
    return np.asarray(128.0 + 50.0 * pattern / pattern.std())


def looks(
    drawn: NDArray[np.float64], turn_radps: float = 0.0, count: int = COUNT, gap: int = -1
) -> list[Look]:
    """Return what a robot sees that drives past a wall; before frame ``gap`` it is carried."""
    rng = np.random.default_rng(6)
    encoder = encoder_of(CONFIG.local_view)
    found = []
    for i in range(count):
        image = drawn[:, i * STEP_PX : i * STEP_PX + WIDTH] + rng.normal(size=(HEIGHT, WIDTH))
        stamp_ns = START_NS + i * PERIOD_NS + (gap <= i) * (gap > 0) * 10**10
        odometry = Odometry(stamp_ns, Twist(1.0, turn_radps), scale_known=False)
        found.append(Look(odometry, encoder.encode(image.clip(0, 255).astype(np.uint8))))
    return found


def test_wall_without_repetition_has_no_look_alikes() -> None:
    found = look_alike_ratio(looks(wall(COUNT + 20)), CONFIG, FOV_DEG)
    assert found is not None
    assert found > 0.65


def test_repeating_wall_has_look_alikes() -> None:
    found = look_alike_ratio(looks(wall(LAP)), CONFIG, FOV_DEG)
    assert found is not None
    assert found < 0.3


@pytest.mark.parametrize('gain', [1.0, 2.0])
def test_revisits_on_a_circle_are_not_look_alikes(gain: float) -> None:
    """The pattern repeats after each round, when odometry does not exclude the same place."""
    found = look_alike_ratio(looks(wall(LAP), ROUND_RADPS / gain), CONFIG, gain * FOV_DEG)
    assert found is None or found > 0.6


@pytest.mark.parametrize('count', [20, 5, 0])
def test_few_images_show_nothing(count: int) -> None:
    found = looks(wall(COUNT + 20), count=count)
    assert look_alike_ratio(found, CONFIG, FOV_DEG) is None
    assert field_of_view_deg(found, CONFIG) is None


@pytest.mark.parametrize('likeness', [0.0, 0.6])
@pytest.mark.parametrize('gain', [0.8, 2.2])
def test_field_of_view_follows_from_rounds(gain: float, likeness: float) -> None:
    """Places that resemble each other, half a round apart, are not taken for returns."""
    found = field_of_view_deg(looks(wall(LAP, likeness), ROUND_RADPS / gain), CONFIG)
    assert found == pytest.approx(gain * FOV_DEG, rel=0.02)


def test_straight_way_shows_no_field_of_view() -> None:
    assert field_of_view_deg(looks(wall(COUNT + 20), ROUND_RADPS), CONFIG) is None


def test_rounds_through_a_gap_show_no_field_of_view() -> None:
    drawn = wall(LAP)
    assert field_of_view_deg(looks(drawn, ROUND_RADPS, 2 * LAP), CONFIG) is not None
    assert field_of_view_deg(looks(drawn, ROUND_RADPS, 2 * LAP, LAP), CONFIG) is None
