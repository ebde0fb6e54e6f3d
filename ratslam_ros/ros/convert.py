# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion between ROS messages and the types of core."""

from __future__ import annotations

import array
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, PoseStamped, Quaternion, TransformStamped
from geometry_msgs.msg import Pose as PoseMessage
from nav_msgs.msg import OccupancyGrid, Path
from nav_msgs.msg import Odometry as OdometryMessage
from numpy.typing import NDArray
from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import Header

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose, heading_of, quaternion_of
from ratslam_ros.core.mapping.occupancy import Picture
from ratslam_ros.errors import UnusableInput
from ratslam_ros.limits import MAX_COORDINATE_M
from ratslam_ros.messages.json_schema import NS_PER_S

PLANAR, UPRIGHT = [0, 1, 5], [2, 3, 4]
"""Rows of x, y and yaw, and of z, roll and pitch, in the covariance of a message."""

UNKNOWN_SCALE_VARIANCE = 1e6
"""Variance of a forward speed in arbitrary units, in (m/s)^2."""

NO_POSITIONS = np.empty((0, 2))
"""Positions of an empty route."""

MIN_STEP_M = 1e-6
"""Length below which a step of a route has no heading."""


def stamp_ns(header: Header) -> int:
    """Return a header's stamp in ns; 0, which is no stamp, if it has 10^9 nanoseconds or more."""
    if header.stamp.nanosec >= NS_PER_S:
        return 0
    return int(header.stamp.sec) * NS_PER_S + int(header.stamp.nanosec)


def stamp_of(message: Any) -> int:
    """Return the stamp of a message in ns, of its header or JSON text; 0 if it has none."""
    if hasattr(message, 'header'):
        return stamp_ns(message.header)
    try:
        stamp = json.loads(message.data)['stamp']
        return int(stamp['sec']) * NS_PER_S + int(stamp['nanosec'])
    except (ValueError, KeyError, TypeError, RecursionError):
        return 0  # the node reports malformed messages


def time_of(stamp_ns: int) -> Time:
    """Return a stamp in ns as a message."""
    return Time(sec=stamp_ns // NS_PER_S, nanosec=stamp_ns % NS_PER_S)


def header_of(stamp_ns: int, frame_id: str) -> Header:
    """Return a header with a stamp in ns and a frame."""
    return Header(stamp=time_of(stamp_ns), frame_id=frame_id)


def covariance_of(planar: NDArray[np.float64], upright: float = 0.0) -> NDArray[np.float64]:
    """Return the (36,) covariance of a message: x, y, z, and the rotations about these axes.

    Args:
        planar: (3, 3) of x, y and heading.
        upright: variance of z, roll and pitch. The robot moves in a plane by definition.
    """
    covariance = np.zeros((6, 6))
    covariance[np.ix_(PLANAR, PLANAR)] = planar
    covariance[UPRIGHT, UPRIGHT] = upright
    return covariance.reshape(-1)


def odometry_of(message: OdometryMessage) -> Odometry:
    """Return the stamp, the planar twist and the planar pose of an odometry message."""
    twist = message.twist.twist
    return Odometry(
        stamp_ns(message.header),
        Twist(float(twist.linear.x), float(twist.angular.z), float(twist.linear.y)),
        planar_pose(message.pose.pose),
        scale_known=bool(message.twist.covariance[0] < UNKNOWN_SCALE_VARIANCE),
    )


def planar_pose(message: PoseMessage) -> Pose:
    """Return the planar part of a pose."""
    q = message.orientation
    heading_rad = heading_of(q.x, q.y, q.z, q.w)
    return Pose(float(message.position.x), float(message.position.y), heading_rad)


def route_points(message: Path) -> NDArray[np.float64]:
    """Return the (n, 2) positions of a path in m.

    Raises:
        UnusableInput: one is not finite or too far away.
    """
    positions = [stamped.pose.position for stamped in message.poses]
    points = np.array([(at.x, at.y) for at in positions], np.float64).reshape(-1, 2)
    if not (np.abs(points) <= MAX_COORDINATE_M).all():  # NaN is not
        raise UnusableInput('its positions are not finite or too far away')
    return points


def path_of(
    positions_m: NDArray[np.float64], arrival_s: Sequence[float], stamp_ns: int, frame_id: str
) -> Path:
    """Return a route as a path, each pose heading along it and stamped with its arrival time.

    Args:
        positions_m: (n, 2) positions on the map; n = 0 gives an empty path.
        arrival_s: (n,) expected arrival times after ``stamp_ns``.
        stamp_ns: the current stamp.
        frame_id: the frame of the map.
    """
    path = Path(header=header_of(stamp_ns, frame_id))
    headings = _headings(positions_m) if len(positions_m) else []
    for (x, y), heading, after_s in zip(positions_m.tolist(), headings, arrival_s, strict=True):
        header = header_of(stamp_ns + round(after_s * 1e9), frame_id)
        path.poses.append(PoseStamped(header=header, pose=pose_message(Pose(x, y, heading))))
    return path


def _headings(positions_m: NDArray[np.float64]) -> list[float]:
    """Return the heading from each position to the next; the last one keeps that of arrival."""
    towards: list[float | None] = [None]
    for d_x, d_y in np.diff(positions_m, axis=0)[::-1].tolist():
        is_step = math.hypot(d_x, d_y) > MIN_STEP_M
        towards.append(math.atan2(d_y, d_x) if is_step else towards[-1])
    arrival = next((heading for heading in towards if heading is not None), 0.0)
    return [arrival if heading is None else heading for heading in reversed(towards)]


def pose_message(pose: Pose) -> PoseMessage:
    """Return a planar pose as a message."""
    return PoseMessage(
        position=Point(x=pose.x_m, y=pose.y_m, z=0.0), orientation=_orientation(pose)
    )


def transform(stamp_ns: int, parent: str, child: str, pose: Pose) -> TransformStamped:
    """Return the transform to a frame from the pose of its origin in the parent frame."""
    message = TransformStamped(header=header_of(stamp_ns, parent), child_frame_id=child)
    message.transform.translation.x = pose.x_m
    message.transform.translation.y = pose.y_m
    message.transform.rotation = _orientation(pose)
    return message


def image_message(stamp_ns: int, frame_id: str, pixels: NDArray[np.uint8]) -> Image:
    """Return an image, (H, W) or (H, W, 3) uint8, as a mono8 or bgr8 message."""
    height, width = pixels.shape[:2]
    return Image(
        header=header_of(stamp_ns, frame_id), height=height, width=width,
        encoding='mono8' if pixels.ndim == 2 else 'bgr8', is_bigendian=0,
        step=pixels.size // height, data=array.array('B', pixels.tobytes()),
    )


def grid_message(picture: Picture, stamp_ns: int, frame_id: str) -> OccupancyGrid:
    """Return the message of a picture."""
    message = OccupancyGrid(header=header_of(stamp_ns, frame_id))
    message.info.map_load_time = time_of(stamp_ns)
    message.info.resolution = picture.cell_m
    message.info.height, message.info.width = picture.percent.shape
    message.info.origin.position.x = picture.x_m
    message.info.origin.position.y = picture.y_m
    message.info.origin.orientation.w = 1.0
    message.data = array.array('b', picture.percent.tobytes())
    return message


def point_cloud(
    stamp_ns: int, frame_id: str, points: NDArray[np.float64], value: str
) -> PointCloud2:
    """Return a cloud of points with the fields x, y, z and a value.

    Args:
        stamp_ns, frame_id: for the header.
        points: (n, 4) x, y, z and value of each point.
        value: name of the fourth field.
    """
    return PointCloud2(
        header=header_of(stamp_ns, frame_id), height=1, width=len(points),
        fields=[
            PointField(name=name, offset=4 * n, datatype=PointField.FLOAT32, count=1)
            for n, name in enumerate(('x', 'y', 'z', value))
        ],
        is_bigendian=False, point_step=16, row_step=16 * len(points),
        data=array.array('B', points.astype('<f4').tobytes()), is_dense=True,
    )


def serialised_text(parts: Sequence[bytes]) -> bytes:
    """Return a std_msgs/String of joined texts in UTF-8 in CDR, as publishers accept it.

    The conversion of a message copies its text several times. Python joins more than 1 MB without
    holding the interpreter lock. See the specification DDS-XTypes 1.3, section 7.4: the header of
    little-endian CDR, the length with the final zero, the text, and padding to 4 bytes.
    """
    length = 1 + sum(map(len, parts))
    return b''.join(
        [b'\0\1\0\0', length.to_bytes(4, 'little'), *parts, bytes(1 + -length % 4)]
    )


def _orientation(pose: Pose) -> Quaternion:
    z, w = quaternion_of(pose.heading_rad)
    return Quaternion(x=0.0, y=0.0, z=z, w=w)
