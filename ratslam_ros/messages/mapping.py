# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads of the mapping topics: templates, actions, active experiences and the map."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from operator import is_not
from typing import Annotated, ClassVar, Literal

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import astuple
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.pose_cells.map_relocation import MapRelocation
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.local_view import FIXED_THRESHOLD, ViewMatch
from ratslam_ros.messages.json_schema import (
    Angle,
    Count,
    Id,
    MalformedMessage,
    OptionalId,
    Payload,
    Stamp,
    decode,
    encode,
    encode_json,
    finite,
    only_if,
)

BLOCK_ROWS = 128
"""Number of experiences or links that are written in one step, at about 4 us each."""
UNKNOWN_SENDER = 0
_SENDER = re.compile(r'"sender":\s*(\d{1,19})\s*[,}]')
_Cells = Annotated[float, Meta(ge=0.0, le=100_000.0)]


class _Template(Payload, frozen=True):
    TOPIC: ClassVar[str] = 'local_view/template'
    stamp: Stamp
    id: OptionalId
    is_new: bool
    error: Annotated[float, Meta(ge=-1.0, le=1.0)]
    relative_rad: Angle
    memory: Count
    threshold: Annotated[float, Meta(ge=FIXED_THRESHOLD, le=1.0)] = FIXED_THRESHOLD
    related: Id = 0
    removed: tuple[Id, ...] = ()
    sender: Count = UNKNOWN_SENDER


def encode_template(
    stamp_ns: int, match: ViewMatch, memory_ns: int, sender: int = UNKNOWN_SENDER
) -> str:  # fmt: skip
    """Return the payload of ``local_view/template``.

    Args:
        stamp_ns: stamp of the image.
        match: the matched or learned template.
        memory_ns: stamp at which the first template was learned, 0 before.
        sender: number of the node that sends it, see ``sender_of``.
    """
    return encode(_Template(
        Stamp.of(stamp_ns), match.template_id, match.is_new, match.error, match.relative_rad,
        memory_ns, only_if(match.threshold != FIXED_THRESHOLD, match.threshold),
        only_if(match.related_count != 0, match.related_count),
        only_if(match.removed != (), match.removed), only_if(sender != UNKNOWN_SENDER, sender),
    ))  # fmt: skip


def sender_of(payload: str) -> int:
    """Return the number of the node that has sent a template or an action.

    Nodes draw their numbers at their start, so two with the same name differ. A message of earlier
    versions has no number: the result is ``UNKNOWN_SENDER``.
    """
    found = _SENDER.search(payload)
    return UNKNOWN_SENDER if found is None else int(found[1])


def decode_template(payload: str) -> tuple[int, ViewMatch, int]:
    """Return (stamp_ns, match, memory_ns) of a ``local_view/template`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    found = decode(_Template, payload)
    match = ViewMatch(
        found.id, found.is_new, found.error, found.relative_rad, found.threshold, found.related,
        found.removed,
    )  # fmt: skip
    return found.stamp.ns, match, found.memory


class _TurnCorrection(Struct, frozen=True):
    gain: Annotated[float, Meta(ge=0.001, le=1000.0)]
    per_m_rad: Annotated[float, Meta(ge=-1000.0, le=1000.0)]


class _Action(Payload, frozen=True, kw_only=True):
    TOPIC: ClassVar[str] = 'pose_cells/action'
    stamp: Stamp
    sequence: Count
    action: Literal['create', 'link', 'set', 'none']
    source_id: OptionalId
    target_id: OptionalId
    template_id: OptionalId
    relative_rad: Angle
    pc_x: _Cells
    pc_y: _Cells
    pc_theta: _Cells
    memory: Count
    recognised_id: OptionalId = NO_EXPERIENCE
    agreement: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    view_spacing_m: Annotated[float, Meta(ge=0.0, le=1e9)] = 0.0
    correction: _TurnCorrection | None = None
    sender: Count = UNKNOWN_SENDER


def encode_action(
    stamp_ns: int, sequence: int, action: MapAction, memory_ns: int,
    sender: int = UNKNOWN_SENDER,
) -> str:  # fmt: skip
    """Return the payload of ``pose_cells/action``.

    Args:
        stamp_ns: stamp of the template message.
        sequence: number of the action, counted from 0, by which receivers detect lost actions.
        action: the change of the map.
        memory_ns: stamp at which the first experience was created, 0 before.
        sender: number of the node that sends it, see ``sender_of``.
    """
    is_recognised = action.view_spacing_m > 0.0
    correction = None if action.correction is None else _TurnCorrection(*action.correction)
    return encode(_Action(
        stamp=Stamp.of(stamp_ns), sequence=sequence, action=action.action,
        source_id=action.source_id, target_id=action.target_id, template_id=action.template_id,
        relative_rad=action.relative_rad,
        pc_x=action.place.x, pc_y=action.place.y, pc_theta=action.place.theta, memory=memory_ns,
        recognised_id=only_if(is_recognised, action.recognised_id),
        agreement=only_if(is_recognised, action.agreement),
        view_spacing_m=only_if(is_recognised, action.view_spacing_m),
        correction=only_if(correction is not None, correction),
        sender=only_if(sender != UNKNOWN_SENDER, sender),
    ))  # fmt: skip


def decode_action(payload: str) -> tuple[int, int, MapAction, int]:
    """Return (stamp_ns, sequence, action, memory_ns) of a ``pose_cells/action`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    found = decode(_Action, payload)
    if found.action != 'none' and min(found.target_id, found.template_id) < 0:
        raise MalformedMessage(
            f'{found.TOPIC}: {found.action} has target_id {found.target_id} and template_id '
            f'{found.template_id}; expected at least 0'
        )
    correction = None
    if found.correction is not None:
        correction = TurnCorrection(found.correction.gain, found.correction.per_m_rad)
    action = MapAction(
        found.action, found.source_id, found.target_id, found.template_id, found.relative_rad,
        Place(found.pc_x, found.pc_y, found.pc_theta), correction,
        found.recognised_id, found.agreement, found.view_spacing_m,
    )  # fmt: skip
    return found.stamp.ns, found.sequence, action, found.memory


class _MapRelocation(Struct, frozen=True):
    experience_id: Id
    template_id: Id
    relative_x_m: float
    relative_y_m: float
    relative_rad: Angle


class _Relocation(Payload, frozen=True):
    TOPIC: ClassVar[str] = 'experience_map/relocation'
    stamp: Stamp
    sequence: Count
    memory: Count
    relocation: _MapRelocation | None = None


def encode_relocation(
    stamp_ns: int, sequence: int, relocation: MapRelocation | None, memory_ns: int
) -> str:
    """Return the payload of ``experience_map/relocation``, the map's answer to an action.

    Args:
        stamp_ns: stamp of the action.
        sequence: number of the action.
        relocation: where scans have relocated the robot after the action, with the ids of the
            pose cells; None if they have not.
        memory_ns: the ``memory`` of the action.
    """
    place = None
    if relocation is not None:
        place = _MapRelocation(
            relocation.experience_id, relocation.template_id, *relocation.offset
        )
    return encode(_Relocation(
        Stamp.of(stamp_ns), sequence, memory_ns, only_if(place is not None, place)
    ))  # fmt: skip


def decode_relocation(payload: str) -> tuple[int, MapRelocation | None, int]:
    """Return (sequence, relocation, memory_ns) of an ``experience_map/relocation`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    found = decode(_Relocation, payload)
    relocation = None
    if found.relocation is not None:
        experience_id, template_id, *offset = astuple(found.relocation)
        relocation = MapRelocation(experience_id, template_id, Pose(*offset))
    return found.sequence, relocation, found.memory


class _GoalMemory(Payload, frozen=True):
    stamp: Stamp
    goal: str
    bearing_rad: float | None
    remaining_s: float | None
    reached: bool


def encode_goal_memory(
    stamp_ns: int, goal: str, bearing_rad: float | None, remaining_s: float, reached: bool
) -> str:
    """Return the payload of ``pose_cells/goal_memory``.

    Args:
        stamp_ns: stamp of the odometry.
        goal: name of the goal.
        bearing_rad: direction to the goal relative to the robot, positive to the left; None if
            there is none.
        remaining_s: expected time to the goal; infinite if no route is known.
        reached: whether the robot is at the goal.
    """
    return encode(
        _GoalMemory(Stamp.of(stamp_ns), goal, bearing_rad, finite(remaining_s), reached)
    )


class _Active(Struct, frozen=True):
    id: int
    activity: float


class _ActiveExperiences(Payload, frozen=True):
    stamp: Stamp
    template_id: int
    experiences: list[_Active]


def encode_active(stamp_ns: int, template_id: int, active: Sequence[tuple[int, float]]) -> str:
    """Return the payload of ``pose_cells/active_experiences``.

    Args:
        stamp_ns: stamp of the template message.
        template_id: the current template.
        active: (id, activity) of the template's experiences near the activity peak.
    """
    experiences = [_Active(*one) for one in active]
    return encode(_ActiveExperiences(Stamp.of(stamp_ns), template_id, experiences))


class _MapHead(Payload, frozen=True):
    """The map without its experiences and links, which ``MapText`` writes.

    ``components``: number of the component of each experience, if there are several.
    """

    frame_id: str
    stamp: Stamp
    current_experience_id: int
    components: Sequence[int]


def encode_map(
    stamp_ns: int, experience_map: ExperienceMap, map_text: MapText | None = None
) -> str:
    """Return the whole graph as JSON: the content of map.json and of ``experience_map/map``.

    Args:
        stamp_ns: stamp of the last applied action that had a template, 0 before the first.
        experience_map: the graph.
        map_text: cache of the texts of an earlier call; it changes the time, not the result.

    Raises:
        ValueError: a number of the graph is not finite.
    """
    text = map_text or MapText()
    for _ in text.update(stamp_ns, experience_map):
        pass
    return b''.join(text.parts).decode('ascii')


class MapText:
    """Cache of the JSON text of a map.

    Only items that have changed are written again. Every item is compared with the values its
    text was made of, so that each update may be of any map. An update consists of short steps,
    between which the map may change. Texts are kept in flat lists, since the garbage collector
    would traverse a container per item.
    """

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        """Text of the last complete update, in parts to be joined."""
        self._places: tuple[list[object], list[str]] = [], []
        self._experiences = _Texts(numbers=3)
        self._links = _Texts(numbers=6)

    def update(self, stamp_ns: int, experience_map: ExperienceMap) -> Iterator[None]:
        """Write the text of a map as it is at the first step.

        An update that is not completed leaves the text of the last one; the next one continues
        with the items that were written.

        Args:
            stamp_ns, experience_map: as for ``encode_map``.

        Yields:
            None after each step, which takes about 0.5 ms if all of its items have changed.
        """
        components = experience_map.components
        head = encode(_MapHead(
            experience_map.frame_id, Stamp.of(stamp_ns), experience_map.current_id,
            only_if(any(components), components),
        ))  # fmt: skip
        labels, poses = list(experience_map.labels), experience_map.poses
        ends, notes = experience_map.link_ends.copy(), list(experience_map.link_notes)
        lengths = np.column_stack([experience_map.link_shapes, experience_map.link_durations_s])
        yield from self._experiences.update(labels, poses, self._write_experiences(labels, poses))
        yield from self._links.update(
            notes, np.column_stack([ends, lengths]), _write_links(ends, notes, lengths)
        )
        self.parts = [
            head[:-1].encode(), b',"experiences":[', *self._experiences.blocks, b'],"links":[',
            *self._links.blocks, b']}',
        ]  # fmt: skip

    def _write_experiences(
        self, labels: list[tuple[int, Place]], poses: NDArray[np.float64]
    ) -> Callable[[list[int]], list[str]]:
        # Cached apart from the poses: a relaxation moves all poses and no place.
        known, texts = self._places
        added = len(labels) - len(known)
        known.extend([None] * added)
        texts.extend([''] * added)

        def write(rows: list[int]) -> list[str]:
            others = [row for row in rows if labels[row] is not known[row]]
            if others:
                axes = (_numbers([labels[row][1][axis] for row in others]) for axis in range(3))
                for row, x, y, theta in zip(others, *axes, strict=True):
                    known[row] = labels[row]
                    texts[row] = f',"pc_x":{x},"pc_y":{y},"pc_theta":{theta}'
            poses_of = map(_numbers, poses[rows].T.tolist())
            return [
                f'{"," if row else ""}{{"id":{row},"template_id":{labels[row][0]},'
                f'"x_m":{x},"y_m":{y},"heading_rad":{heading}{texts[row]}}}'
                for row, x, y, heading in zip(rows, *poses_of, strict=True)
            ]

        return write


def _write_links(
    ends: NDArray[np.int64], notes: list[tuple[str, int]], lengths: NDArray[np.float64]
) -> Callable[[list[int]], list[str]]:
    def write(rows: list[int]) -> list[str]:
        behaviours = {name: encode_json(name) for name in {notes[row][0] for row in rows}}
        columns = *ends[rows].T.tolist(), *map(_numbers, lengths[rows].T.tolist())
        return [
            f'{"," if row else ""}{{"source_id":{source},"target_id":{target},'
            f'"distance_m":{distance},"heading_rad":{heading},"facing_rad":{facing},'
            f'"duration_s":{duration},"behaviour":{behaviours[notes[row][0]]},'
            f'"count":{notes[row][1]}}}'
            for row, source, target, distance, heading, facing, duration in zip(
                rows, *columns, strict=True
            )
        ]

    return write


class _Texts:
    """A list of texts, each kept until one of the values it was made of changes.

    The texts of ``BLOCK_ROWS`` rows are joined, because joining all of them takes milliseconds.
    """

    def __init__(self, numbers: int) -> None:
        self.blocks: list[bytes] = []
        """Joined texts of every block of rows."""
        self._objects: list[object] = []
        self._bits = np.empty((0, numbers), np.int64)
        self._texts: list[str] = []

    def update(
        self,
        objects: Sequence[object],
        numbers: NDArray[np.float64],
        write: Callable[[list[int]], list[str]],
    ) -> Iterator[None]:
        """Write the text of every row, in a step for each block.

        Args:
            objects: (n,) immutable objects that the texts are made of, compared by identity.
            numbers: (n, m) numbers that the texts are made of, m as passed to the constructor.
            write: returns the texts of the given rows.
        """
        count, known = len(objects), len(self._objects)
        bits = numbers.view(np.int64)  # 0.0 and -0.0 are equal, but their texts differ
        if count < known:
            del self._objects[count:], self._texts[count:]
            del self.blocks[count // BLOCK_ROWS :]
        elif count > known:
            self._objects.extend([None] * (count - known))
            self._texts.extend([''] * (count - known))
            more = np.empty((count - known, bits.shape[1]), np.int64)
            self._bits = np.concatenate([self._bits[:known], more])
        for first in range(0, count, BLOCK_ROWS):
            self._update_block(objects, bits, slice(first, first + BLOCK_ROWS), write)
            yield

    def _update_block(
        self, objects: Sequence[object], bits: NDArray[np.int64], block: slice,
        write: Callable[[list[int]], list[str]],
    ) -> None:  # fmt: skip
        now = objects[block]
        stale = np.fromiter(map(is_not, now, self._objects[block]), np.bool_, len(now))
        stale |= (bits[block] != self._bits[: len(bits)][block]).any(axis=1)
        rows = (block.start + np.flatnonzero(stale)).tolist()
        number = block.start // BLOCK_ROWS
        if rows:
            for row, text in zip(rows, write(rows), strict=True):
                self._objects[row], self._texts[row] = objects[row], text
            self._bits[rows] = bits[rows]
        elif number < len(self.blocks):
            return
        self.blocks[number : number + 1] = [''.join(self._texts[block]).encode('ascii')]


def _numbers(values: list[float]) -> list[str]:
    """Return the JSON text of each number, by one call of the encoder for all of them."""
    return encode_json(values)[1:-1].split(',')
