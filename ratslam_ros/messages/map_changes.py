# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads of ``experience_map/changes`` and ``experience_map/closures``.

Experiences and links are sent in columns of integers in mm, mrad, ms and thousandths, which are
short and quick to write, read and check.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from ratslam_ros.core.mapping.loop_closure_gate import ClosureEvent
from ratslam_ros.core.mapping.map_changes import (
    MAX_ROWS,
    ROUNDING,
    ExperienceRows,
    LinkRows,
    MapChange,
)
from ratslam_ros.messages.json_schema import (
    Count,
    Id,
    OptionalId,
    Payload,
    Stamp,
    Text,
    only_if,
)

MAX_THOUSANDTHS = 10**12
"""Largest accepted coordinate, length or duration: a million km, or 30 years."""

TURN_MRAD = 6284
"""Largest accepted angle: a whole turn, so that angles need not be wrapped the same way."""

_T = TypeVar('_T')
_Column = Annotated[list[_T], Meta(max_length=MAX_ROWS)]
_Ids = _Column[Annotated[int, Meta(ge=0, lt=MAX_ROWS)]]
_Numbers = _Column[Id]
_Lengths = _Column[Annotated[int, Meta(ge=-MAX_THOUSANDTHS, le=MAX_THOUSANDTHS)]]
_Durations = _Column[Annotated[int, Meta(ge=0, le=MAX_THOUSANDTHS)]]
_Shares = _Column[Annotated[int, Meta(ge=0, le=1000)]]
_Flags = _Column[Annotated[int, Meta(ge=0, le=1)]]
_Rows = _Column[Annotated[int, Meta(ge=0, le=MAX_ROWS)]]
_Angles = _Column[Annotated[int, Meta(ge=-TURN_MRAD, le=TURN_MRAD)]]


class _Table(Struct, frozen=True):
    """Columns of the same length; ``components`` may be left out, and ``names`` is no column."""

    def __post_init__(self) -> None:
        columns = {name: getattr(self, name) for name in self.__struct_fields__}
        columns.pop('names', None)
        length = len(next(iter(columns.values())))
        for name, column in columns.items():
            if len(column or ()) != length and (column or name != 'components'):
                raise ValueError(
                    f'{name} has {len(column)} rows; expected {length}, as in the other columns'
                )

    def largest_id(self) -> int:
        """Return the largest id of an experience, -1 if there is none."""
        names = {'ids', 'source_ids', 'target_ids'}.intersection(self.__struct_fields__)
        return max((max(getattr(self, name), default=-1) for name in names), default=-1)


class _Experiences(_Table, frozen=True):
    ids: Annotated[_Ids, Meta(examples=[[12, 20]])] = []
    """Each once."""
    template_ids: Annotated[_Numbers, Meta(examples=[[17, 25]])] = []
    """Their templates."""
    x_mm: Annotated[_Lengths, Meta(examples=[[1250, 4100]])] = []
    """Their positions on the map."""
    y_mm: Annotated[_Lengths, Meta(examples=[[-500, 2004]])] = []
    heading_mrad: Annotated[_Angles, Meta(examples=[[1571, -3100]])] = []
    """Their headings on the map."""
    components: _Numbers = []
    """Left out if all are 0."""

    def __post_init__(self) -> None:
        _Table.__post_init__(self)
        if len(set(self.ids)) != len(self.ids):
            raise ValueError('ids are repeated; expected each once')


class _Ends(_Table, frozen=True):
    source_ids: Annotated[_Ids, Meta(examples=[[20]])] = []
    """The experiences they connect."""
    target_ids: Annotated[_Ids, Meta(examples=[[12]])] = []


class _Links(_Ends, frozen=True):
    distance_mm: Annotated[_Lengths, Meta(examples=[[254]])] = []
    """As in [map.json](results.md#mapjson)."""
    heading_mrad: Annotated[_Angles, Meta(examples=[[100]])] = []
    """As in map.json."""
    facing_mrad: Annotated[_Angles, Meta(examples=[[1600]])] = []
    duration_ms: Annotated[_Durations, Meta(examples=[[800]])] = []
    """Travel times."""
    confidence_1000: Annotated[_Shares, Meta(examples=[[500]])] = []
    """Confidence of the link in thousandths ([algorithm.md](algorithm.md)), multiplied by the
    share of its weight for a recognition."""
    counts: Annotated[_Column[Count], Meta(examples=[[1]])] = []
    """Numbers of transitions."""
    recognised: Annotated[_Flags, Meta(examples=[[0]])] = []
    """1 if a recognised view determines the link, and not odometry alone."""
    behaviours: Annotated[_Rows, Meta(examples=[[0]])] = []
    """Rows of `names`."""
    names: Annotated[list[Text], Meta(examples=[['left_wall']])] = []
    """The behaviours."""

    def __post_init__(self) -> None:
        _Table.__post_init__(self)
        if max(self.behaviours, default=-1) >= len(self.names):
            raise ValueError(
                f'behaviours has {max(self.behaviours)}; expected a row of names, which has '
                f'{len(self.names)}'
            )


class MapChangePayload(Payload, frozen=True):
    """A change of the map.

    Poses and lengths are rounded to 1 mm, angles to 1 mrad, durations to 1 ms and confidences to
    0.001, as ``MapChangeTracker`` has done already.
    """

    TOPIC: ClassVar[str] = 'experience_map/changes'
    MAX_CHARACTERS: ClassVar[int] = 2**28  # MAX_ROWS links have half of it.
    stamp: Stamp
    """Stamp of the last applied action."""
    frame_id: Annotated[Text, Meta(examples=['map'])]
    """Name of the frame of the poses."""
    sender: Annotated[Count, Meta(examples=[1699999990000000000])]
    """The run of the node, which numbers its messages from 0."""
    sequence: Annotated[Count, Meta(examples=[7])]
    """Number of the message in this run."""
    restart: bool
    """Whether everything known before is void; the whole map follows in this message and the next
    ones."""
    experience_count: Annotated[int, Meta(ge=0, le=MAX_ROWS, examples=[21])]
    """Number of experiences of the map; the ids are below it."""
    current_experience_id: Annotated[OptionalId, Meta(examples=[12])]
    """-1 for none."""
    pending: Annotated[Count, Meta(examples=[0])]
    """Number of experiences and links that differ but are not included yet; 0 if the receiver has
    the whole map."""
    experiences: Annotated[_Experiences, Meta(examples=[...])] = _Experiences()
    """New, moved or replaced experiences, in columns."""
    links: Annotated[_Links, Meta(examples=[...])] = _Links()
    """New or changed links, in columns."""
    removed_links: Annotated[
        _Ends, Meta(examples=[{'source_ids': [3], 'target_ids': [4]}])
    ] = _Ends()
    """Deleted links. They are removed before `links` are added."""

    def __post_init__(self) -> None:
        used = {'current_experience_id': self.current_experience_id}
        for key in ('experiences', 'links', 'removed_links'):
            table = getattr(self, key)
            used[key] = table.largest_id() if table else -1
        for key, number in used.items():
            if number >= self.experience_count:
                raise ValueError(
                    f'{key} has the id {number}; expected less than the experience_count, '
                    f'{self.experience_count}'
                )

    @classmethod
    def of(
        cls, change: MapChange, sequence: int, sender: int, frame_id: str
    ) -> MapChangePayload:
        """Return the payload of a change, with the number of the message since ``sender``."""
        rows, links = change.experiences, change.links
        components, names = rows.components.tolist(), sorted(set(links.behaviours))
        numbers = {name: number for number, name in enumerate(names)}
        experience_columns = [
            rows.ids.tolist(), rows.template_ids.tolist(), *_thousandths(rows.poses.T),
            only_if(any(components), components),
        ]
        link_columns = [
            *links.ends.T.tolist(), *_thousandths(links.shapes.T),
            _thousandths(links.durations_s), _thousandths(links.confidences),
            links.counts.tolist(), links.recognised.astype(int).tolist(),
            [numbers[name] for name in links.behaviours], names,
        ]
        return cls(
            Stamp.of(change.stamp_ns), frame_id, sender, sequence, change.is_restart,
            change.experience_count, change.current_id, change.pending,
            only_if(len(rows) > 0, _Experiences(*experience_columns)),
            only_if(len(links) > 0, _Links(*link_columns)),
            only_if(len(change.removed_links) > 0, _Ends(*change.removed_links.T.tolist())),
        )

    @property
    def change(self) -> MapChange:
        """The change, with new arrays."""
        rows, links, removed = self.experiences, self.links, self.removed_links
        experiences = ExperienceRows(
            _columns(rows.ids), _columns(rows.template_ids),
            _columns(rows.x_mm, rows.y_mm, rows.heading_mrad) / ROUNDING,
            _columns(rows.components or [0] * len(rows.ids)),
        )
        changed = LinkRows(
            _columns(links.source_ids, links.target_ids),
            _columns(links.distance_mm, links.heading_mrad, links.facing_mrad) / ROUNDING,
            _columns(links.duration_ms) / ROUNDING, _columns(links.confidence_1000) / ROUNDING,
            _columns(links.counts), _columns(links.recognised) > 0,
            tuple(links.names[number] for number in links.behaviours),
        )
        return MapChange(
            self.stamp.ns, self.experience_count, self.current_experience_id, self.restart,
            experiences, changed, _columns(removed.source_ids, removed.target_ids), self.pending,
        )


def _thousandths(values: NDArray[np.float64]) -> list[Any]:
    rounded: list[Any] = np.rint(values * ROUNDING).astype(np.int64).tolist()
    return rounded


def _columns(*columns: list[int]) -> NDArray[np.int64]:
    """Return a column as (n,), or several as (n, m)."""
    found = np.array(columns, np.int64).T
    return found[:, 0] if len(columns) == 1 else np.ascontiguousarray(found)


class MapChangeFollower:
    """Checks whether messages of ``experience_map/changes`` can be applied in their order.

    Messages must not be applied before the first restart, nor after a gap in their numbers or a
    restart of the sender until the next one. Ask for it with the service
    ``experience_map/send_all``.
    """

    def __init__(self) -> None:
        self.needs_all = True
        """Whether the whole map must be requested."""
        self._sender = -1
        self._next = 0

    def accepts(self, message: MapChangePayload) -> bool:
        """Return whether a message continues the accepted ones; messages that do not are void."""
        follows = (message.sender, message.sequence) == (self._sender, self._next)
        self.needs_all = not message.restart and (self.needs_all or not follows)
        self._sender, self._next = message.sender, message.sequence + 1
        return not self.needs_all


class ClosurePayload(Payload, frozen=True):
    """A loop closure, its rejection, or a relocation."""

    TOPIC: ClassVar[str] = 'experience_map/closures'
    stamp: Stamp
    """That of the action."""
    sequence: Annotated[Count, Meta(examples=[125])]
    """That of the action."""
    outcome: Annotated[Literal['closed', 'rejected', 'relocated'], Meta(examples=['rejected'])]
    """`closed`: a new link connects two known experiences; `rejected`: the robot stays at the
    source ([algorithm.md](algorithm.md)); `relocated`: the robot is at the target, without a
    link."""
    source_id: Annotated[OptionalId, Meta(examples=[20])]
    """Experience at the start; -1 after a gap of the odometry."""
    target_id: Annotated[Id, Meta(examples=[12])]
    """Experience at the end."""
    reason: Annotated[Text, Meta(examples=[
        'moves the robot by 9.0 m, but drift explains at most 1.5 m; 1 of 6 closures agree'
    ])]
    """Why the closure was rejected or the robot relocated; empty for `closed`."""

    @classmethod
    def of(cls, stamp_ns: int, sequence: int, event: ClosureEvent) -> ClosurePayload:
        """Return the payload of an event, with the ids of the map."""
        return cls(Stamp.of(stamp_ns), sequence, *event)
