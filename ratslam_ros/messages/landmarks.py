# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payload of the landmark map."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from msgspec import Meta, Struct

from ratslam_ros.core.landmarks.laser_map import LaserMap
from ratslam_ros.messages.json_schema import Payload, Stamp


class _Pose(Struct, frozen=True):
    x_m: Annotated[float, Meta(examples=[1.5])]
    """Position of the robot."""
    y_m: Annotated[float, Meta(examples=[0.25])]
    heading_rad: Annotated[float, Meta(examples=[0.1])]
    """Heading of the robot."""
    covariance: Annotated[list[list[float]], Meta(examples=[
        np.diag([0.01, 0.01, 0.001]).tolist()
    ])]
    """Of the pose: x and y in m, heading in rad."""
    is_lost: bool
    """Whether the pose is unknown: after `load`, after a pause, and after an odometry gap longer
    than `max_odom_gap_s`, until the landmarks of the last metre are found on the map. Until then
    nothing is added."""


class _Landmark(Struct, frozen=True):
    id: Annotated[int, Meta(examples=[0])]
    """Name of the landmark, never reused."""
    x_m: Annotated[float, Meta(examples=[4.0])]
    """Its position."""
    y_m: Annotated[float, Meta(examples=[1.5])]
    direction_rad: Annotated[float, Meta(examples=[-2.356])]
    """Direction of the bar."""
    length_m: Annotated[float, Meta(examples=[0.0])]
    """Its length; about 0 for corners and edges."""
    variances: Annotated[list[float], Meta(examples=[[0.01, 0.01, 0.001, 0.0001]])]
    """Of `x_m`, `y_m`, `direction_rad` and `length_m`."""
    xy_covariance: Annotated[float, Meta(examples=[0.0])]
    """Covariance of `x_m` and `y_m`."""


class LandmarksPayload(Payload, frozen=True):
    """All landmarks and the pose: the content of landmarks.json and ``landmark_map/map``."""

    TOPIC: ClassVar[str] = 'landmark_map/map'
    frame_id: Annotated[str, Meta(examples=['landmark_map'])]
    """Frame of the map."""
    stamp: Stamp
    """Stamp of the last scan that was used; 0 before the first."""
    pose: _Pose
    """The robot among the landmarks."""
    landmarks: list[_Landmark]
    """All landmarks."""

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
