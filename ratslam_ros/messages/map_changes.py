# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads of ``experience_map/changes`` and ``experience_map/closures``.

Experiences and links are sent in columns of integers in mm, mrad, ms and thousandths, which are
short and quick to write, read and check.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from ratslam_ros.core.mapping.loop_closure_gate import ClosureEvent
from ratslam_ros.core.mapping.map_changes import ExperienceRows, LinkRows, MapChange
from ratslam_ros.core.mapping.sent_rows import ROUNDING
from ratslam_ros.messages.json_schema import (
    Count,
    Id,
    MalformedMessage,
    OptionalId,
    Payload,
    Stamp,
    Text,
    decode,
    encode,
    only_if,
)

CHANGES, CLOSURES = 'experience_map/changes', 'experience_map/closures'

MAX_EXPERIENCES = 1_000_000
"""Largest accepted number of experiences. A receiver allocates memory for all of them."""

MAX_ROWS = 1_000_000
"""Largest accepted number of experiences or links in one change."""

MAX_THOUSANDTHS = 10**12
"""Largest accepted coordinate, length or duration: a million km, or 30 years."""

TURN_MRAD = 6284
"""Largest accepted angle: a whole turn, so that angles need not be wrapped the same way."""

_T = TypeVar('_T')
_Column = Annotated[list[_T], Meta(max_length=MAX_ROWS)]
_Ids = _Column[Annotated[int, Meta(ge=0, lt=MAX_EXPERIENCES)]]
_Numbers = _Column[Id]
_Lengths = _Column[Annotated[int, Meta(ge=-MAX_THOUSANDTHS, le=MAX_THOUSANDTHS)]]
_Angles = _Column[Annotated[int, Meta(ge=-TURN_MRAD, le=TURN_MRAD)]]
_Counts = _Column[Count]


class _Experiences(Struct, frozen=True):
    ids: _Ids = []
    template_ids: _Numbers = []
    x_mm: _Lengths = []
    y_mm: _Lengths = []
    heading_mrad: _Angles = []
    components: _Numbers = []
    """Left out if all are 0."""


class _Ends(Struct, frozen=True):
    source_ids: _Ids = []
    target_ids: _Ids = []


class _Links(_Ends, frozen=True):
    distance_mm: _Lengths = []
    heading_mrad: _Angles = []
    facing_mrad: _Angles = []
    duration_ms: _Column[Annotated[int, Meta(ge=0, le=MAX_THOUSANDTHS)]] = []
    confidence_1000: _Column[Annotated[int, Meta(ge=0, le=1000)]] = []
    counts: _Counts = []
    recognised: _Column[Annotated[int, Meta(ge=0, le=1)]] = []
    behaviours: _Column[Annotated[int, Meta(ge=0, le=MAX_ROWS)]] = []
    """Indices of ``names``."""
    names: list[Text] = []


class _Change(Payload, frozen=True):
    TOPIC: ClassVar[str] = CHANGES
    MAX_CHARACTERS: ClassVar[int] = 2**28  # MAX_ROWS links have half of it.
    stamp: Stamp
    frame_id: Text
    sender: Count
    sequence: Count
    restart: bool
    experience_count: Annotated[int, Meta(ge=0, le=MAX_EXPERIENCES)]
    current_experience_id: OptionalId
    pending: Count
    experiences: _Experiences = _Experiences()
    links: _Links = _Links()
    removed_links: _Ends = _Ends()


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
    rows, links = change.experiences, change.links
    components, names = rows.components.tolist(), sorted(set(links.behaviours))
    numbers = {name: number for number, name in enumerate(names)}
    experience_columns = [
        rows.ids.tolist(), rows.template_ids.tolist(), *_thousandths(rows.poses.T),
        only_if(any(components), components),
    ]
    link_columns = [
        *links.ends.T.tolist(), *_thousandths(links.shapes.T), _thousandths(links.durations_s),
        _thousandths(links.confidences), links.counts.tolist(),
        links.recognised.astype(int).tolist(), [numbers[name] for name in links.behaviours], names,
    ]  # fmt: skip
    return encode(_Change(
        Stamp.of(change.stamp_ns), frame_id, sender, sequence, change.is_restart,
        change.experience_count, change.current_id, change.pending,
        only_if(len(rows) > 0, _Experiences(*experience_columns)),
        only_if(len(links) > 0, _Links(*link_columns)),
        only_if(len(change.removed_links) > 0, _Ends(*change.removed_links.T.tolist())),
    ))  # fmt: skip


def decode_map_change(payload: str) -> MapChangeMessage:
    """Return the content of an ``experience_map/changes`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    found = decode(_Change, payload)
    count, current_id = found.experience_count, found.current_experience_id
    if current_id >= count:
        raise MalformedMessage(
            f'{CHANGES}: current_experience_id is {current_id}; expected less than the '
            f'experience_count, {count}'
        )
    change = MapChange(
        found.stamp.ns, count, current_id, found.restart,
        _experience_rows(found.experiences, count), _link_rows(found.links, count),
        np.stack(_columns('removed_links', found.removed_links, count), axis=1), found.pending,
    )  # fmt: skip
    return MapChangeMessage(change, found.sequence, found.sender, found.frame_id)


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


class _Closure(Payload, frozen=True):
    TOPIC: ClassVar[str] = CLOSURES
    stamp: Stamp
    sequence: Count
    outcome: Literal['closed', 'rejected', 'relocated']
    source_id: OptionalId
    target_id: Id
    reason: Text


def encode_closure(stamp_ns: int, sequence: int, event: ClosureEvent) -> str:
    """Return the payload of ``experience_map/closures``.

    Args:
        stamp_ns: stamp of the action.
        sequence: number of the action.
        event: the closure, rejection or relocation, with the ids of the map.
    """
    return encode(_Closure(Stamp.of(stamp_ns), sequence, *event))


def decode_closure(payload: str) -> tuple[int, int, ClosureEvent]:
    """Return (stamp_ns, sequence, event) of an ``experience_map/closures`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    found = decode(_Closure, payload)
    event = ClosureEvent(found.outcome, found.source_id, found.target_id, found.reason)
    return found.stamp.ns, found.sequence, event


def _thousandths(values: NDArray[np.float64]) -> list[Any]:
    rounded: list[Any] = np.rint(values * ROUNDING).astype(np.int64).tolist()
    return rounded


def _experience_rows(table: _Experiences, count: int) -> ExperienceRows:
    ids, template_ids, x, y, heading, components = _columns('experiences', table, count)
    if len(np.unique(ids)) != len(ids):
        raise MalformedMessage(f'{CHANGES}: experiences.ids are repeated; expected each once')
    return ExperienceRows(
        ids, template_ids, np.stack([x, y, heading], axis=1) / ROUNDING, components
    )


def _link_rows(table: _Links, count: int) -> LinkRows:
    (
        sources, targets, distance, heading, facing, duration, confidence, counts, recognised,
        behaviours,
    ) = _columns('links', table, count)  # fmt: skip
    if len(sources) and int(behaviours.max()) >= len(table.names):
        raise MalformedMessage(
            f'{CHANGES}: links.behaviours has {int(behaviours.max())}; expected a row of names, '
            f'which has {len(table.names)}'
        )
    return LinkRows(
        np.stack([sources, targets], axis=1),
        np.stack([distance, heading, facing], axis=1) / ROUNDING,
        duration / ROUNDING, confidence / ROUNDING, counts, recognised > 0,
        tuple(table.names[number] for number in table.behaviours),
    )  # fmt: skip


def _columns(key: str, table: Struct, count: int) -> list[NDArray[np.int64]]:
    """Return the columns of a table of a change, checking their lengths and the ids."""
    columns = {
        name: np.array(getattr(table, name), np.int64)
        for name in table.__struct_fields__ if name != 'names'
    }  # fmt: skip
    length = len(next(iter(columns.values())))
    if not len(columns.get('components', [0])):
        columns['components'] = np.zeros(length, np.int64)
    for name, column in columns.items():
        if len(column) != length:
            raise MalformedMessage(
                f'{CHANGES}: {key}.{name} has {len(column)} rows; expected {length}, as in the '
                'other columns'
            )
        if name in ('ids', 'source_ids', 'target_ids') and length and column.max() >= count:
            raise MalformedMessage(
                f'{CHANGES}: {key}.{name} has {column.max()}; expected less than the '
                f'experience_count, {count}'
            )
    return list(columns.values())
