# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Binary form of odometry and scans in the log of a map file: fixed fields, little endian.

Templates, actions and relocations are logged as the JSON texts of their topics.
"""

from __future__ import annotations

import struct

import numpy as np

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import MAX_BEAM_COUNT, Scan
from ratslam_ros.messages.json_schema import MalformedMessage

_ODOMETRY, _SIDEWAYS = struct.Struct('<q5d?'), struct.Struct('<d')
_SCAN = struct.Struct('<q4d')


def encode_odometry(odometry: Odometry) -> bytes:
    """Return an odometry message as bytes; all its values are kept exactly."""
    v, w, sideways = odometry.twist
    packed = _ODOMETRY.pack(odometry.stamp_ns, v, w, *odometry.pose, odometry.scale_known)
    return packed + _SIDEWAYS.pack(sideways) if sideways else packed


def decode_odometry(data: bytes) -> Odometry:
    """Return the odometry message that ``encode_odometry`` wrote; raises MalformedMessage."""
    if len(data) not in (_ODOMETRY.size, _ODOMETRY.size + _SIDEWAYS.size):
        raise MalformedMessage(
            f'logged odometry has {len(data)} bytes; expected {_ODOMETRY.size}: the map file was '
            'written by another version of ratslam_ros'
        )
    stamp_ns, v, w, x_m, y_m, heading_rad, scale_known = _ODOMETRY.unpack_from(data)
    has_sideways = len(data) > _ODOMETRY.size
    twist = Twist(v, w, *(_SIDEWAYS.unpack_from(data, _ODOMETRY.size) if has_sideways else ()))
    return Odometry(stamp_ns, twist, Pose(x_m, y_m, heading_rad), scale_known)


def encode_scan(scan: Scan) -> bytes:
    """Return a scan as bytes; all its values are kept exactly."""
    head = _SCAN.pack(
        scan.stamp_ns, scan.angle_min_rad, scan.angle_increment_rad, scan.x_m, scan.y_m
    )
    return head + np.ascontiguousarray(scan.ranges_m, '<f8').tobytes()


def decode_scan(data: bytes) -> Scan:
    """Return the scan that ``encode_scan`` wrote; raises MalformedMessage."""
    count, rest = divmod(len(data) - _SCAN.size, 8)
    if not 0 < count <= MAX_BEAM_COUNT or rest:
        raise MalformedMessage(
            f'a logged scan has {len(data)} bytes; expected {_SCAN.size} and 8 for each of 1 to '
            f'{MAX_BEAM_COUNT} ranges'
        )
    ranges_m = np.frombuffer(data, '<f8', offset=_SCAN.size).astype(np.float64)
    stamp_ns, angle_min_rad, angle_increment_rad, x_m, y_m = _SCAN.unpack_from(data)
    return Scan(stamp_ns, angle_min_rad, angle_increment_rad, ranges_m, x_m, y_m)
