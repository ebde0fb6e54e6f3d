# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated runs as files: a rosbag2 recording that ROS can play, and its truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from ratslam_ros.errors import UnusableInput
from ratslam_ros.simulator.camera import CameraOptions
from ratslam_ros.simulator.robot import Odometry, Pose
from ratslam_ros.simulator.simulation import ImageSample, Simulation, SimulationOptions
from ratslam_ros.simulator.world import World

IMAGE_TOPIC = '/camera/image/compressed'
CAMERA_INFO_TOPIC = '/camera/camera_info'
ODOMETRY_TOPIC = '/odom'
# Not a nav_msgs/Odometry: a recording should have one odometry only, or which one to use is a
# question that every tool has to ask.
TRUTH_TOPIC = '/ground_truth/pose'
TRUTH_FILE = 'truth.tum'

ODOM_FRAME, ROBOT_FRAME, CAMERA_FRAME, WORLD_FRAME = 'odom', 'base_link', 'camera', 'world'
JPEG_QUALITY = 85

_TOPICS = {
    IMAGE_TOPIC: 'sensor_msgs/msg/CompressedImage',
    CAMERA_INFO_TOPIC: 'sensor_msgs/msg/CameraInfo',
    ODOMETRY_TOPIC: 'nav_msgs/msg/Odometry',
    TRUTH_TOPIC: 'geometry_msgs/msg/PoseStamped',
}


@dataclass(frozen=True)
class SimulatedRun:
    """A recording that was written, and what is true about it.

    recording: the folder, which rosbag2 plays; truth: a TUM file in it
    truth_stamp_ns: (n,) int64; truth_pose: (n, 3) x_m, y_m, heading_rad at each odometry stamp
    odometry_pose: (n, 3) likewise, as the wheels believe, from (0, 0, 0)
    """

    recording: Path
    truth: Path
    world: World
    duration_s: float
    images: int
    truth_stamp_ns: NDArray[np.int64]
    truth_pose: NDArray[np.float64]
    odometry_pose: NDArray[np.float64]


def write_recording(
    path: str | Path,
    seed: int,
    duration_s: float | None = None,
    options: SimulationOptions | None = None,
) -> SimulatedRun:
    """Simulate a run and write it as a rosbag2 folder (mcap) with the truth beside the messages.

    The same seed gives the same bytes, for a folder of the same name.
    """
    path = Path(path)
    if path.exists():
        raise UnusableInput(f'{path} exists already: choose another folder or remove it')
    options = options or SimulationOptions()
    simulation = Simulation(seed, duration_s, options)
    messages = _Messages(options.camera)
    stamps_ns: list[int] = []
    poses: list[tuple[Pose, Pose]] = []
    images = 0
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Connection] = {
            topic: writer.add_connection(topic, type_name, typestore=messages.store)
            for topic, type_name in _TOPICS.items()
        }

        def write(topic: str, stamp_ns: int, message: Any) -> None:
            data = messages.store.serialize_cdr(message, _TOPICS[topic])
            writer.write(connections[topic], stamp_ns, data)

        for sample in simulation:
            stamp_ns = sample.stamp_ns
            if isinstance(sample, ImageSample):
                images += 1
                write(IMAGE_TOPIC, stamp_ns, messages.image(stamp_ns, sample.image))
                write(CAMERA_INFO_TOPIC, stamp_ns, messages.camera_info(stamp_ns))
            else:
                stamps_ns.append(stamp_ns)
                poses.append((sample.truth, sample.odometry.pose))
                write(TRUTH_TOPIC, stamp_ns, messages.truth(stamp_ns, sample.truth))
                write(ODOMETRY_TOPIC, stamp_ns, messages.odometry(stamp_ns, sample.odometry))
    truth_path = path / TRUTH_FILE
    truth_path.write_text(
        ''.join(tum_line(at_ns, truth) for at_ns, (truth, _) in zip(stamps_ns, poses, strict=True))
    )
    truth_pose, odometry_pose = (
        np.array([(pair[k].x_m, pair[k].y_m, pair[k].heading_rad) for pair in poses])
        for k in (0, 1)
    )
    return SimulatedRun(
        path,
        truth_path,
        simulation.world,
        (stamps_ns[-1] - stamps_ns[0]) / 1e9,
        images,
        np.array(stamps_ns, np.int64),
        truth_pose,
        odometry_pose,
    )


def tum_line(stamp_ns: int, pose: Pose) -> str:
    """Format a pose as a line of a TUM file: t x y z qx qy qz qw."""
    sec, nanosec = divmod(stamp_ns, 10**9)
    qz, qw = math.sin(pose.heading_rad / 2), math.cos(pose.heading_rad / 2)
    return f'{sec}.{nanosec:09d} {pose.x_m:.9f} {pose.y_m:.9f} 0 0 0 {qz:.9f} {qw:.9f}\n'


class _Messages:
    """Makes ROS messages of samples."""

    def __init__(self, camera: CameraOptions | None) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)
        self._types = self.store.types
        self._camera = camera

    def _make(self, name: str, *values: Any) -> Any:
        return self._types[name](*values)

    def _header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self._make('builtin_interfaces/msg/Time', *divmod(stamp_ns, 10**9))
        return self._make('std_msgs/msg/Header', stamp, frame)

    def _vector(self, x: float, y: float, z: float) -> Any:
        return self._make('geometry_msgs/msg/Vector3', x, y, z)

    def _pose(self, pose: Pose) -> Any:
        half_rad = pose.heading_rad / 2
        return self._make(
            'geometry_msgs/msg/Pose',
            self._make('geometry_msgs/msg/Point', pose.x_m, pose.y_m, 0.0),
            self._make(
                'geometry_msgs/msg/Quaternion', 0.0, 0.0, math.sin(half_rad), math.cos(half_rad)
            ),
        )

    def image(self, stamp_ns: int, image: NDArray[np.uint8]) -> Any:
        _, jpeg = cv2.imencode('.jpg', image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        return self._make(
            _TOPICS[IMAGE_TOPIC],
            self._header(stamp_ns, CAMERA_FRAME),
            'mono8; jpeg compressed ',  # as image_transport spells it
            jpeg.reshape(-1),
        )

    def camera_info(self, stamp_ns: int) -> Any:
        camera = self._camera
        assert camera is not None  # it has taken an image
        focal, centre_x, centre_y = camera.focal_px, camera.width / 2, camera.height / 2
        return self._make(
            _TOPICS[CAMERA_INFO_TOPIC],
            self._header(stamp_ns, CAMERA_FRAME),
            camera.height,
            camera.width,
            'plumb_bob',
            np.zeros(5),
            np.array([focal, 0.0, centre_x, 0.0, focal, centre_y, 0.0, 0.0, 1.0]),
            np.eye(3).reshape(-1),
            np.array([focal, 0, centre_x, 0, 0, focal, centre_y, 0, 0, 0, 1.0, 0]),
            0,
            0,
            self._make('sensor_msgs/msg/RegionOfInterest', 0, 0, 0, 0, False),
        )

    def odometry(self, stamp_ns: int, odometry: Odometry) -> Any:
        twist = self._make(
            'geometry_msgs/msg/Twist',
            self._vector(odometry.speed_mps, 0.0, 0.0),
            self._vector(0.0, 0.0, odometry.turn_rate_radps),
        )
        unknown = np.zeros(36)
        return self._make(
            _TOPICS[ODOMETRY_TOPIC],
            self._header(stamp_ns, ODOM_FRAME),
            ROBOT_FRAME,
            self._make(
                'geometry_msgs/msg/PoseWithCovariance', self._pose(odometry.pose), unknown
            ),
            self._make('geometry_msgs/msg/TwistWithCovariance', twist, unknown),
        )

    def truth(self, stamp_ns: int, pose: Pose) -> Any:
        header = self._header(stamp_ns, WORLD_FRAME)
        return self._make(_TOPICS[TRUTH_TOPIC], header, self._pose(pose))
