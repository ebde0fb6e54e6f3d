# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The messages of a recording's topics as events, with rosbags' type stores."""

import functools
import json
from typing import Any

import zstandard
from rosbags.typesys import Stores, get_typestore

from ratslam_ros.images import image_of
from ratslam_ros.recordings.events import (
    Event,
    ImageEvent,
    OdometryEvent,
    Orientation,
    ScanEvent,
    TemplateEvent,
)
from ratslam_ros.recordings.stream import Message
from ratslam_ros.recordings.topics import LASER_SCAN, ODOMETRY, STRING

_ZSTD = b'\x28\xb5\x2f\xfd'  # no CDR message begins so: its first byte is zero


class UndecodableMessage(Exception):  # noqa: N818
    """A message whose bytes do not fit its type."""


def normal_type(name: str) -> str:
    """Return package/msg/Type for the package/Type of ROS 1 and of old ROS 2 recordings."""
    package, _, kind = name.partition('/')
    return name if '/' in kind or not kind else f'{package}/msg/{kind}'


def unreadable(encoding: str) -> str | None:
    """Return why no message of an encoding can be decoded, or None."""
    if encoding in ('cdr', 'ros1'):
        return None
    return f'the serialisation format is {encoding!r} and not cdr'


def decode(message: Message) -> Any:
    """Return the message as rosbags decodes it; raises UndecodableMessage."""
    kind = normal_type(message.channel.type)
    try:
        data = message.data
        if data[:4] == _ZSTD:  # compressed message by message
            data = zstandard.ZstdDecompressor().decompressobj().decompress(data)
        if message.channel.encoding == 'ros1':
            return _store(Stores.ROS1_NOETIC).deserialize_ros1(data, kind)
        return _store(Stores.ROS2_JAZZY).deserialize_cdr(data, kind)
    except Exception as error:  # generated code meets arbitrary bytes: struct, index, value, ...
        raise UndecodableMessage(f'{len(message.data)} bytes are no {kind}: {error}') from None


def event_of(message: Message) -> Event:
    """Return a message as an event; raises UndecodableMessage."""
    content = decode(message)
    kind = normal_type(message.channel.type)
    if kind == ODOMETRY:
        return _odometry(content, message.log_ns)
    if kind == LASER_SCAN:
        return _scan(content, message.log_ns)
    if kind == STRING:
        return template(content.data, message.log_ns)
    return ImageEvent(_stamp(content), message.log_ns, image_of(content))


def template(payload: str, log_ns: int) -> TemplateEvent:
    """Return a template event, stamped by the payload where that can be read."""
    stamp_ns = log_ns
    try:
        stamp = json.loads(payload)['stamp']
        if type(stamp['sec']) is int and type(stamp['nanosec']) is int:
            stamp_ns = stamp['sec'] * 1_000_000_000 + stamp['nanosec']
    except (ValueError, KeyError, TypeError, RecursionError):
        pass  # the strict check of the payload says what is wrong with it
    return TemplateEvent(stamp_ns, log_ns, payload)


def _odometry(content: Any, log_ns: int) -> OdometryEvent:
    pose, twist = content.pose.pose, content.twist.twist
    q = pose.orientation
    # Numbers that are not finite are passed on: only whoever uses them knows which are needed.
    return OdometryEvent(
        _stamp(content),
        log_ns,
        float(twist.linear.x),
        float(twist.angular.z),
        float(pose.position.x),
        float(pose.position.y),
        Orientation(float(q.x), float(q.y), float(q.z), float(q.w)),
    )


def _scan(content: Any, log_ns: int) -> ScanEvent:
    return ScanEvent(
        _stamp(content),
        log_ns,
        float(content.angle_min),
        float(content.angle_increment),
        float(content.range_min),
        float(content.range_max),
        content.ranges,
    )


def _stamp(content: Any) -> int:
    """Return the stamp in the header, in nanoseconds."""
    stamp = content.header.stamp
    if not 0 <= stamp.nanosec < 1_000_000_000:
        raise UndecodableMessage(f'the header holds {stamp.nanosec} nanoseconds')
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


@functools.cache
def _store(version: Stores) -> Any:
    return get_typestore(version)
