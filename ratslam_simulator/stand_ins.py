# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated recordings in the formats of the data sets of Ball et al. (2013).

They stand in for data that cannot be redistributed: ROS 1 bags with its topics, message types,
image sizes and rates. The robot tours the office of the demo, at another scale.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from rosbags.rosbag1 import Writer
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnusableInput
from ratslam_simulator.camera import CameraOptions
from ratslam_simulator.office_tour import OfficeTour
from ratslam_simulator.recording import (
    IMAGE_TOPIC,
    ODOMETRY_TOPIC,
    TRUTH_FILE,
    TRUTH_TOPIC,
    RecordingWriter,
)
from ratslam_simulator.samples import ImageSample, OdometrySample
from ratslam_simulator.simulation import SimulationOptions


@dataclass(frozen=True)
class DataSet:
    """Format of a data set.

    Attributes:
        topics: topics of the simulator and of the data set; others are left out.
        camera: its camera.
        scale: lengths relative to the office.
        image_topic: the topic to replay, if the data set has several with images.
    """

    topics: Mapping[str, str]
    camera: CameraOptions
    scale: float
    image_topic: str | None = None


DATA_SETS = {
    # Topics and types: listings of the bag (docs/experiments.md), which has as many images as
    # odometry messages. Size and rate are not known; the preset uses the upper 150 rows.
    'irat': DataSet(
        {
            IMAGE_TOPIC: '/irat_red/camera/image/compressed', ODOMETRY_TOPIC: '/irat_red/odom',
            TRUTH_TOPIC: '/overhead/pose',
        },
        CameraOptions(width=320, height=240, fov_deg=80.0, rate_hz=20), 0.1,
        '/irat_red/camera/image/compressed',
    ),
    # Rate: Milford and Wyeth (2008). Size and field of view: the preset.
    'stlucia': DataSet(
        {IMAGE_TOPIC: '/stlucia/camera/image/compressed'},
        CameraOptions(width=640, height=480, fov_deg=53.0, rate_hz=10), 20.0,
    ),
    # It is only known that panoramas and odometry are recorded.
    'newcollege': DataSet(
        {IMAGE_TOPIC: '/newcollege/camera/image/compressed', ODOMETRY_TOPIC: '/newcollege/odom'},
        CameraOptions(width=512, height=128, fov_deg=360.0, rate_hz=5), 2.0,
    ),
}
"""Preset -> format of its data set."""


def write_stand_in(
    path: str | Path, name: str, seed: int = 1, duration_s: float | None = None
) -> Path:
    """Write a bag in the format of a data set, and the truth beside it.

    Args:
        path: the bag to write, with suffix ``.bag``.
        name: key of ``DATA_SETS``.
        seed: seed of the simulation.
        duration_s: simulated time; None for the whole tour, about seven minutes.

    Returns:
        The TUM file of the truth: the bag's name with suffix ``.tum``.

    Raises:
        UnusableInput: the bag exists.
    """
    path, data_set = Path(path), DATA_SETS[name]
    store, ros1 = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS1_NOETIC)
    if path.exists():
        raise UnusableInput(f'{path} exists already: choose another name or remove it')
    options = SimulationOptions(camera=data_set.camera, laser=None)
    with tempfile.TemporaryDirectory() as folder:
        simulated = Path(folder) / 'recording'
        with RecordingWriter(simulated, options) as writer:
            for sample in OfficeTour(seed, duration_s, options):
                writer.write(_scaled(sample, data_set.scale))
        with Reader(simulated) as reader, Writer(path) as bag:
            written = {
                connection.id: bag.add_connection(
                    data_set.topics[connection.topic], connection.msgtype, typestore=ros1
                )
                for connection in reader.connections if connection.topic in data_set.topics
            }
            for connection, stamp_ns, data in reader.messages():
                if connection.id in written:
                    message = store.cdr_to_ros1(data, connection.msgtype)
                    bag.write(written[connection.id], stamp_ns, message)
        truth = path.with_suffix('.tum')
        truth.write_bytes((simulated / TRUTH_FILE).read_bytes())
    return truth


def _scaled(sample: ImageSample | OdometrySample, scale: float) -> ImageSample | OdometrySample:
    """Return a sample of a robot and floor of another scale."""
    if isinstance(sample, ImageSample):
        return sample
    reading = sample.odometry
    return replace(
        sample, truth=_scaled_pose(sample.truth, scale),
        odometry=replace(
            reading, pose=_scaled_pose(reading.pose, scale), speed_mps=scale * reading.speed_mps
        ),
    )


def _scaled_pose(pose: Pose, scale: float) -> Pose:
    return Pose(scale * pose.x_m, scale * pose.y_m, pose.heading_rad)
