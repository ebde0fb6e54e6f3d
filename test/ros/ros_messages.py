# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that tests send to nodes, and the type of the fixture ``world``."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from helpers import START_NS, picture, template_text
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image, LaserScan
from std_msgs.msg import String

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.pose_cells.map_action import Action, MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.mapping import ActionPayload
from ratslam_ros.ros.convert import header_of, pose_message

MakeWorld = Callable[..., Any]
ORIGIN = Pose(0.0, 0.0, 0.0)


def image(stamp_ns: int, seed: int = 0, **changed: Any) -> Image:
    """Return an image of noise, with some fields replaced."""
    pixels = picture(seed, 24, 32)
    fields = {
        'header': header_of(stamp_ns, 'camera'), 'height': 24, 'width': 32, 'encoding': 'mono8',
        'is_bigendian': 0, 'step': 32, 'data': pixels.tobytes(),
    }
    return Image(**{**fields, **changed})


def odometry(
    stamp_ns: int, speed: float = 0.0, turn_rate: float = 0.0, pose: Pose = ORIGIN,
    frames: tuple[str, str] = ('odom', 'base_link'),
) -> Odometry:
    message = Odometry(header=header_of(stamp_ns, frames[0]), child_frame_id=frames[1])
    message.twist.twist.linear.x, message.twist.twist.angular.z = speed, turn_rate
    message.pose.pose = pose_message(pose)
    return message


def laser_scan(of: Scan, frame: str = '', **changed: Any) -> LaserScan:
    """Return the message of a scan, with some fields replaced; of those over 180 degrees."""
    fields = {
        'header': header_of(of.stamp_ns, frame), 'angle_min': float(np.float32(of.angle_min_rad)),
        'angle_max': math.pi / 2, 'angle_increment': float(np.float32(of.angle_increment_rad)),
        'range_min': 0.02, 'range_max': 8.0, 'ranges': of.ranges_m.astype(np.float32).tolist(),
    }
    return LaserScan(**{**fields, **changed})


def even_scan(stamp_ns: int, ranges_m: Any) -> Scan:
    """Return a scan over 180 degrees with 181 beams, of one range or one each."""
    ranges = np.broadcast_to(np.float64(ranges_m), 181)
    return Scan(stamp_ns, -math.pi / 2, math.pi / 180, ranges)


def stamped_pose(
    x_m: float, y_m: float, frame: str = 'map', heading_rad: float = 0.0, stamp_ns: int = 0
) -> PoseStamped:
    pose = pose_message(Pose(x_m, y_m, heading_rad))
    return PoseStamped(header=header_of(stamp_ns, frame), pose=pose)


def string(text: str) -> String:
    return String(data=text)


def template(stamp_ns: int, template_id: int, **changes: Any) -> String:
    return String(data=template_text(stamp_ns, template_id, **changes))


def action_text(stamp_ns: int, sequence: int, kind: Action, source: int, target: int) -> str:
    action = MapAction(kind, source, target, max(target, 0), 0.0, Place(1.0, 2.0, 3.0))
    return encode(ActionPayload.of(stamp_ns, sequence, action, START_NS))
