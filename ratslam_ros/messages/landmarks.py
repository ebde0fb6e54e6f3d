# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payload of the landmark map."""

from __future__ import annotations

from ratslam_ros.core.landmarks.laser_map import LaserMap
from ratslam_ros.messages.json_schema import SCHEMA_VERSION, encode_json, encode_stamp


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
    pose, covariance = laser_map.pose, features.covariance
    pose_covariance = laser_map.memory.map.pose_covariance
    landmarks = []
    for identifier, start in zip(
        features.identifiers.tolist(), features.offsets[:-1].tolist(), strict=True
    ):
        x_m, y_m, direction_rad, length_m = features.values[start : start + 4].tolist()
        landmarks.append(
            {
                'id': identifier, 'x_m': x_m, 'y_m': y_m, 'direction_rad': direction_rad,
                'length_m': length_m,
                'variances': [covariance[i, i].item() for i in range(start, start + 4)],
                'xy_covariance': covariance[start, start + 1].item(),
            }
        )  # fmt: skip
    return encode_json(
        {
            'schema_version': SCHEMA_VERSION,
            'frame_id': frame_id,
            'stamp': encode_stamp(stamp_ns),
            'pose': {
                'x_m': pose.x_m, 'y_m': pose.y_m, 'heading_rad': pose.heading_rad,
                'covariance': pose_covariance.tolist(), 'is_lost': laser_map.is_lost,
            },
            'landmarks': landmarks,
        }
    )  # fmt: skip
