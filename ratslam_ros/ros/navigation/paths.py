# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Routes and arrival times as messages, for viewers and for programs that drive a robot."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.ros.convert import header_of, point_cloud, pose_message, time_of

MIN_STEP_M = 1e-6
"""Length below which a step of a route has no heading."""


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
        pose = PoseStamped(pose=pose_message(Pose(x, y, heading)))
        pose.header.stamp = time_of(stamp_ns + round(after_s * 1e9))
        pose.header.frame_id = frame_id
        path.poses.append(pose)
    return path


def _headings(positions_m: NDArray[np.float64]) -> list[float]:
    """Return the heading from each position to the next; the last one keeps that of arrival."""
    towards: list[float | None] = [None]
    for d_x, d_y in np.diff(positions_m, axis=0)[::-1].tolist():
        is_step = math.hypot(d_x, d_y) > MIN_STEP_M
        towards.append(math.atan2(d_y, d_x) if is_step else towards[-1])
    arrival = next((heading for heading in towards if heading is not None), 0.0)
    return [arrival if heading is None else heading for heading in reversed(towards)]


def cloud_of(
    positions_m: NDArray[np.float64], seconds: NDArray[np.float64], stamp_ns: int, frame_id: str
) -> PointCloud2:
    """Return positions with their times as a point cloud with the fields x, y, z and time.

    Args:
        positions_m: (n, 2) positions on the map.
        seconds: (n,) time of each; positions with an infinite time are left out.
        stamp_ns: the current stamp.
        frame_id: the frame of the map.
    """
    is_finite = np.isfinite(seconds)
    points = np.zeros((np.count_nonzero(is_finite), 4))
    points[:, :2] = positions_m[is_finite]
    points[:, 3] = seconds[is_finite]
    return point_cloud(stamp_ns, frame_id, points, 'time')
