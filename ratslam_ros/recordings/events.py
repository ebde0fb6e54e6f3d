# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a recording tells, one event at a time."""

from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True)
class OdometryEvent:
    """A motion in m/s and rad/s, and a pose in m and rad, as the odometry believes it."""

    stamp_ns: int
    log_ns: int
    linear_x: float
    angular_z: float
    x: float
    y: float
    heading_rad: float


@dataclass(frozen=True, slots=True)
class TemplateEvent:
    """A recorded local_view/template message: the JSON text, checked by whoever uses it."""

    stamp_ns: int
    log_ns: int
    payload: str


Event = ImageEvent | OdometryEvent | TemplateEvent
