# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The field of view that visual odometry needs, from the camera_info of a recording."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import PERIOD_NS, START_NS, image_message, picture
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from ratslam_ros.core.config import Config
from ratslam_ros.recordings import open_recording
from ratslam_ros.replay import ReplayOptions, replay

IMAGE, INFO = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CameraInfo'


def info(store: Any, focal_px: float) -> Any:
    types = store.types
    time = types['builtin_interfaces/msg/Time'](*divmod(START_NS, 10**9))
    k = np.zeros(9)
    k[0] = focal_px
    return types[INFO](
        types['std_msgs/msg/Header'](time, 'camera'), 24, 32, '', np.zeros(0), k, np.zeros(9),
        np.zeros(12), 0, 0, types['sensor_msgs/msg/RegionOfInterest'](0, 0, 0, 0, False),
    )  # fmt: skip


def write(folder: Path, infos: dict[str, float]) -> Path:
    """Write a bag of images, with camera_info on topics of its own."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, focal_px in infos.items():
            connection = writer.add_connection(topic, INFO, typestore=store)
            writer.write(connection, START_NS, store.serialize_cdr(info(store, focal_px), INFO))
        connection = writer.add_connection('/camera/image_raw', IMAGE, typestore=store)
        for stamp_ns, pixels in images():
            message = image_message(stamp_ns, pixels)
            writer.write(connection, stamp_ns, store.serialize_cdr(message, IMAGE))
    return folder


def images() -> Iterator[tuple[int, Any]]:
    scene = picture(1, 24, 200)
    for n in range(20):
        yield START_NS + n * PERIOD_NS, np.ascontiguousarray(scene[:, 3 * n : 3 * n + 64])


def final_heading(bag: Path, folder: Path, **values: Any) -> float:
    config = Config().with_values({f'visual_odometry.{k}': v for k, v in values.items()})
    with open_recording(bag) as recording:
        replay(recording, recording.select(), config, folder, ReplayOptions(progress=False))
    *_, qz, qw = (folder / 'dead_reckoning.tum').read_text().splitlines()[-1].split()
    return 2.0 * math.atan2(float(qz), float(qw)) - math.pi / 2.0


@pytest.mark.parametrize(('infos', 'fov_deg'), [
    ({'/camera/camera_info': 16.0}, 90.0), ({'/other/camera_info': 16.0}, None),
    ({'/camera/camera_info': 0.0}, None), ({'/camera/camera_info': math.nan}, None), ({}, None),
])  # fmt: skip
def test_calibration_is_that_of_the_images_camera(
    infos: dict[str, float], fov_deg: float | None, tmp_path: Path
) -> None:
    bag = write(tmp_path / 'bag', infos)
    with open_recording(bag) as recording:
        found = recording.calibration(recording.select())
    assert found == (None if fov_deg is None else (16.0, 32))
    turned = final_heading(bag, tmp_path / 'a')
    expected = final_heading(
        bag, tmp_path / 'b', camera_fov_deg=fov_deg or 50.0, fov_from_camera_info=False
    )
    assert turned == expected != 0.0
