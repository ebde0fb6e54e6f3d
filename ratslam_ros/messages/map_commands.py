# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads for saving and loading the map of all nodes in one operation."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, ClassVar, Final, Literal

from msgspec import Meta
from msgspec.structs import replace

from ratslam_ros.messages.json_schema import (
    Count,
    MalformedMessage,
    Payload,
    Text,
    decode,
    encode,
)

REQUEST, COMMAND, RESULT, STATUS = (
    f'ratslam/map_{name}' for name in ('request', 'command', 'result', 'status')
)
"""Topics of the requests of users, commands to the nodes, their results, and the outcome."""

SAVE: Final = 'save'
LOAD: Final = 'load'
UNDO: Final = 'undo'
Operation = Literal['save', 'load', 'undo']
Progress = Literal['running', 'done', 'failed']
DEFAULT_NAME = 'map'
"""Name of the map that the services save and load."""
SUFFIX = '.ratslam'
MAX_TEXT = 2000
"""Largest accepted message of a result or status. Longer ones are cut."""

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
    """What a user asks for: `save` or `load`, and the name of the map."""

    TOPIC: ClassVar[str] = REQUEST
    operation: Literal['save', 'load']
    name: str = DEFAULT_NAME


class MapCommand(Payload, frozen=True):
    """What the nodes shall do.

    number: identifies the operation. operation: `save`, `load`, or `undo` of the last `load`.
    cut: number of the cut to save.
    """

    TOPIC: ClassVar[str] = COMMAND
    number: Count
    operation: Operation
    name: str
    cut: Count


class MapResult(Payload, frozen=True):
    """What a node has done. number: that of the command."""

    TOPIC: ClassVar[str] = RESULT
    number: Count
    node: Text
    success: bool
    message: _Message


class _MapStatus(Payload, frozen=True):
    TOPIC: ClassVar[str] = STATUS
    operation: str
    name: str
    state: Progress
    done: list[str]
    waiting: list[str]
    message: _Message


encode_map_request = encode_command = encode


def decode_map_request(payload: str) -> MapRequest:
    """Return a ``ratslam/map_request`` payload; raises MalformedMessage."""
    request = decode(MapRequest, payload)
    map_path('', request.name)
    return request


def decode_command(payload: str) -> MapCommand:
    """Return a ``ratslam/map_command`` payload; raises MalformedMessage."""
    command = decode(MapCommand, payload)
    map_path('', command.name)
    return command


def encode_result(result: MapResult) -> str:
    """Return the payload of ``ratslam/map_result``."""
    return encode(replace(result, message=result.message[:MAX_TEXT]))


def decode_result(payload: str) -> MapResult:
    """Return a ``ratslam/map_result`` payload; raises MalformedMessage."""
    return decode(MapResult, payload)


def encode_map_status(
    request: MapRequest, state: Progress, done: list[str], waiting: list[str], message: str
) -> str:
    """Return the payload of ``ratslam/map_status``.

    Args:
        request: the operation.
        state: `running`, `done` or `failed`.
        done: nodes that have finished.
        waiting: nodes that have not.
        message: the result, or what is waited for, in one line.
    """
    return encode(
        _MapStatus(request.operation, request.name, state, done, waiting, message[:MAX_TEXT])
    )


def decode_map_status(payload: str) -> tuple[bool | None, str]:
    """Return whether the operation has succeeded, None while it is running, and the message.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    found = decode(_MapStatus, payload)
    return {'running': None, 'done': True, 'failed': False}[found.state], found.message
