# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Topics with the robot's pose on the map: once per stamp, and corrections of it."""

from __future__ import annotations

import math

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.node import Node
from std_msgs.msg import String

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.pose_covariance import Matrix
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.mapping import Correction
from ratslam_ros.ros.convert import covariance_of, header_of, pose_message
from ratslam_ros.ros.qos import RESULT, STATE

LEAST_CORRECTION_M = LEAST_CORRECTION_RAD = 1e-3
"""Smaller changes are not reported: they are part of the next pose."""


class PosePublisher:
    """Publishes poses and corrections."""

    def __init__(self, node: Node) -> None:
        self._pose = node.create_publisher(PoseStamped, 'experience_map/pose', STATE)
        self._with_covariance = node.create_publisher(
            PoseWithCovarianceStamped, 'experience_map/pose_with_covariance', STATE
        )
        self._correction = node.create_publisher(String, Correction.TOPIC, RESULT)

    def publish(self, stamp_ns: int, frame_id: str, pose: Pose, covariance: Matrix) -> None:
        """Publish the pose at an odometry message.

        Args:
            stamp_ns: stamp of the message.
            frame_id: frame of the map.
            pose: pose of the robot in this frame.
            covariance: (3, 3) of the pose in this frame.
        """
        header, message = header_of(stamp_ns, frame_id), pose_message(pose)
        self._pose.publish(PoseStamped(header=header, pose=message))
        if self._with_covariance.get_subscription_count() > 0:
            both = PoseWithCovarianceStamped(header=header)
            both.pose.pose = message
            both.pose.covariance = covariance_of(covariance)
            self._with_covariance.publish(both)

    def publish_correction(self, correction: Correction) -> None:
        """Publish a correction, unless it is too small to matter."""
        before, after = correction.before.pose, correction.after.pose
        if (
            math.dist(before[:2], after[:2]) >= LEAST_CORRECTION_M
            or abs(wrap(after.heading_rad - before.heading_rad)) >= LEAST_CORRECTION_RAD
        ):
            self._correction.publish(String(data=encode(correction)))
