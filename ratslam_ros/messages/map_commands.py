# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads for saving and loading the map of all nodes in one operation."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, ClassVar, Final, Literal

from msgspec import Meta

from ratslam_ros.messages.json_schema import Count, MalformedMessage, Payload, Text

SAVE: Final = 'save'
LOAD: Final = 'load'
UNDO: Final = 'undo'
Operation = Literal['save', 'load', 'undo']
Progress = Literal['running', 'done', 'failed']
DEFAULT_NAME = 'map'
"""Name of the map that the services save and load."""
SUFFIX = '.ratslam'
MAX_TEXT = 2000
"""Largest accepted message of a result or status. Senders cut longer ones."""

_Message = Annotated[str, Meta(max_length=MAX_TEXT)]
_NAME = re.compile(r'[A-Za-z0-9][A-Za-z0-9 ._-]{0,99}')


def map_path(folder: str, name: str) -> Path:
    """Return the path of a map below the map folder.

    Args:
        folder: the map folder.
        name: name of the map, with or without the suffix. It comes from the network and must not
            lead to another folder.

    Raises:
        MalformedMessage: the name is no plain file name.
    """
    if not _NAME.fullmatch(name) or '..' in name:
        raise MalformedMessage(
            f'the map name {name[:100]!r} cannot be used: expected up to 100 letters, digits, '
            'spaces and ._- , beginning with a letter or digit; maps are kept in memory_folder'
        )
    file = name if name.endswith(SUFFIX) else name + SUFFIX
    return Path(folder).expanduser() / file


class MapRequest(Payload, frozen=True):
    """What a user asks for."""

    TOPIC: ClassVar[str] = 'ratslam/map_request'
    operation: Annotated[Literal['save', 'load'], Meta(examples=['save'])]
    """What to do with the map."""
    name: Annotated[str, Meta(examples=['first floor'])] = DEFAULT_NAME
    """File name without a path; the file is `memory_folder/NAME.ratslam`. Names that lead to
    another folder are refused."""

    def __post_init__(self) -> None:
        map_path('', self.name)


class MapCommand(Payload, frozen=True):
    """What the nodes shall do."""

    TOPIC: ClassVar[str] = 'ratslam/map_command'
    number: Annotated[Count, Meta(examples=[1795412600978450364])]
    """Identifies the operation."""
    operation: Annotated[Operation, Meta(examples=['save'])]
    """`undo` takes back the last `load`."""
    name: Annotated[str, Meta(examples=['first floor'])]
    """Name of the map."""
    cut: Count
    """Number of the cut to save."""

    def __post_init__(self) -> None:
        map_path('', self.name)


class MapResult(Payload, frozen=True):
    """What a node has done."""

    TOPIC: ClassVar[str] = 'ratslam/map_result'
    number: Annotated[Count, Meta(examples=[1795412600978450364])]
    """That of the command."""
    node: Annotated[Text, Meta(examples=['local_view'])]
    """Name of the node."""
    success: Annotated[bool, Meta(examples=[True])]
    """Whether it has done it."""
    message: Annotated[_Message, Meta(examples=['saved'])]
    """Where, or why not."""


class MapStatus(Payload, frozen=True):
    """Progress and result of an operation."""

    TOPIC: ClassVar[str] = 'ratslam/map_status'
    operation: Annotated[str, Meta(examples=['save'])]
    """That of the request."""
    name: Annotated[str, Meta(examples=['first floor'])]
    """Name of the map."""
    state: Annotated[Progress, Meta(examples=['running'])]
    """`running` until the result."""
    done: Annotated[list[str], Meta(examples=[['local_view']])]
    """Nodes that have finished."""
    waiting: Annotated[list[str], Meta(examples=[['pose_cells']])]
    """Nodes that have not finished."""
    message: Annotated[_Message, Meta(examples=['saved'])]
    """The result, or the reasons of a failure."""

    @property
    def success(self) -> bool | None:
        """Whether the operation has succeeded; None while it is running."""
        return {'running': None, 'done': True, 'failed': False}[self.state]
