# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads of ``experience_map/changes`` and ``experience_map/closures``.

Experiences and links are sent in columns of integers in mm, mrad, ms and thousandths, which are
short and quick to write, read and check.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.mapping.loop_closure_gate import ClosureEvent
from ratslam_ros.core.mapping.map_changes import ExperienceRows, LinkRows, MapChange
from ratslam_ros.core.mapping.sent_rows import ROUNDING
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.messages.json_schema import (
    MAX_ID,
    SCHEMA_VERSION,
    MalformedMessage,
    check_range,
    check_text,
    decode_fields,
    decode_stamp,
    encode_json,
    encode_stamp,
    shown,
)

CHANGES, CLOSURES = 'experience_map/changes', 'experience_map/closures'

MAX_COUNT = 2**63 - 1
"""Largest accepted sequence number and stamp of a memory: 64-bit integers."""

MAX_EXPERIENCES = 1_000_000
"""Largest accepted number of experiences. A receiver allocates memory for all of them."""

MAX_ROWS = 1_000_000
"""Largest accepted number of experiences or links in one change."""

MAX_THOUSANDTHS = 10**12
"""Largest accepted coordinate, length or duration: a million km, or 30 years."""


MAX_CHANGES_CHARACTERS = 2**28
"""Largest accepted payload of ``experience_map/changes``: ``MAX_ROWS`` links have half of it."""

TURN_MRAD = 6284
"""Largest accepted angle: a whole turn, so that angles need not be wrapped the same way."""

MAX_NAME_LENGTH = 1000
"""Largest accepted length of a frame, a behaviour or a reason."""

Column = tuple[str, int, int]

EXPERIENCE_COLUMNS: tuple[Column, ...] = (
    ('ids', 0, MAX_EXPERIENCES - 1), ('template_ids', 0, MAX_ID),
    ('x_mm', -MAX_THOUSANDTHS, MAX_THOUSANDTHS), ('y_mm', -MAX_THOUSANDTHS, MAX_THOUSANDTHS),
    ('heading_mrad', -TURN_MRAD, TURN_MRAD), ('components', 0, MAX_ID),
)  # fmt: skip
LINK_COLUMNS: tuple[Column, ...] = (
    ('source_ids', 0, MAX_EXPERIENCES - 1), ('target_ids', 0, MAX_EXPERIENCES - 1),
    ('distance_mm', -MAX_THOUSANDTHS, MAX_THOUSANDTHS), ('heading_mrad', -TURN_MRAD, TURN_MRAD),
    ('facing_mrad', -TURN_MRAD, TURN_MRAD), ('duration_ms', 0, MAX_THOUSANDTHS),
    ('confidence_1000', 0, 1000), ('counts', 0, MAX_COUNT), ('recognised', 0, 1),
    ('behaviours', 0, MAX_ROWS),
)  # fmt: skip
REMOVED_COLUMNS: tuple[Column, ...] = LINK_COLUMNS[:2]
"""Names of the columns, and the smallest and largest accepted value of each."""


@dataclass(frozen=True, slots=True)
class MapChangeMessage:
    """A message of ``experience_map/changes``.

    Attributes:
        change: the change.
        sequence: number of the message since the start of the sender, from 0.
        sender: identifies the run of the sending node, which numbers its messages from 0.
        frame_id: name of the frame of the poses.
    """

    change: MapChange
    sequence: int
    sender: int
    frame_id: str


def encode_map_change(change: MapChange, sequence: int, sender: int, frame_id: str) -> str:
    """Return the payload of ``experience_map/changes``; see ``MapChangeMessage``.

    Poses and lengths are rounded to 1 mm, angles to 1 mrad, durations to 1 ms and confidences to
    0.001, as ``MapChangeTracker`` has done already.
    """
    fields: dict[str, Any] = {
        'schema_version': SCHEMA_VERSION,
        'stamp': encode_stamp(change.stamp_ns),
        'frame_id': frame_id,
        'sender': sender,
        'sequence': sequence,
        'restart': change.is_restart,
        'experience_count': change.experience_count,
        'current_experience_id': change.current_id,
        'pending': change.pending,
    }
    rows, links = change.experiences, change.links
    if len(rows):
        components = rows.components if rows.components.any() else rows.components[:0]
        fields['experiences'] = _encode_columns(EXPERIENCE_COLUMNS, [
            rows.ids, rows.template_ids, *_thousandths(rows.poses.T), components,
        ])  # fmt: skip
    if len(links):
        names = sorted(set(links.behaviours))
        numbers = {name: number for number, name in enumerate(names)}
        fields['links'] = {
            **_encode_columns(LINK_COLUMNS, [
                *links.ends.T, *_thousandths(links.shapes.T), _thousandths(links.durations_s),
                _thousandths(links.confidences), links.counts, links.recognised.astype(np.int64),
                np.array([numbers[name] for name in links.behaviours]),
            ]),
            'names': names,
        }  # fmt: skip
    if len(change.removed_links):
        fields['removed_links'] = _encode_columns(REMOVED_COLUMNS, list(change.removed_links.T))
    return encode_json(fields)


def decode_map_change(payload: str) -> MapChangeMessage:
    """Return the content of an ``experience_map/changes`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    fields = decode_fields(payload, CHANGES, {
        'stamp': dict, 'frame_id': str, 'sender': int, 'sequence': int, 'restart': bool,
        'experience_count': int, 'current_experience_id': int, 'pending': int,
    }, MAX_CHANGES_CHARACTERS)  # fmt: skip
    count = fields['experience_count']
    for key, low, high in (
        ('sender', 0, MAX_COUNT), ('sequence', 0, MAX_COUNT), ('pending', 0, MAX_COUNT),
        ('experience_count', 0, MAX_EXPERIENCES),
        ('current_experience_id', NO_EXPERIENCE, max(count, 0) - 1),
    ):  # fmt: skip
        check_range(CHANGES, key, fields[key], low, high)
    change = MapChange(
        decode_stamp(fields['stamp']), count, fields['current_experience_id'], fields['restart'],
        _decode_experiences(fields, count), _decode_links(fields, count),
        np.stack(_decode_columns(fields, 'removed_links', REMOVED_COLUMNS, count), axis=1),
        fields['pending'],
    )  # fmt: skip
    return MapChangeMessage(change, fields['sequence'], fields['sender'], fields['frame_id'])


class MapChangeFollower:
    """Checks whether messages of ``experience_map/changes`` can be applied in their order.

    Messages must not be applied before the first restart, nor after a gap in their numbers or a
    restart of the sender until the next one. Ask for it with the service
    ``experience_map/send_all``.
    """

    def __init__(self) -> None:
        self.needs_all = True
        """Whether the whole map must be requested."""
        self.lost_count = 0
        """Number of messages that were lost."""
        self._sender = -1
        self._next = 0

    def accepts(self, message: MapChangeMessage) -> bool:
        """Return whether a message continues the accepted ones; messages that do not are void."""
        is_same = message.sender == self._sender
        if is_same and message.sequence != self._next:
            self.lost_count += max(message.sequence - self._next, 0)
        if message.change.is_restart:
            self.needs_all = False
        elif not is_same or message.sequence != self._next:
            self.needs_all = True
        self._sender, self._next = message.sender, message.sequence + 1
        return not self.needs_all


def encode_closure(stamp_ns: int, sequence: int, event: ClosureEvent) -> str:
    """Return the payload of ``experience_map/closures``.

    Args:
        stamp_ns: stamp of the action.
        sequence: number of the action.
        event: the closure, rejection or relocation, with the ids of the map.
    """
    return encode_json({
        'schema_version': SCHEMA_VERSION, 'stamp': encode_stamp(stamp_ns), 'sequence': sequence,
        **event._asdict(),
    })  # fmt: skip


def decode_closure(payload: str) -> tuple[int, int, ClosureEvent]:
    """Return (stamp_ns, sequence, event) of an ``experience_map/closures`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    fields = decode_fields(payload, CLOSURES, {
        'stamp': dict, 'sequence': int, 'outcome': str, 'source_id': int, 'target_id': int,
        'reason': str,
    })  # fmt: skip
    check_range(CLOSURES, 'sequence', fields['sequence'], 0, MAX_COUNT)
    check_range(CLOSURES, 'source_id', fields['source_id'], NO_EXPERIENCE, MAX_ID)
    check_range(CLOSURES, 'target_id', fields['target_id'], 0, MAX_ID)
    outcome = fields['outcome']
    if outcome not in ('closed', 'rejected', 'relocated'):
        raise MalformedMessage(
            f'{CLOSURES}: outcome is {shown(outcome)}; expected closed, rejected or relocated'
        )
    event = ClosureEvent(outcome, fields['source_id'], fields['target_id'], fields['reason'])
    return decode_stamp(fields['stamp']), fields['sequence'], event


def _thousandths(values: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.rint(values * ROUNDING).astype(np.int64)


def _encode_columns(
    columns: Sequence[Column], values: Sequence[NDArray[np.int64]]
) -> dict[str, list[int]]:
    """Return the columns as lists; a column without values is left out."""
    return {
        name: column.tolist() for (name, _, _), column in zip(columns, values, strict=True)
        if len(column)
    }  # fmt: skip


def _decode_experiences(fields: Mapping[str, Any], count: int) -> ExperienceRows:
    ids, template_ids, x, y, heading, components = _decode_columns(
        fields, 'experiences', EXPERIENCE_COLUMNS, count
    )
    return ExperienceRows(
        ids, template_ids, np.stack([x, y, heading], axis=1) / ROUNDING, components
    )


def _decode_links(fields: Mapping[str, Any], count: int) -> LinkRows:
    (
        sources, targets, distance, heading, facing, duration, confidence, counts, recognised,
        behaviours,
    ) = _decode_columns(fields, 'links', LINK_COLUMNS, count)  # fmt: skip
    names = fields['links'].get('names') if len(sources) else []
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise MalformedMessage(
            f'{CHANGES}: links.names is {shown(names)}; expected an array of names'
        )
    for name in names:
        check_text(CHANGES, 'links.names', name, MAX_NAME_LENGTH)
    if len(sources) and int(behaviours.max()) >= len(names):
        raise MalformedMessage(
            f'{CHANGES}: links.behaviours has {int(behaviours.max())}; expected a row of names, '
            f'which has {len(names)}'
        )
    return LinkRows(
        np.stack([sources, targets], axis=1),
        np.stack([distance, heading, facing], axis=1) / ROUNDING,
        duration / ROUNDING, confidence / ROUNDING, counts, recognised > 0,
        tuple(names[number] for number in behaviours.tolist()),
    )  # fmt: skip


def _decode_columns(
    fields: Mapping[str, Any], key: str, columns: Sequence[Column], count: int
) -> list[NDArray[np.int64]]:
    """Return the columns of a table as integers of equal length, all empty if it is left out.

    Columns of ids must be below ``count``. The column ``components`` may be left out: all are 0.
    """
    table = fields.get(key, {})
    if not isinstance(table, dict):
        raise MalformedMessage(f'{CHANGES}: {key} is {shown(table)}; expected an object')
    length = None
    decoded = []
    for name, low, high in columns:
        values = table.get(name)
        if values is None and (not table or name == 'components'):
            values = [0] * (length or 0)
        # bool is a subclass of int
        if not isinstance(values, list) or not set(map(type, values)) <= {int}:
            raise MalformedMessage(
                f'{CHANGES}: {key}.{name} is {shown(values)}; expected an array of integers'
            )
        length = len(values) if length is None else length
        if len(values) != length or length > MAX_ROWS:
            raise MalformedMessage(
                f'{CHANGES}: {key}.{name} has {len(values)} rows; expected {length}, as in '
                f'the other columns, and at most {MAX_ROWS}'
            )
        if values:
            is_id = name in ('ids', 'source_ids', 'target_ids')
            highest = min(high, count - 1) if is_id else high
            for value in (min(values), max(values)):
                check_range(CHANGES, f'{key}.{name}', value, low, highest)
        decoded.append(np.array(values, np.int64))
    if key == 'experiences' and len(np.unique(decoded[0])) != length:
        raise MalformedMessage(f'{CHANGES}: {key}.ids are repeated; expected each once')
    return decoded
