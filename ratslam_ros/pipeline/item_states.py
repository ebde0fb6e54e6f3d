# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs and commands that wait, as part of a saved state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from msgspec.structs import astuple

from ratslam_ros.core.common.odometry import Odometry, odometry_from_state, odometry_state
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan, scan_from_state, scan_state
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config, stored_values
from ratslam_ros.core.mapping.pose_hint import PoseHint
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.pipeline.commands import Command, Configure, Hint

_MATCH_FIELDS = (
    'template_id', 'is_new', 'error', 'relative_rad', 'threshold', 'related_count',
)


def item_state(item: Odometry | Scan | ViewMatch | PreparedImage | Command | None) -> State:
    """Return an input or command for a saved state."""
    if isinstance(item, Command):
        return {'command': command_state(item)}
    if isinstance(item, Odometry):
        return {'odometry': odometry_state(item)}
    if isinstance(item, Scan):
        return {'scan': scan_state(item)}
    if isinstance(item, ViewMatch):
        return {'match': _match_state(item)}
    if item is not None and item.colour is not None:
        return {'colour_image': [np.array(item.pixels), np.array(item.colour)]}
    return {'image': None if item is None else np.array(item.pixels)}


def item_from_state(state: State) -> Any:
    """Return an input or command from ``item_state``."""
    ((kind, value),) = state.items()
    decode: dict[str, Callable[[Any], Any]] = {
        'odometry': odometry_from_state, 'scan': scan_from_state, 'match': _match_from_state,
        'image': _image_from_state, 'command': command_from_state,
        'colour_image': lambda both: PreparedImage(both[0], colour=both[1]),
    }
    return decode[kind](value)


def _image_from_state(value: Any) -> PreparedImage | None:
    return None if value is None else PreparedImage(np.asarray(value, np.uint8))


_COMMANDS = {kind.__name__: kind for kind in Command.__subclasses__()}


def command_state(command: Command) -> State:
    """Return a command for a saved state."""
    name = type(command).__name__
    if isinstance(command, Configure):
        return {name: command.config.values()}
    if isinstance(command, Hint):
        pose, *variances = command.hint
        return {name: [*pose, *variances]}
    return {name: [*astuple(command)]}


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


def _match_state(match: ViewMatch) -> list[Any]:
    return [*(getattr(match, name) for name in _MATCH_FIELDS), list(match.removed)]


def _match_from_state(values: list[Any]) -> ViewMatch:
    *found, removed = values
    return ViewMatch(**dict(zip(_MATCH_FIELDS, found, strict=True)), removed=tuple(removed))
