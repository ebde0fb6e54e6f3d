# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of simulated runs: a rosbag2 folder and the true trajectory."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnusableInput
from ratslam_ros.results.trajectory import tum_line
from ratslam_simulator.office_tour import OfficeTour
from ratslam_simulator.robot import OdometryReading
from ratslam_simulator.samples import ImageSample, OdometrySample, Sample, ScanSample
from ratslam_simulator.simulation import SimulationOptions
from ratslam_simulator.world import World

IMAGE_TOPIC = '/camera/image/compressed'
CAMERA_INFO_TOPIC = '/camera/camera_info'
ODOMETRY_TOPIC = '/odom'
# A PoseStamped, not an Odometry: with two odometry topics, tools could not choose one themselves.
TRUTH_TOPIC = '/ground_truth/pose'
SCAN_TOPICS = '/scan', '/scan_rear'
TF_STATIC_TOPIC = '/tf_static'
TRUTH_FILE = 'truth.tum'

ODOM_FRAME, ROBOT_FRAME, CAMERA_FRAME, WORLD_FRAME = 'odom', 'base_link', 'camera', 'world'
LASER_FRAMES = 'laser', 'laser_rear'
JPEG_QUALITY = 85

_TOPICS = {
    IMAGE_TOPIC: 'sensor_msgs/msg/CompressedImage',
    CAMERA_INFO_TOPIC: 'sensor_msgs/msg/CameraInfo',
    ODOMETRY_TOPIC: 'nav_msgs/msg/Odometry',
    TRUTH_TOPIC: 'geometry_msgs/msg/PoseStamped',
}
_SCAN, _TRANSFORMS = 'sensor_msgs/msg/LaserScan', 'tf2_msgs/msg/TFMessage'


@dataclass(frozen=True)
class SimulatedRun:
    """A written recording and its ground truth.

    recording: the rosbag2 folder; truth: a TUM file in it
    truth_stamp_ns: (n,) int64, the odometry stamps
    truth_pose: (n, 3) x_m, y_m, heading_rad, the true poses at these stamps
    odometry_pose: (n, 3), the poses of the wheel odometry, which starts at (0, 0, 0)
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
    report: Callable[[float], None] = lambda elapsed_s: None,
) -> SimulatedRun:
    """Simulate a tour of the office and write it as a rosbag2 folder (mcap) with its truth.

    The same seed gives the same bytes if the folder has the same name.

    Args:
        path: folder to create.
        seed: seed of the simulation.
        duration_s: simulated time; None for the whole tour.
        options: world, robot and camera; the laser is left out.
        report: called with the simulated time in s after each sample.

    Raises:
        UnusableInput: the path exists.
    """
    options = replace(options or SimulationOptions(), laser=None)
    tour = OfficeTour(seed, duration_s, options)
    odometry: list[Pose] = []
    images = 0
    with RecordingWriter(path, options) as writer:
        for sample in tour:
            writer.write(sample)
            report(tour.elapsed_s)
            if isinstance(sample, ImageSample):
                images += 1
            else:
                odometry.append(sample.odometry.pose)
    stamps_ns = [stamp_ns for stamp_ns, _ in writer.truth]
    return SimulatedRun(
        writer.path,
        writer.path / TRUTH_FILE,
        tour.world,
        (stamps_ns[-1] - stamps_ns[0]) / 1e9,
        images,
        np.array(stamps_ns, np.int64),
        _rows(truth for _, truth in writer.truth),
        _rows(odometry),
    )


class RecordingWriter:
    """Context manager that writes samples to a rosbag2 folder, and the truth as a TUM file.

    Attributes:
        path: the folder.
        truth: stamp_ns and true pose at each odometry sample that was written.
    """

    def __init__(self, path: str | Path, options: SimulationOptions) -> None:
        """Prepare to write samples of a robot with these options.

        Raises:
            UnusableInput: the path exists.
        """
        self.path = Path(path)
        if self.path.exists():
            raise UnusableInput(f'{path} exists already: choose another folder or remove it')
        self.truth: list[tuple[int, Pose]] = []
        self._messages = _Messages(options)
        scan_topics = SCAN_TOPICS[: len(options.lasers)]
        self._topics = {**_TOPICS, **dict.fromkeys(scan_topics, _SCAN)}
        if scan_topics:
            self._topics[TF_STATIC_TOPIC] = _TRANSFORMS
        self._writer = Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
        self._connections: dict[str, Connection] = {}
        self._has_mount = False

    def __enter__(self) -> Self:
        self._writer.open()
        store = self._messages.store
        for topic, type_name in self._topics.items():
            self._connections[topic] = self._writer.add_connection(
                topic, type_name, typestore=store
            )
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()
        (self.path / TRUTH_FILE).write_text(
            ''.join(tum_line(stamp_ns, pose) for stamp_ns, pose in self.truth)
        )

    def write(self, sample: Sample) -> None:
        """Write the messages of a sample, except sonars, with its truth if it is odometry."""
        stamp_ns, messages = sample.stamp_ns, self._messages
        if isinstance(sample, ImageSample):
            self._write(IMAGE_TOPIC, stamp_ns, messages.image(stamp_ns, sample.image))
            self._write(CAMERA_INFO_TOPIC, stamp_ns, messages.camera_info(stamp_ns))
        elif isinstance(sample, ScanSample):
            if not self._has_mount:
                self._has_mount = True
                self._write(TF_STATIC_TOPIC, stamp_ns, messages.laser_mounts(stamp_ns))
            self._write(SCAN_TOPICS[sample.laser], stamp_ns, messages.scan(sample))
        elif isinstance(sample, OdometrySample):
            self.truth.append((stamp_ns, sample.truth))
            self._write(TRUTH_TOPIC, stamp_ns, messages.truth(stamp_ns, sample.truth))
            self._write(ODOMETRY_TOPIC, stamp_ns, messages.odometry(stamp_ns, sample.odometry))

    def _write(self, topic: str, stamp_ns: int, message: Any) -> None:
        data = self._messages.store.serialize_cdr(message, self._topics[topic])
        self._writer.write(self._connections[topic], stamp_ns, data)


def _rows(poses: Iterable[Pose]) -> NDArray[np.float64]:
    return np.array(list(poses))


class _Messages:
    """Converts samples to ROS messages."""

    def __init__(self, options: SimulationOptions) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)
        self._types = self.store.types
        self._camera, self._lasers = options.camera, options.lasers

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
            'mono8; jpeg compressed ',  # the format string of image_transport
            jpeg.reshape(-1),
        )

    def camera_info(self, stamp_ns: int) -> Any:
        camera = self._camera
        assert camera is not None  # there is an image
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

    def odometry(self, stamp_ns: int, odometry: OdometryReading) -> Any:
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
            self._make('geometry_msgs/msg/PoseWithCovariance', self._pose(odometry.pose), unknown),
            self._make('geometry_msgs/msg/TwistWithCovariance', twist, unknown),
        )

    def truth(self, stamp_ns: int, pose: Pose) -> Any:
        header = self._header(stamp_ns, WORLD_FRAME)
        return self._make(_TOPICS[TRUTH_TOPIC], header, self._pose(pose))

    def scan(self, sample: ScanSample) -> Any:
        laser = self._lasers[sample.laser]
        return self._make(
            _SCAN,
            self._header(sample.stamp_ns, LASER_FRAMES[sample.laser]),
            laser.first_rad,
            laser.first_rad + laser.step_rad * (laser.beams - 1),
            laser.step_rad,
            0.0,
            1.0 / laser.rate_hz,
            0.0,
            laser.range_max_m,
            sample.ranges_m,
            np.empty(0, np.float32),
        )

    def laser_mounts(self, stamp_ns: int) -> Any:
        """Return the transforms of the lasers to the robot."""
        header = self._header(stamp_ns, ROBOT_FRAME)
        return self._make(
            _TRANSFORMS,
            [
                self._make(
                    'geometry_msgs/msg/TransformStamped', header, frame,
                    self._transform(laser.mount),
                )
                for frame, laser in zip(LASER_FRAMES, self._lasers, strict=False)
            ],
        )

    def _transform(self, pose: Pose) -> Any:
        return self._make(
            'geometry_msgs/msg/Transform', self._vector(pose.x_m, pose.y_m, 0.0),
            self._pose(pose).orientation,
        )
