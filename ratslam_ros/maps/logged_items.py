# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Binary form of the items that a process receives, in its log and in its saved state.

One byte names the kind. Odometry and scans have fixed fields, little endian; templates, actions
and relocations are the JSON texts of their topics. Images are logged as what was prepared of them.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import MAX_BEAM_COUNT, Scan
from ratslam_ros.core.vision.local_view import EncodedView
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.core.vision.visual_odometry import Profiles
from ratslam_ros.messages.json_schema import MalformedMessage, decode, encode
from ratslam_ros.messages.mapping import ActionPayload, RelocationPayload, TemplatePayload
from ratslam_ros.pipeline.commands import Command
from ratslam_ros.pipeline.item_states import command_from_state, command_state
from ratslam_ros.pipeline.items import Answer, NumberedAction, Template

_ODOMETRY, _SCAN = struct.Struct('<q6d?'), struct.Struct('<qi4d')
_Size = Annotated[int, Meta(ge=0, le=2**16)]
_BLANK = np.zeros((), np.uint8)


class _Image(msgspec.Struct, array_like=True):
    """A prepared image. pixels: left out if nothing needs them any more."""

    shape: tuple[_Size, _Size]
    pixels: bytes | None
    is_encoded: bool
    view: tuple[tuple[_Size, _Size], bytes] | None
    profiles: tuple[_Size, bytes, bytes] | None
    colour: bytes | None = None


def _from_odometry(odometry: Odometry) -> bytes:
    return _ODOMETRY.pack(
        odometry.stamp_ns, *odometry.twist, *odometry.pose, odometry.scale_known
    )


def _to_odometry(data: bytes) -> Odometry:
    stamp_ns, v, w, sideways, x_m, y_m, heading_rad, scale_known = _ODOMETRY.unpack(data)
    return Odometry(stamp_ns, Twist(v, w, sideways), Pose(x_m, y_m, heading_rad), scale_known)


def _from_scan(scan: Scan) -> bytes:
    head = _SCAN.pack(
        scan.stamp_ns, scan.laser, scan.angle_min_rad, scan.angle_increment_rad, scan.x_m, scan.y_m
    )
    return head + np.ascontiguousarray(scan.ranges_m, '<f8').tobytes()


def _to_scan(data: bytes) -> Scan:
    stamp_ns, laser, angle_min_rad, angle_increment_rad, x_m, y_m = _SCAN.unpack_from(data)
    ranges_m = np.frombuffer(data, '<f8', offset=_SCAN.size).astype(np.float64)
    if not 0 < len(ranges_m) <= MAX_BEAM_COUNT:
        raise ValueError(f'a scan has {len(ranges_m)} ranges')
    return Scan(stamp_ns, angle_min_rad, angle_increment_rad, ranges_m, x_m, y_m, laser)


def _from_image(image: PreparedImage) -> bytes:
    height, width = image.pixels.shape
    colour = None if image.has_all or image.colour is None else image.colour.tobytes()
    view = None if image.encoded is None else image.encoded.view
    profiles = image.profiles
    return msgspec.msgpack.encode(_Image(
        (height, width), None if image.has_all else image.pixels.tobytes(),
        image.encoded is not None, None if view is None else (view.shape, view.tobytes()),
        None if profiles is None else (
            profiles.height, _bytes(profiles.rotation), _bytes(profiles.translation)
        ),
        colour,
    ))


def _bytes(profile: NDArray[np.int64]) -> bytes:
    return profile.astype('<i8').tobytes()


def _to_image(data: bytes) -> PreparedImage:
    stored = msgspec.msgpack.decode(data, type=_Image)
    pixels, colour, encoded, profiles = np.broadcast_to(_BLANK, stored.shape), None, None, None
    if stored.pixels is not None:
        pixels = np.frombuffer(stored.pixels, np.uint8).reshape(stored.shape)
    if stored.is_encoded:
        view = stored.view and np.frombuffer(stored.view[1], np.uint8).reshape(stored.view[0])
        encoded = EncodedView(view)
    if stored.profiles is not None:
        height, *both = stored.profiles
        rotation, translation = (np.frombuffer(one, '<i8').astype(np.int64) for one in both)
        profiles = Profiles(stored.shape, height, rotation, translation)
    if stored.colour is not None:
        colour = np.frombuffer(stored.colour, np.uint8).reshape(*stored.shape, 3)
    return PreparedImage(pixels, encoded, profiles, stored.pixels is None, colour)


def _json(
    payload: Any, item: Callable[[Any], Any]
) -> tuple[Callable[[Any], bytes], Callable[[bytes], Any]]:
    """Return the codec of items by the payload of their topic."""
    return (
        lambda value: encode(payload.of(0, *value)).encode(),
        lambda data: item(decode(payload, data.decode())),
    )


_CODECS: tuple[tuple[bytes, Any, Callable[[Any], bytes], Callable[[bytes], Any]], ...] = (
    (b'o', Odometry, _from_odometry, _to_odometry),
    (b's', Scan, _from_scan, _to_scan),
    (b'i', PreparedImage, _from_image, _to_image),
    (b'u', type(None), lambda item: b'', lambda data: None),  # an undecodable image
    (b't', Template, *_json(TemplatePayload, lambda one: Template(one.match, one.memory))),
    (b'a', NumberedAction, *_json(
        ActionPayload, lambda one: NumberedAction(one.sequence, one.change, one.memory))),
    (b'r', Answer, *_json(
        RelocationPayload, lambda one: Answer(one.sequence, one.adopted, one.memory))),
    (b'c', Command, lambda item: json.dumps(command_state(item)).encode(),
     lambda data: command_from_state(json.loads(data))),
)


def encode_item(item: Any) -> bytes:
    """Return an item of a stream as bytes; all its values are kept exactly."""
    for name, kind, from_item, _ in _CODECS:
        if isinstance(item, kind):
            return name + from_item(item)
    raise TypeError(f'items of the class {type(item).__name__} cannot be logged')


def decode_item(data: bytes) -> Any:
    """Return what ``encode_item`` has written.

    Raises:
        MalformedMessage: the bytes are no item.
    """
    for name, _, _, to_item in _CODECS:
        if data[:1] == name:
            try:
                return to_item(data[1:])
            except (ValueError, TypeError, KeyError, AttributeError, struct.error) as error:
                raise MalformedMessage(f'a logged item is damaged ({error})') from None
    raise MalformedMessage(f'a logged item begins with {data[:1]!r}; expected the name of a kind')
