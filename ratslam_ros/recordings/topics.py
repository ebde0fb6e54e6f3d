# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The topics of a recording: their types, and the selection of those to read."""

from __future__ import annotations

from dataclasses import dataclass

RAW_IMAGE = 'sensor_msgs/msg/Image'
COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
ODOMETRY = 'nav_msgs/msg/Odometry'
LASER_SCAN = 'sensor_msgs/msg/LaserScan'
STRING = 'std_msgs/msg/String'
TF = 'tf2_msgs/msg/TFMessage'
ROS1_TF = 'tf/msg/tfMessage'
"""Type of /tf in recordings of the first years of ROS 1, with the same content."""
# Types of topics in recordings that hold no ROS messages.
VIDEO, IMAGE_FILES, TABLE = 'video', 'image files', 'table'

IMAGE_TYPES = frozenset({RAW_IMAGE, COMPRESSED_IMAGE, VIDEO, IMAGE_FILES})
ODOMETRY_TYPES = frozenset({ODOMETRY, TABLE})
SCAN_TYPES = frozenset({LASER_SCAN})


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a recording."""

    name: str
    type: str
    count: int | None
    """Number of messages; None if counting them requires a scan of the recording."""
    problem: str | None = None
    """Reason why the messages cannot be decoded; None if they can."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The topics to read from a recording, each None if not used.

    Without ``odom_topic`` the motion is estimated from the images (visual odometry).
    ``scan_topic`` names several lasers separated by commas, in the order of their numbers.
    """

    image_topic: str | None
    odom_topic: str | None
    template_topic: str | None
    scan_topic: str | None = None
    notices: tuple[str, ...] = ()
    """Messages for the user about choices that the selection made."""

    @property
    def scan_topics(self) -> tuple[str, ...]:
        """Topic of each laser."""
        return () if self.scan_topic is None else tuple(self.scan_topic.split(','))

    @property
    def topics(self) -> frozenset[str]:
        """Names of all selected topics."""
        names = (self.image_topic, self.odom_topic, self.template_topic, *self.scan_topics)
        return frozenset(name for name in names if name is not None)
