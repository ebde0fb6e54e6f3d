# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The events that a recording yields, one per message."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.images import Image, Pixels


@dataclass(frozen=True, slots=True)
class ImageEvent:
    """An image whose pixels are decoded on demand.

    As in every event, ``stamp_ns`` is the time in the message header and ``log_ns`` the time at
    which the message was recorded. ``KIND`` names what it contains.
    """

    KIND: ClassVar = 'image'
    stamp_ns: int
    log_ns: int
    image: Image

    def grey(self, by: str = 'luma') -> Pixels:
        """Return the grey image as (H, W) uint8; raises UndecodableImage."""
        return self.image.grey(by)

    def bgr(self) -> Pixels:
        """Return the image as (H, W, 3) uint8 in BGR order; raises UndecodableImage."""
        return self.image.bgr()


class Orientation(NamedTuple):
    """An orientation as a quaternion, kept unchanged so that replayed messages are identical."""

    x: float
    y: float
    z: float
    w: float

    @classmethod
    def of_heading(cls, heading_rad: float) -> Self:
        """Return the rotation by a heading about the vertical axis."""
        return cls(0.0, 0.0, math.sin(heading_rad / 2.0), math.cos(heading_rad / 2.0))

    @property
    def heading_rad(self) -> float:
        """Rotation about the vertical axis, counter-clockwise positive, in radians."""
        x, y, z, w = self
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@dataclass(frozen=True, slots=True)
class OdometryEvent:
    """An odometry message: velocities in m/s and rad/s, and the integrated pose in metres."""

    KIND: ClassVar = 'odometry'
    stamp_ns: int
    log_ns: int
    linear_x: float
    angular_z: float
    x: float
    y: float
    orientation: Orientation
    linear_y: float = 0.0

    @property
    def heading_rad(self) -> float:
        """Heading of the pose, counter-clockwise from the x axis, in radians."""
        return self.orientation.heading_rad


@dataclass(frozen=True, slots=True)
class TemplateEvent:
    """A recorded local_view/template message; its JSON text is not validated here."""

    KIND: ClassVar = 'template'
    stamp_ns: int
    log_ns: int
    payload: str


@dataclass(frozen=True, slots=True)
class ScanEvent:
    """The content of a sensor_msgs/LaserScan message; it is not validated here."""

    KIND: ClassVar = 'scan'
    stamp_ns: int
    log_ns: int
    angle_min_rad: float
    angle_increment_rad: float
    range_min_m: float
    range_max_m: float
    ranges_m: NDArray[np.float32]
    frame_id: str = ''
    """Frame of the laser; '' if it is unknown."""
    laser: int = 0
    """Number of the laser: the position of its topic in the selection."""


Event = ImageEvent | OdometryEvent | TemplateEvent | ScanEvent


class LaserFrames(NamedTuple):
    """What a recording tells about the place of a laser on the robot."""

    laser: str
    """Frame of the scans."""
    base: str
    """Frame of the robot: that which the odometry tracks."""
    transforms: tuple[Any, ...]
    """The geometry_msgs/TransformStamped messages, as decoded by rosbags."""


class Calibration(NamedTuple):
    """The calibration of a camera."""

    focal_px: float
    """Focal length along the image's x axis, in pixels."""
    width_px: int
    message: Any
    """The complete sensor_msgs/CameraInfo message, as decoded by rosbags."""
