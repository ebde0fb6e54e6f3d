# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tests that the field of view for visual odometry comes from recorded camera_info."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import (
    PERIOD_NS,
    START_NS,
    Recorded,
    camera_info_message,
    extended,
    image_message,
    picture,
    write_bag,
)

from ratslam_ros.offline.replay import ReplayOptions, replay
from ratslam_ros.recordings import open_recording


def write(folder: Path, infos: dict[str, float]) -> Path:
    """Write a bag of images and one camera_info message per topic in ``infos``."""
    calibrations: list[Recorded] = [
        (START_NS, topic, 'camera_info', camera_info_message(START_NS, focal_px))
        for topic, focal_px in infos.items()
    ]
    recorded: list[Recorded] = [
        (stamp_ns, '/camera/image_raw', 'image', image_message(stamp_ns, pixels))
        for stamp_ns, pixels in images()
    ]
    return write_bag(folder, calibrations + recorded)


def images() -> Iterator[tuple[int, Any]]:
    scene = picture(1, 24, 200)
    for n in range(20):
        yield START_NS + n * PERIOD_NS, np.ascontiguousarray(scene[:, 3 * n : 3 * n + 64])


def final_heading(bag: Path, folder: Path, **values: Any) -> float:
    config = extended().with_values({f'visual_odometry.{k}': v for k, v in values.items()})
    with open_recording(bag) as recording:
        replay(recording, recording.select(), config, folder, ReplayOptions(progress=False))
    *_, qz, qw = (folder / 'dead_reckoning.tum').read_text().splitlines()[-1].split()
    return 2.0 * math.atan2(float(qz), float(qw)) - math.pi / 2.0


@pytest.mark.parametrize(('infos', 'fov_deg'), [
    ({'/camera/camera_info': 16.0}, 90.0), ({'/other/camera_info': 16.0}, None),
    ({'/camera/camera_info': 0.0}, None), ({'/camera/camera_info': math.nan}, None), ({}, None),
])
def test_calibration_comes_from_the_image_topic_namespace(
    infos: dict[str, float], fov_deg: float | None, tmp_path: Path
) -> None:
    bag = write(tmp_path / 'bag', infos)
    with open_recording(bag) as recording:
        found = recording.calibration(recording.select())
    assert (found and found[:2]) == (None if fov_deg is None else (16.0, 32))
    heading = final_heading(bag, tmp_path / 'a')
    expected = final_heading(
        bag, tmp_path / 'b', camera_fov_deg=fov_deg or 50.0, fov_from_camera_info=False
    )
    assert heading == expected != 0.0
