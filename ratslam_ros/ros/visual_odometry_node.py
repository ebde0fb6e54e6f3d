# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node of the visual odometry: image -> odom."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo
from tf2_msgs.msg import TFMessage

from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.vision.visual_odometry import field_of_view_deg
from ratslam_ros.pipeline.commands import SetFieldOfView
from ratslam_ros.pipeline.live_stages import LiveVisualOdometry
from ratslam_ros.pipeline.pipeline import Pipeline
from ratslam_ros.ros.convert import (
    UNKNOWN_SCALE_VARIANCE,
    covariance_of,
    header_of,
    pose_message,
    transform,
)
from ratslam_ros.ros.image_node import ImageNode, Message
from ratslam_ros.ros.inputs import publisher_count
from ratslam_ros.ros.qos import RESULT, STATE

TWIST_VARIANCES = (UNKNOWN_SCALE_VARIANCE, 1e-9, 1e-9, 1e-9, 1e-9, 0.01)
"""Variances of the linear, (m/s)^2, and angular, (rad/s)^2, velocity along x, y and z.

The speed is in arbitrary units, and the motion is planar."""
CAMERA_INFO_WAIT_S = 2.0
"""Time for which images wait for the field of view from camera_info."""


class VisualOdometryNode(ImageNode):
    """Estimates the motion between images; publishes ``odom`` for each image but the first."""

    SECTION = 'visual_odometry'
    _stage: LiveVisualOdometry

    def connect(self, pipeline: Pipeline) -> None:
        """Publish the odometry."""
        self._publisher = self.create_publisher(OdometryMessage, 'odom', RESULT)
        self._tf = self.create_publisher(TFMessage, '/tf', STATE)
        self._need_not_wait = threading.Event()
        """Set when the field of view is known, or will not be."""
        if self.section.fov_from_camera_info:
            self.create_subscription(
                CameraInfo, 'camera_info', self._on_camera_info, qos_profile_sensor_data
            )
        pipeline.observe('odometry', self._publish)

    @property
    def _must_wait(self) -> bool:
        return (
            self.section.fov_from_camera_info and self._stage.fov_deg is None
            and not self._need_not_wait.is_set() and publisher_count(self, 'camera_info') > 0
        )

    def _process_past(self, message: Message) -> None:
        """Process an image; the executor's thread, which receives camera_info, does not wait."""
        if self._must_wait or self.is_busy:
            self._on_image(message)
        else:
            self._process_message(message)

    def _process_message(self, message: Message) -> None:
        """Process an image, once the field of view is known if camera_info has a publisher."""
        if self._must_wait and not self._need_not_wait.wait(CAMERA_INFO_WAIT_S):
            self._need_not_wait.set()
            self.diagnostics.warn(
                'no field of view came from camera_info within '
                f'{CAMERA_INFO_WAIT_S:g} s: camera_fov_deg is used',
            )
        super()._process_message(message)

    def close(self) -> None:
        """Process the current image, drop the queued ones, and stop."""
        self._need_not_wait.set()
        super().close()

    def _on_camera_info(self, message: CameraInfo) -> None:
        focal_px, width_px = float(message.k[0]), int(message.width)
        if self._stage.fov_deg is not None:
            return
        if not (math.isfinite(focal_px) and focal_px > 0.0 and width_px > 0):
            self.diagnostics.warn(
                f'camera_info has a focal length of {focal_px} px at a width of '
                f'{width_px} px: the camera is not calibrated; camera_fov_deg is used'
            )
            self._need_not_wait.set()
            return
        fov_deg = field_of_view_deg(focal_px, width_px)
        self.get_logger().info(f'field of view from camera_info: {fov_deg:.2f} deg')
        self.host.command(SetFieldOfView(fov_deg))
        self._need_not_wait.set()

    def _publish(self, stamp_ns: int, received: Odometry) -> None:
        odometry = self._stage.estimate
        assert odometry is not None
        p, twist = self.section, odometry.twist
        message = OdometryMessage(
            header=header_of(odometry.stamp_ns, p.odom_frame), child_frame_id=p.base_frame
        )
        message.pose.pose = pose_message(odometry.pose)
        on_plane = self._stage.covariance.on_map(odometry.pose.heading_rad)
        message.pose.covariance = covariance_of(on_plane, 1e-9)
        message.twist.twist.linear.x = twist.linear_x_mps
        message.twist.twist.angular.z = twist.angular_z_radps
        message.twist.covariance = np.diag(TWIST_VARIANCES).reshape(-1)
        self.host.map.publish(self._publisher, message)
        self.host.heard('odometry', message)
        if p.publish_tf and not self.host.map.is_replaying:
            frames = transform(odometry.stamp_ns, p.odom_frame, p.base_frame, odometry.pose)
            self._tf.publish(TFMessage(transforms=[frames]))

    def _diagnostic_values(self) -> dict[str, Any]:
        fov_deg, source = self._stage.fov_deg, 'camera_info'
        if fov_deg is None:
            fov_deg, source = self.section.camera_fov_deg, 'camera_fov_deg'
        return {**super()._diagnostic_values(), 'field_of_view': f'{fov_deg:.2f} deg ({source})'}
