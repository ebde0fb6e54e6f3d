# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of recorded events to ROS messages without loss of precision."""

from __future__ import annotations

import math
from array import array
from typing import Any

from geometry_msgs.msg import Quaternion, TransformStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, LaserScan
from std_msgs.msg import Header, String

from ratslam_ros.core.common.mount import Mount
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnusableInput
from ratslam_ros.images import EncodedImage, Frame, RawImage
from ratslam_ros.messages.json_schema import NS_PER_S
from ratslam_ros.recordings import Event, ImageEvent, OdometryEvent, ScanEvent
from ratslam_ros.ros.convert import header_of, image_message, odometry_of, transform

ODOM_FRAME, BASE_FRAME, LASER_FRAME = 'odom', 'base_link', 'laser'
"""Frames of played odometry, of the robot, and of scans whose recording names none."""


def message_of(event: Event) -> Any:
    """Return the message of an event; nodes read from it the same values as a replay.

    Raises:
        UnusableInput: the stamp does not fit a message: its seconds exceed 32 bits.
    """
    sec = event.stamp_ns // NS_PER_S
    if not -(2**31) <= sec < 2**31:
        raise UnusableInput(
            f'a stamp of {sec} s does not fit a ROS 2 message: expected less than 2^31 s'
        )
    if isinstance(event, ImageEvent):
        return _image(event)
    if isinstance(event, OdometryEvent):
        return _odometry(event)
    if isinstance(event, ScanEvent):
        return _scan(event)
    return String(data=event.payload)


def camera_info(recorded: Any, header: Header) -> CameraInfo:
    """Return the recorded calibration with the header of an image.

    Args:
        recorded: a camera_info message of ROS 1 or ROS 2.
        header: the header of the image.
    """
    fields = {
        name: [float(v) for v in getattr(recorded, name, getattr(recorded, name.upper(), ()))]
        for name in ('d', 'k', 'r', 'p')  # capitals in ROS 1
    }
    return CameraInfo(
        header=header,
        height=int(recorded.height),
        width=int(recorded.width),
        distortion_model=str(recorded.distortion_model),
        binning_x=int(recorded.binning_x),
        binning_y=int(recorded.binning_y),
        **fields,
    )


def _image(event: ImageEvent) -> Image | CompressedImage:
    image = event.image
    if isinstance(image, RawImage):
        recorded = image.message
        return Image(
            header=header_of(event.stamp_ns, str(recorded.header.frame_id)),
            height=int(recorded.height),
            width=int(recorded.width),
            encoding=str(recorded.encoding),
            is_bigendian=int(recorded.is_bigendian),
            step=int(recorded.step),
            data=_bytes(recorded.data),
        )
    if isinstance(image, EncodedImage):
        return CompressedImage(
            header=header_of(event.stamp_ns, ''), format=image.encoding, data=_bytes(image.data)
        )
    assert isinstance(image, Frame)
    return image_message(event.stamp_ns, '', image.pixels)


def _odometry(event: OdometryEvent) -> Odometry:
    message = Odometry(header=header_of(event.stamp_ns, ODOM_FRAME), child_frame_id=BASE_FRAME)
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y = event.x, event.y
    x, y, z, w = event.orientation
    pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
    twist.linear.x, twist.linear.y = event.linear_x, event.linear_y
    twist.angular.z = event.angular_z
    return message


def transform_of(odometry: Odometry) -> TransformStamped | None:
    """Return the transform that a robot publishes along with its odometry.

    None if the pose is not finite.
    """
    planar = odometry_of(odometry)
    if not all(map(math.isfinite, planar.pose)):
        return None
    frames = odometry.header.frame_id, odometry.child_frame_id
    return transform(planar.stamp_ns, *frames, planar.pose)


def mount_of(frame_id: str, mount: Mount, stamp_ns: int) -> TransformStamped:
    """Return the transform of a laser to the robot.

    Args:
        frame_id: frame of its scans, '' if the recording names none.
        mount: where the replay takes the laser to be.
        stamp_ns: stamp of the transform.
    """
    pose = Pose(mount.x_m, mount.y_m, mount.yaw_rad)
    message = transform(stamp_ns, BASE_FRAME, frame_id or LASER_FRAME, pose)
    if mount.is_upside_down:  # turned by 180 degrees about its x axis after the yaw
        q = message.transform.rotation
        message.transform.rotation = Quaternion(x=q.w, y=q.z, z=0.0, w=0.0)
    return message


def _scan(event: ScanEvent) -> LaserScan:
    first_rad, step_rad = event.angle_min_rad, event.angle_increment_rad
    return LaserScan(
        header=header_of(event.stamp_ns, event.frame_id or LASER_FRAME),
        angle_min=first_rad,
        angle_max=first_rad + step_rad * (len(event.ranges_m) - 1),
        angle_increment=step_rad,
        range_min=event.range_min_m,
        range_max=event.range_max_m,
        ranges=array('f', event.ranges_m.tobytes()),
    )


def _bytes(data: Any) -> array[int]:
    """Return bytes as an array, which rclpy accepts without checking each element."""
    out = array('B')
    out.frombytes(data)
    return out
