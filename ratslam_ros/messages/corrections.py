# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Payload of ``experience_map/correction``: the map has moved the robot."""

from __future__ import annotations

from typing import NamedTuple

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.messages.json_schema import (
    MAX_ID,
    SCHEMA_VERSION,
    check_range,
    check_types,
    decode_fields,
    decode_stamp,
    encode_json,
    encode_stamp,
)

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


def encode_correction(correction: Correction) -> str:
    """Return the payload of a correction."""
    return encode_json({
        'schema_version': SCHEMA_VERSION, 'stamp': encode_stamp(correction.stamp_ns),
        'experience_id': correction.experience_id,
        'before': correction.before._asdict(), 'after': correction.after._asdict(),
    })  # fmt: skip


def decode_correction(payload: str) -> Correction:
    """Return the correction of a payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    fields = decode_fields(
        payload, NAME, {'stamp': dict, 'experience_id': int, 'before': dict, 'after': dict}
    )
    check_range(NAME, 'experience_id', fields['experience_id'], -1, MAX_ID)
    poses = []
    for key in ('before', 'after'):
        pose = fields[key]
        check_types(pose, NAME, dict.fromkeys(Pose._fields, float))
        poses.append(Pose(*(float(pose[name]) for name in Pose._fields)))
    return Correction(decode_stamp(fields['stamp']), fields['experience_id'], *poses)
