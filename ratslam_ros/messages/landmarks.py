# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payload of the landmark map."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from msgspec import Struct

from ratslam_ros.core.landmarks.laser_map import LaserMap
from ratslam_ros.messages.json_schema import Payload, Stamp, about


class _Pose(Struct, frozen=True):
    x_m: Annotated[float, about('position of the robot', 1.5)]
    y_m: Annotated[float, about(example=0.25)]
    heading_rad: Annotated[float, about('heading of the robot', 0.1)]
    covariance: Annotated[list[list[float]], about(
        'of the pose: x and y in m, heading in rad', np.diag([0.01, 0.01, 0.001]).tolist()
    )]
    is_lost: Annotated[bool, about(
        'whether the pose is unknown: after `load`, after a pause, and after an odometry gap '
        'longer than `max_odom_gap_s`, until the landmarks of the last metre are found on the '
        'map. Until then nothing is added'
    )]


class _Landmark(Struct, frozen=True):
    id: Annotated[int, about('name of the landmark, never reused', 0)]
    x_m: Annotated[float, about('its position', 4.0)]
    y_m: Annotated[float, about(example=1.5)]
    direction_rad: Annotated[float, about('direction of the bar', -2.356)]
    length_m: Annotated[float, about('its length; about 0 for corners and edges', 0.0)]
    variances: Annotated[list[float], about(
        'of `x_m`, `y_m`, `direction_rad` and `length_m`', [0.01, 0.01, 0.001, 0.0001]
    )]
    xy_covariance: Annotated[float, about('covariance of `x_m` and `y_m`', 0.0)]


class LandmarksPayload(Payload, frozen=True):
    """All landmarks and the pose: the content of landmarks.json and ``landmark_map/map``."""

    TOPIC: ClassVar[str] = 'landmark_map/map'
    frame_id: Annotated[str, about('frame of the map', 'landmark_map')]
    stamp: Annotated[Stamp, about('stamp of the last scan that was used; 0 before the first')]
    pose: Annotated[_Pose, about('the robot among the landmarks')]
    landmarks: Annotated[list[_Landmark], about('all landmarks')]

    @classmethod
    def of(cls, stamp_ns: int, laser_map: LaserMap, frame_id: str) -> LandmarksPayload:
        """Return the payload of a map."""
        features = laser_map.memory.map.features()
        covariance, landmarks = features.covariance, []
        for identifier, start in zip(
            features.identifiers.tolist(), features.offsets[:-1].tolist(), strict=True
        ):
            x_m, y_m, direction_rad, length_m = features.values[start : start + 4].tolist()
            landmarks.append(_Landmark(
                identifier, x_m, y_m, direction_rad, length_m,
                covariance.diagonal()[start : start + 4].tolist(),
                covariance[start, start + 1].item(),
            ))
        pose_covariance = laser_map.memory.map.pose_covariance.tolist()
        pose = _Pose(*laser_map.pose, pose_covariance, laser_map.is_lost)
        return cls(frame_id, Stamp.of(stamp_ns), pose, landmarks)
