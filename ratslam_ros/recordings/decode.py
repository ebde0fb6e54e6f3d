# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Decoding of recorded messages to events, with the type stores of rosbags."""

import functools
import json
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ratslam_ros.images import image_of
from ratslam_ros.recordings.events import (
    Event,
    ImageEvent,
    OdometryEvent,
    Orientation,
    ScanEvent,
    TemplateEvent,
)
from ratslam_ros.recordings.salvage import ZSTD_MAGIC, decompress_message
from ratslam_ros.recordings.stream import Message
from ratslam_ros.recordings.topics import LASER_SCAN, ODOMETRY, ROS1_TF, STRING, TF


class UndecodableMessage(Exception):  # noqa: N818
    """The bytes of a message do not fit its type."""


@functools.lru_cache
def ros2_type_name(name: str) -> str:
    """Convert package/Type, as in ROS 1 and old ROS 2 recordings, to package/msg/Type."""
    package, _, kind = name.partition('/')
    return name if '/' in kind or not kind else f'{package}/msg/{kind}'


def encoding_problem(encoding: str) -> str | None:
    """Return why messages of an encoding cannot be decoded, None if they can."""
    if encoding in ('cdr', 'ros1'):
        return None
    return f'the serialisation format is {encoding!r} and not cdr'


def decode(message: Message) -> Any:
    """Decode a message to its rosbags type; raises UndecodableMessage."""
    kind = ros2_type_name(message.channel.type)
    try:
        data = message.data
        # The recorder may have compressed each message. The first byte of CDR would be zero.
        if data[:4] == ZSTD_MAGIC:
            data = decompress_message(data)
        if message.channel.encoding == 'ros1':
            return _store(Stores.ROS1_NOETIC).deserialize_ros1(data, kind)
        return _store(Stores.ROS2_JAZZY).deserialize_cdr(data, kind)
    except Exception as error:  # The generated code raises many types on damaged bytes.
        raise UndecodableMessage(
            f'{len(message.data)} bytes are not a valid {kind}: {error}'
        ) from None


def decode_event(message: Message) -> Event:
    """Decode a message to an event; raises UndecodableMessage."""
    content = decode(message)
    kind = ros2_type_name(message.channel.type)
    if kind == ODOMETRY:
        return _odometry_event(content, message.log_ns)
    if kind == LASER_SCAN:
        return _scan_event(content, message.log_ns)
    if kind == STRING:
        return template_event(content.data, message.log_ns)
    return ImageEvent(_stamp_ns(content), message.log_ns, image_of(content))


def template_event(payload: str, log_ns: int) -> TemplateEvent:
    """Return a template event with the stamp of the JSON payload, or else the recording time."""
    stamp_ns = log_ns
    try:
        stamp = json.loads(payload)['stamp']
        sec, nanosec = stamp['sec'], stamp['nanosec']
        if type(sec) is int and type(nanosec) is int and max(abs(sec), abs(nanosec)) < 2**32:
            stamp_ns = sec * 1_000_000_000 + nanosec
    except (ValueError, KeyError, TypeError, RecursionError):
        pass  # The consumer validates the payload and reports the problem.
    return TemplateEvent(stamp_ns, log_ns, payload)


def _odometry_event(content: Any, log_ns: int) -> OdometryEvent:
    pose, twist = content.pose.pose, content.twist.twist
    q = pose.orientation
    # Non-finite numbers pass: which fields must be finite depends on the consumer.
    return OdometryEvent(
        _stamp_ns(content),
        log_ns,
        float(twist.linear.x),
        float(twist.angular.z),
        float(pose.position.x),
        float(pose.position.y),
        Orientation(float(q.x), float(q.y), float(q.z), float(q.w)),
        float(twist.linear.y),
    )


def _scan_event(content: Any, log_ns: int) -> ScanEvent:
    return ScanEvent(
        _stamp_ns(content),
        log_ns,
        float(content.angle_min),
        float(content.angle_increment),
        float(content.range_min),
        float(content.range_max),
        content.ranges,
        str(content.header.frame_id),
    )


def _stamp_ns(content: Any) -> int:
    """Return the stamp in the message header, in nanoseconds."""
    stamp = content.header.stamp
    if not 0 <= stamp.nanosec < 1_000_000_000:
        raise UndecodableMessage(f'the stamp in the header has {stamp.nanosec} nanoseconds')
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


@functools.cache
def _store(version: Stores) -> Any:
    store = get_typestore(version)
    if version == Stores.ROS1_NOETIC:  # which lacks the types of /tf
        for name in (TF, ROS1_TF):
            store.register(get_types_from_msg('geometry_msgs/TransformStamped[] transforms', name))
    return store
