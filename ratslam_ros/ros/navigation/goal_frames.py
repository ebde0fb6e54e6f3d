# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses of goals, given in any frame of the robot, on the map."""

from __future__ import annotations

import math

from geometry_msgs.msg import PoseStamped

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.errors import UnreachableGoal
from ratslam_ros.ros.convert import planar_pose
from ratslam_ros.ros.mapping.odometry_frames import OdometryFrames


def pose_on_map(
    message: PoseStamped, map_frame: str, frames: OdometryFrames, here: Pose | None,
    odom_pose: Pose,
) -> Pose:
    """Transform a pose to the map's frame.

    Args:
        message: pose in the frame of the map, the odometry or the robot; no frame: the map's.
        map_frame: the frame of the map.
        frames: frames of the odometry.
        here: pose of the robot on the map; None: unknown.
        odom_pose: pose of the robot in the frame of the odometry.

    Raises:
        UnreachableGoal: it is not finite, or its frame has no transform to the map.
    """
    frame = message.header.frame_id.lstrip('/')
    pose = planar_pose(message.pose)
    if not all(math.isfinite(value) for value in pose):
        raise UnreachableGoal('its position or orientation is not finite')
    if frame in ('', map_frame):
        return pose
    if here is not None and frame == frames.base:
        return composed(here, pose)
    if here is not None and frame == frames.odom:
        return composed(composed(here, inverse(odom_pose)), pose)
    known = f'{map_frame}, {frames.odom} or {frames.base}'
    is_known = frame in (map_frame, frames.odom, frames.base)
    reason = 'the pose of the robot on the map is unknown' if is_known else f'expected {known}'
    raise UnreachableGoal(f'there is no transform from {frame!r} to {map_frame!r}: {reason}')
