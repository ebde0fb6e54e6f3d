# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs and commands as parts of a saved state, and all items as bytes, in the log of a process.

As bytes, one letter names the class, whose declaration gives the fields; MessagePack follows. Of
an image, the log has what was prepared, and so have states in a process with a log.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, replace
from typing import Any

import numpy as np
from msgspec import MsgspecError, structs
from msgspec.msgpack import decode, encode
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Odometry, odometry_from_state, odometry_state
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan, scan_from_state, scan_state
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config, stored_values
from ratslam_ros.core.mapping.pose_hint import PoseHint
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.errors import UnusableInput
from ratslam_ros.pipeline.commands import Command, Configure, Hint
from ratslam_ros.pipeline.items import Answer, NumberedAction, Template

_COMMANDS = {kind.__name__: kind for kind in Command.__subclasses__()}


def command_state(command: Command) -> State:
    """Return a command for a saved state."""
    name = type(command).__name__
    if isinstance(command, Configure):
        return {name: command.config.values()}
    if isinstance(command, Hint):
        pose, *variances = command.hint
        return {name: [*pose, *variances]}
    return {name: [*structs.astuple(command)]}


def command_from_state(state: State) -> Command:
    """Return a command from ``command_state``."""
    ((name, values),) = state.items()
    if name == 'Configure':
        given, _ = stored_values({
            f'{section}.{key}': value
            for section, entries in values.items() for key, value in entries.items()
        })
        return Configure(Config().with_values(given))
    if name == 'Hint':
        return Hint(PoseHint(Pose(*values[:3]), *values[3:]))
    return _COMMANDS[name](*values)


_STATES: dict[str, tuple[Any, Callable[[Any], Any], Callable[[Any], Any]]] = {
    'command': (Command, command_state, command_from_state),
    'odometry': (Odometry, odometry_state, odometry_from_state),
    'scan': (Scan, scan_state, scan_from_state),
    'match': (
        ViewMatch, lambda match: [*astuple(match)[:-1], [*match.removed]],
        lambda values: ViewMatch(*[*values[:-1], tuple(values[-1])]),
    ),
    'logged': (
        object, lambda item: np.frombuffer(encode_item(item), np.uint8),
        lambda data: decode_item(data.tobytes()),
    ),
}
"""Class, and conversion to and from a state, of all items but images with their pixels."""


def item_state(item: Any) -> State:
    """Return an input or command for a saved state."""
    if item is None:
        return {'image': None}
    if isinstance(item, PreparedImage) and not item.has_all:
        pixels = np.array(item.pixels)
        if item.colour is None:
            return {'image': pixels}
        return {'colour_image': [pixels, np.array(item.colour)]}
    name = next(name for name, (kind, *_) in _STATES.items() if isinstance(item, kind))
    return {name: _STATES[name][1](item)}


def item_from_state(state: State) -> Any:
    """Return an input or command from ``item_state``."""
    ((name, value),) = state.items()
    if name == 'colour_image':
        pixels, colour = value
        return PreparedImage(pixels, colour=colour)
    if name == 'image':
        return None if value is None else PreparedImage(np.asarray(value, np.uint8))
    return _STATES[name][2](value)


_LETTERS: dict[bytes, Any] = {
    b'o': Odometry, b's': Scan, b'i': PreparedImage | None, b't': Template, b'a': NumberedAction,
    b'r': Answer, b'c': Command,
}
_BLANK = np.zeros((), np.uint8)


def encode_item(item: Any) -> bytes:
    """Return an item of a stream as bytes; all its values are kept exactly."""
    for letter, kind in _LETTERS.items():
        if isinstance(item, kind):
            if isinstance(item, Command):
                item = command_state(item)
            elif isinstance(item, PreparedImage) and item.has_all:
                blank = np.broadcast_to(_BLANK, item.pixels.shape)
                item = replace(item, pixels=blank, colour=None)
            return letter + encode(item, enc_hook=_from_array)
    raise TypeError(f'items of the class {type(item).__name__} cannot be logged')


def decode_item(data: bytes) -> Any:
    """Return what ``encode_item`` has written.

    Raises:
        UnusableInput: the bytes are no item.
    """
    kind = _LETTERS.get(data[:1])
    if kind is None:
        raise UnusableInput(f'a logged item begins with {data[:1]!r}; expected the name of a kind')
    try:
        if kind is Command:
            return command_from_state(decode(data[1:]))
        return decode(data[1:], type=kind, dec_hook=_to_array)
    except (MsgspecError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise UnusableInput(f'a logged item is damaged ({error})') from None


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
    if (len(shape) > 1) != (values.dtype == np.uint8):
        raise ValueError(f'an array of {values.dtype} has the shape {shape}')
    is_blank = len(values) == 1 < len(shape)
    return np.broadcast_to(values, shape) if is_blank else values.reshape(shape).copy()
