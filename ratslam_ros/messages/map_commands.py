# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads for saving and loading the map of all nodes in one operation."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ratslam_ros.messages.json_schema import (
    SCHEMA_VERSION,
    MalformedMessage,
    check_range,
    decode_fields,
    encode_json,
)

REQUEST, COMMAND, RESULT, STATUS = (
    f'ratslam/map_{name}' for name in ('request', 'command', 'result', 'status')
)
"""Topics of the requests of users, commands to the nodes, their results, and the outcome."""

SAVE, LOAD, UNDO = 'save', 'load', 'undo'
OPERATIONS = SAVE, LOAD, UNDO
DEFAULT_NAME = 'map'
"""Name of the map that the services save and load."""
SUFFIX = '.ratslam'
MAX_NUMBER = 2**63 - 1
MAX_TEXT = 2000

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


@dataclass(frozen=True)
class MapRequest:
    """What a user asks for: `save` or `load`, and the name of the map."""

    operation: str
    name: str = DEFAULT_NAME


@dataclass(frozen=True)
class MapCommand:
    """What the nodes shall do.

    number: identifies the operation. operation: `save`, `load`, or `undo` of the last `load`.
    cut: number of the cut to save.
    """

    number: int
    operation: str
    name: str
    cut: int = 0


@dataclass(frozen=True)
class MapResult:
    """What a node has done. number: that of the command."""

    number: int
    node: str
    success: bool
    message: str


def encode_map_request(request: MapRequest) -> str:
    """Return the payload of ``ratslam/map_request``."""
    return encode_json({
        'schema_version': SCHEMA_VERSION, 'operation': request.operation, 'name': request.name,
    })  # fmt: skip


def decode_map_request(payload: str) -> MapRequest:
    """Return a ``ratslam/map_request`` payload; raises MalformedMessage."""
    fields = decode_fields(payload, REQUEST, {'operation': str})
    name = fields.get('name', DEFAULT_NAME)
    if fields['operation'] not in (SAVE, LOAD) or not isinstance(name, str):
        raise MalformedMessage(
            f'{REQUEST}: expected the operation {SAVE} or {LOAD}, and a name of the map'
        )
    map_path('', name)
    return MapRequest(fields['operation'], name)


def encode_command(command: MapCommand) -> str:
    """Return the payload of ``ratslam/map_command``."""
    return encode_json({
        'schema_version': SCHEMA_VERSION, 'number': command.number,
        'operation': command.operation, 'name': command.name, 'cut': command.cut,
    })  # fmt: skip


def decode_command(payload: str) -> MapCommand:
    """Return a ``ratslam/map_command`` payload; raises MalformedMessage."""
    fields = decode_fields(
        payload, COMMAND, {'number': int, 'operation': str, 'name': str, 'cut': int}
    )
    for key in ('number', 'cut'):
        check_range(COMMAND, key, fields[key], 0, MAX_NUMBER)
    if fields['operation'] not in OPERATIONS:
        raise MalformedMessage(f'{COMMAND}: expected an operation of {", ".join(OPERATIONS)}')
    map_path('', fields['name'])
    return MapCommand(fields['number'], fields['operation'], fields['name'], fields['cut'])


def encode_result(result: MapResult) -> str:
    """Return the payload of ``ratslam/map_result``."""
    return encode_json({
        'schema_version': SCHEMA_VERSION, 'number': result.number, 'node': result.node,
        'success': result.success, 'message': result.message[:MAX_TEXT],
    })  # fmt: skip


def decode_result(payload: str) -> MapResult:
    """Return a ``ratslam/map_result`` payload; raises MalformedMessage."""
    fields = decode_fields(
        payload, RESULT, {'number': int, 'node': str, 'success': bool, 'message': str}
    )
    check_range(RESULT, 'number', fields['number'], 0, MAX_NUMBER)
    if max(len(fields['node']), len(fields['message'])) > MAX_TEXT:
        raise MalformedMessage(f'{RESULT}: a text is longer than {MAX_TEXT} characters')
    return MapResult(fields['number'], fields['node'], fields['success'], fields['message'])


def encode_map_status(
    request: MapRequest, state: str, done: list[str], waiting: list[str], message: str
) -> str:
    """Return the payload of ``ratslam/map_status``.

    Args:
        request: the operation.
        state: `running`, `done` or `failed`.
        done: nodes that have finished.
        waiting: nodes that have not.
        message: the result, or what is waited for, in one line.
    """
    fields: dict[str, Any] = {
        'schema_version': SCHEMA_VERSION, 'operation': request.operation, 'name': request.name,
        'state': state, 'done': done, 'waiting': waiting, 'message': message[:MAX_TEXT],
    }  # fmt: skip
    return encode_json(fields)


def decode_map_status(payload: str) -> tuple[bool | None, str]:
    """Return whether the operation has succeeded, None while it is running, and the message.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    fields = decode_fields(payload, STATUS, {'state': str, 'message': str})
    states = {'running': None, 'done': True, 'failed': False}
    if fields['state'] not in states or len(fields['message']) > MAX_TEXT:
        raise MalformedMessage(f'{STATUS}: expected a state of {", ".join(states)}')
    return states[fields['state']], fields['message']
