# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Payload of ``experience_map/correction``: the map has moved the robot."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

from msgspec import Struct
from msgspec.structs import astuple

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.messages.json_schema import OptionalId, Payload, Stamp, decode, encode

NAME = 'experience_map/correction'


class Correction(NamedTuple):
    """A correction of the robot's pose on the map by an action, and not by odometry.

    Attributes:
        stamp_ns: stamp of the odometry message to which both poses belong.
        experience_id: current experience afterwards, -1 if there is none.
        before, after: pose of the robot on the map.
    """

    stamp_ns: int
    experience_id: int
    before: Pose
    after: Pose


class _Pose(Struct, frozen=True):
    x_m: float
    y_m: float
    heading_rad: float


class _Correction(Payload, frozen=True):
    TOPIC: ClassVar[str] = NAME
    stamp: Stamp
    experience_id: OptionalId
    before: _Pose
    after: _Pose


def encode_correction(correction: Correction) -> str:
    """Return the payload of a correction."""
    return encode(_Correction(
        Stamp.of(correction.stamp_ns), correction.experience_id, _Pose(*correction.before),
        _Pose(*correction.after),
    ))  # fmt: skip


def decode_correction(payload: str) -> Correction:
    """Return the correction of a payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    found = decode(_Correction, payload)
    return Correction(
        found.stamp.ns, found.experience_id, Pose(*astuple(found.before)),
        Pose(*astuple(found.after)),
    )  # fmt: skip
