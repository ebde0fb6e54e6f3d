# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a recording tells, one event at a time."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.images import Image, Pixels


@dataclass(frozen=True, slots=True)
class ImageEvent:
    """An image; its pixels are decoded when they are asked for, and not before.

    ``stamp_ns`` is the time in the message's header, ``log_ns`` the recording's own; both are
    integer nanoseconds.
    """

    stamp_ns: int
    log_ns: int
    image: Image

    def grey(self) -> Pixels:
        """Return (H, W) uint8; raises UndecodableImage."""
        return self.image.grey()

    def bgr(self) -> Pixels:
        """Return (H, W, 3) uint8, blue first; raises UndecodableImage."""
        return self.image.bgr()


class Orientation(NamedTuple):
    """A quaternion as in messages, kept as it is: a heading read again is then the same."""

    x: float
    y: float
    z: float
    w: float

    @classmethod
    def of_heading(cls, heading_rad: float) -> Self:
        """Return a turn about the vertical."""
        return cls(0.0, 0.0, math.sin(heading_rad / 2.0), math.cos(heading_rad / 2.0))

    @property
    def heading_rad(self) -> float:
        """The turn about the vertical, counter-clockwise from x."""
        x, y, z, w = self
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@dataclass(frozen=True, slots=True)
class OdometryEvent:
    """A motion in m/s and rad/s, and a pose in m, as the odometry believes it."""

    stamp_ns: int
    log_ns: int
    linear_x: float
    angular_z: float
    x: float
    y: float
    orientation: Orientation

    @property
    def heading_rad(self) -> float:
        """The heading of the pose, counter-clockwise from x."""
        return self.orientation.heading_rad


@dataclass(frozen=True, slots=True)
class TemplateEvent:
    """A recorded local_view/template message: the JSON text, checked by whoever uses it."""

    stamp_ns: int
    log_ns: int
    payload: str


@dataclass(frozen=True, slots=True)
class ScanEvent:
    """A sensor_msgs/LaserScan with the numbers that it holds, checked by whoever uses it."""

    stamp_ns: int
    log_ns: int
    angle_min_rad: float
    angle_increment_rad: float
    range_min_m: float
    range_max_m: float
    ranges_m: NDArray[np.float32]


Event = ImageEvent | OdometryEvent | TemplateEvent | ScanEvent


class Calibration(NamedTuple):
    """A camera's focal length along x and its image's width, both in px, and all that is known."""

    focal_px: float
    width_px: int
    message: Any
    """The sensor_msgs/CameraInfo as rosbags has it."""
