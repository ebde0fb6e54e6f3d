# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Payload of ``experience_map/correction``: the map has moved the robot."""

from __future__ import annotations

from typing import Annotated, ClassVar

from msgspec import Struct
from msgspec.structs import astuple

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.messages.json_schema import OptionalId, Payload, Stamp, about


class _Pose(Struct, frozen=True):
    x_m: Annotated[float, about('position on the map', 4.5)]
    y_m: Annotated[float, about(example=0.25)]
    heading_rad: Annotated[float, about('heading on the map', 1.5)]

    @property
    def pose(self) -> Pose:
        """The pose in the type of core."""
        return Pose(*astuple(self))


class Correction(Payload, frozen=True):
    """A correction of the robot's pose on the map by an action, and not by odometry."""

    TOPIC: ClassVar[str] = 'experience_map/correction'
    stamp: Annotated[Stamp, about('stamp of the odometry message to which both poses belong')]
    experience_id: Annotated[OptionalId, about('current experience afterwards; -1 for none', 12)]
    before: Annotated[_Pose, about('pose of the robot at `stamp`, without the action')]
    after: Annotated[_Pose, about('and with it', {'x_m': 4.25, 'y_m': 0.5, 'heading_rad': 1.625})]

    @classmethod
    def of(cls, stamp_ns: int, experience_id: int, before: Pose, after: Pose) -> Correction:
        """Return the correction of a pose."""
        return cls(Stamp.of(stamp_ns), experience_id, _Pose(*before), _Pose(*after))
