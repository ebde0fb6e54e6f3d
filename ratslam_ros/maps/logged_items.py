# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Binary form of the items that a process receives, in its log and in its saved state.

One byte names the class, whose declaration gives the fields; MessagePack follows. Images are
logged as what was prepared of them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from msgspec import MsgspecError
from msgspec.msgpack import decode, encode
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.messages.json_schema import MalformedMessage
from ratslam_ros.pipeline.commands import Command
from ratslam_ros.pipeline.item_states import command_from_state, command_state
from ratslam_ros.pipeline.items import Answer, NumberedAction, Template

_KINDS: dict[bytes, Any] = {
    b'o': Odometry, b's': Scan, b'i': PreparedImage | None, b't': Template, b'a': NumberedAction,
    b'r': Answer, b'c': Command,
}
_BLANK = np.zeros((), np.uint8)


def encode_item(item: Any) -> bytes:
    """Return an item of a stream as bytes; all its values are kept exactly."""
    for name, kind in _KINDS.items():
        if isinstance(item, kind):
            if isinstance(item, Command):
                item = command_state(item)
            elif isinstance(item, PreparedImage) and item.has_all:
                blank = np.broadcast_to(_BLANK, item.pixels.shape)
                item = replace(item, pixels=blank, colour=None)
            return name + encode(item, enc_hook=_from_array)
    raise TypeError(f'items of the class {type(item).__name__} cannot be logged')


def decode_item(data: bytes) -> Any:
    """Return what ``encode_item`` has written.

    Raises:
        MalformedMessage: the bytes are no item.
    """
    kind = _KINDS.get(data[:1])
    if kind is None:
        raise MalformedMessage(
            f'a logged item begins with {data[:1]!r}; expected the name of a kind'
        )
    try:
        if kind is Command:
            return command_from_state(decode(data[1:]))
        return decode(data[1:], type=kind, dec_hook=_to_array)
    except (MsgspecError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise MalformedMessage(f'a logged item is damaged ({error})') from None


def _from_array(value: NDArray[Any] | np.generic) -> Any:
    """Return the shape and the bytes of an array; one element if all have the same place."""
    if isinstance(value, np.generic):
        return value.item()
    stored = value if any(value.strides) else value.flat[:1]
    return value.shape, stored.tobytes()


def _to_array(kind: Any, stored: tuple[list[int], bytes]) -> NDArray[Any]:
    """Return an array of a declared type, such as ``NDArray[np.uint8]``."""
    shape, data = stored
    values = np.frombuffer(data, kind.__args__[1].__args__[0])
    is_blank = len(values) == 1
    return np.broadcast_to(values, shape) if is_blank else values.reshape(shape).copy()
