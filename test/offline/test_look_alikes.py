# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Look-alikes are views that resemble each other although odometry shows different places."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers import (
    IMAGE_TOPIC,
    ODOM_TOPIC,
    PERIOD_NS,
    START_NS,
    Recorded,
    extended,
    image_message,
    odometry_message,
    write_bag,
)

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import AUTOMATIC
from ratslam_ros.offline.look_alikes import look_alike_ratio
from ratslam_ros.recordings import open_recording

COUNT = 300
HEIGHT, WIDTH, STEP_PX = 36, 48, 5
SPEED_MPS = 1.0

CONFIG = extended().with_values(
    {
        'local_view.vt_descriptor': 'gradients', 'local_view.template_x_size': 12,
        'local_view.template_y_size': 9, 'local_view.vt_shift_match': 1,
        'local_view.vt_match_threshold': AUTOMATIC,
    }
)  # fmt: skip


def drive(period: int, turn_rate: float = 0.0) -> Iterator[Recorded]:
    """Yield a drive past a wall whose pattern repeats after a number of frames."""
    rng = np.random.default_rng(5)
    pattern = np.tile(rng.normal(size=(HEIGHT, period * STEP_PX)), -(-COUNT // period) + 3)
    wall = cv2.GaussianBlur(pattern, (0, 0), 2.0)
    wall = 128.0 + 50.0 * wall / wall.std()
    for i in range(COUNT):
        stamp_ns = START_NS + i * PERIOD_NS
        yield stamp_ns, ODOM_TOPIC, 'odometry', odometry_message(
            stamp_ns, SPEED_MPS, turn_rate, Pose(0.0, 0.0, 0.0)
        )
        image = wall[:, i * STEP_PX : i * STEP_PX + WIDTH] + rng.normal(size=(HEIGHT, WIDTH))
        image = image.clip(0, 255).astype(np.uint8)
        yield stamp_ns + 1_000_000, IMAGE_TOPIC, 'image', image_message(stamp_ns, image)


def ratio(folder: Path, period: int, turn_rate: float = 0.0) -> float | None:
    with open_recording(write_bag(folder / 'bag', drive(period, turn_rate))) as recording:
        return look_alike_ratio(recording, recording.select(), CONFIG)


def test_wall_without_repetition_has_no_look_alikes(tmp_path: Path) -> None:
    found = ratio(tmp_path, COUNT + 20)
    assert found is not None
    assert found > 0.65


def test_repeating_wall_has_look_alikes(tmp_path: Path) -> None:
    found = ratio(tmp_path, 100)
    assert found is not None
    assert found < 0.3


def test_revisits_on_a_circle_are_not_look_alikes(tmp_path: Path) -> None:
    """The pattern repeats after each round, when odometry does not exclude the same place."""
    found = ratio(tmp_path, 100, turn_rate=2.0 * math.pi / (100 * PERIOD_NS * 1e-9))
    assert found is None or found > 0.6


@pytest.mark.parametrize('duration_s', [2.0, 0.5])
def test_short_recording_gives_no_ratio(tmp_path: Path, duration_s: float) -> None:
    with open_recording(write_bag(tmp_path / 'bag', drive(COUNT + 20))) as recording:
        found = look_alike_ratio(recording, recording.select(), CONFIG, 0.0, duration_s)
    assert found is None
