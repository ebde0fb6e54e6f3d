# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payload of the landmark map."""

from __future__ import annotations

from msgspec import Struct

from ratslam_ros.core.landmarks.laser_map import LaserMap
from ratslam_ros.messages.json_schema import Payload, Stamp, encode


class _Pose(Struct, frozen=True):
    x_m: float
    y_m: float
    heading_rad: float
    covariance: list[list[float]]
    is_lost: bool


class _Landmark(Struct, frozen=True):
    id: int
    x_m: float
    y_m: float
    direction_rad: float
    length_m: float
    variances: list[float]
    xy_covariance: float


class _Landmarks(Payload, frozen=True):
    frame_id: str
    stamp: Stamp
    pose: _Pose
    landmarks: list[_Landmark]


def encode_landmarks(stamp_ns: int, laser_map: LaserMap, frame_id: str) -> str:
    """Return all landmarks and the pose: the content of landmarks.json and ``landmark_map/map``.

    Args:
        stamp_ns: stamp of the last used scan, 0 before the first.
        laser_map: the map.
        frame_id: frame of the map.

    Raises:
        ValueError: a number of the map is not finite.
    """
    features = laser_map.memory.map.features()
    covariance, pose_covariance = features.covariance, laser_map.memory.map.pose_covariance
    landmarks = []
    for identifier, start in zip(
        features.identifiers.tolist(), features.offsets[:-1].tolist(), strict=True
    ):
        x_m, y_m, direction_rad, length_m = features.values[start : start + 4].tolist()
        variances = covariance.diagonal()[start : start + 4].tolist()
        xy_covariance = covariance[start, start + 1].item()
        landmarks.append(_Landmark(
            identifier, x_m, y_m, direction_rad, length_m, variances, xy_covariance
        ))  # fmt: skip
    pose = _Pose(*laser_map.pose, pose_covariance.tolist(), laser_map.is_lost)
    return encode(_Landmarks(frame_id, Stamp.of(stamp_ns), pose, landmarks))
