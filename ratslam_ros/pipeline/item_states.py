# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs and commands that wait, as part of a saved state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple
from typing import Any

import numpy as np
from msgspec import structs

from ratslam_ros.core.common.odometry import Odometry, odometry_from_state, odometry_state
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan, scan_from_state, scan_state
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config, stored_values
from ratslam_ros.core.mapping.pose_hint import PoseHint
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.pipeline.commands import Command, Configure, Hint

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


_CODECS: dict[str, tuple[type, Callable[[Any], Any], Callable[[Any], Any]]] = {
    'command': (Command, command_state, command_from_state),
    'odometry': (Odometry, odometry_state, odometry_from_state),
    'scan': (Scan, scan_state, scan_from_state),
    'match': (
        ViewMatch, lambda match: [*astuple(match)[:-1], [*match.removed]],
        lambda values: ViewMatch(*[*values[:-1], tuple(values[-1])]),
    ),
}
"""Class, and conversion to and from its state, of all items but images."""


def item_state(item: Any) -> State:
    """Return an input or command for a saved state."""
    for name, (kind, save, _) in _CODECS.items():
        if isinstance(item, kind):
            return {name: save(item)}
    pixels = None if item is None else np.array(item.pixels)
    if pixels is None or item.colour is None:
        return {'image': pixels}
    return {'colour_image': [pixels, np.array(item.colour)]}


def item_from_state(state: State) -> Any:
    """Return an input or command from ``item_state``."""
    ((name, value),) = state.items()
    if name == 'colour_image':
        pixels, colour = value
        return PreparedImage(pixels, colour=colour)
    if name == 'image':
        return None if value is None else PreparedImage(np.asarray(value, np.uint8))
    return _CODECS[name][2](value)
