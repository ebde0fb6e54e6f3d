# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads of the mapping topics: templates, actions, active experiences and the map."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from operator import is_not
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.pose_cells.map_relocation import MapRelocation
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.local_view import FIXED_THRESHOLD, ViewMatch
from ratslam_ros.messages.json_schema import (
    MAX_ID,
    SCHEMA_VERSION,
    MalformedMessage,
    check_range,
    check_types,
    decode_fields,
    decode_stamp,
    encode_json,
    encode_stamp,
    shown,
)

MAX_COUNT = 2**63 - 1
"""Largest accepted sequence number and stamp of a memory: 64-bit integers."""
MAX_PLACE_CELLS = 100_000.0
MAX_SPACING_M = 1e9
BLOCK_ROWS = 128
"""Number of experiences or links that are written in one step, at about 4 us each."""
UNKNOWN_SENDER = 0
_SENDER = re.compile(r'"sender":\s*(\d{1,19})\s*[,}]')
MAX_GAIN, MAX_TURN_PER_M_RAD = 1000.0, 1000.0
"""Largest accepted corrections of odometry."""


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
    fields = {
        'schema_version': SCHEMA_VERSION,
        'stamp': encode_stamp(stamp_ns),
        'id': match.template_id,
        'is_new': match.is_new,
        'error': match.error,
        'relative_rad': match.relative_rad,
        'memory': memory_ns,
    }
    if match.threshold != FIXED_THRESHOLD:
        fields['threshold'] = match.threshold
    if match.related_count:
        fields['related'] = match.related_count
    if match.removed:
        fields['removed'] = match.removed
    if sender != UNKNOWN_SENDER:
        fields['sender'] = sender
    return encode_json(fields)


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
    fields = decode_fields(
        payload,
        'local_view/template',
        {
            'stamp': dict, 'id': int, 'is_new': bool, 'error': float, 'relative_rad': float,
            'memory': int,
        },
    )  # fmt: skip
    for key, low, high in (
        ('id', -1, MAX_ID), ('error', -1.0, 1.0), ('relative_rad', -math.pi, math.pi),
        ('memory', 0, MAX_COUNT),
    ):  # fmt: skip
        check_range('local_view/template', key, fields[key], low, high)
    fields.setdefault('threshold', FIXED_THRESHOLD)
    fields.setdefault('related', 0)
    check_types(fields, 'local_view/template', {'threshold': float, 'related': int})
    check_range('local_view/template', 'related', fields['related'], 0, MAX_ID)
    check_range('local_view/template', 'threshold', fields['threshold'], FIXED_THRESHOLD, 1.0)
    match = ViewMatch(
        fields['id'], fields['is_new'], fields['error'], fields['relative_rad'],
        fields['threshold'], fields['related'], _decode_removed(fields.get('removed', [])),
    )  # fmt: skip
    return decode_stamp(fields['stamp']), match, fields['memory']


def _decode_removed(ids: Any) -> tuple[int, ...]:
    """Return the ids of removed templates."""
    name = 'local_view/template'
    if not isinstance(ids, list):
        raise MalformedMessage(f'{name}: removed is {shown(ids)}; expected an array of ids')
    for template_id in ids:
        check_types({'removed': template_id}, name, {'removed': int})
        check_range(name, 'removed', template_id, 0, MAX_ID)
    return tuple(ids)


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
    fields: dict[str, Any] = {
        'schema_version': SCHEMA_VERSION,
        'stamp': encode_stamp(stamp_ns),
        'sequence': sequence,
        'action': action.action,
        'source_id': action.source_id,
        'target_id': action.target_id,
        'template_id': action.template_id,
        'relative_rad': action.relative_rad,
        **({} if action.relative_m == (0.0, 0.0) else
           dict(zip(('relative_x_m', 'relative_y_m'), action.relative_m, strict=True))),
        'pc_x': action.place.x,
        'pc_y': action.place.y,
        'pc_theta': action.place.theta,
        'memory': memory_ns,
    }
    if action.relative_m != (0.0, 0.0):
        fields['relative_x_m'], fields['relative_y_m'] = action.relative_m
    if action.view_spacing_m > 0.0:
        fields['recognised_id'] = action.recognised_id
        fields['agreement'] = action.agreement
        fields['view_spacing_m'] = action.view_spacing_m
    if action.correction is not None:
        fields['correction'] = action.correction._asdict()
    if sender != UNKNOWN_SENDER:
        fields['sender'] = sender
    return encode_json(fields)


def decode_action(payload: str) -> tuple[int, int, MapAction, int]:
    """Return (stamp_ns, sequence, action, memory_ns) of a ``pose_cells/action`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    name = 'pose_cells/action'
    fields = decode_fields(
        payload,
        name,
        {
            'stamp': dict, 'sequence': int, 'action': str, 'source_id': int, 'target_id': int,
            'template_id': int, 'relative_rad': float, 'pc_x': float, 'pc_y': float,
            'pc_theta': float, 'memory': int,
        },
    )  # fmt: skip
    kind = fields['action']
    if kind not in ('create', 'link', 'set', 'none'):
        raise MalformedMessage(
            f'{name}: action is {shown(kind)}; expected create, link, set or none'
        )
    min_id = -1 if kind == 'none' else 0
    for key, low, high in (
        ('sequence', 0, MAX_COUNT), ('source_id', -1, MAX_ID), ('target_id', min_id, MAX_ID),
        ('template_id', min_id, MAX_ID), ('relative_rad', -math.pi, math.pi),
        ('pc_x', 0.0, MAX_PLACE_CELLS), ('pc_y', 0.0, MAX_PLACE_CELLS),
        ('pc_theta', 0.0, MAX_PLACE_CELLS), ('memory', 0, MAX_COUNT),
    ):  # fmt: skip
        check_range(name, key, fields[key], low, high)
    position = {key: fields.get(key, 0.0) for key in ('relative_x_m', 'relative_y_m')}
    check_types(position, name, dict.fromkeys(position, float))
    fields.setdefault('recognised_id', NO_EXPERIENCE)
    fields.setdefault('agreement', 0.0)
    fields.setdefault('view_spacing_m', 0.0)
    check_types(
        fields, name, {'recognised_id': int, 'agreement': float, 'view_spacing_m': float}
    )
    check_range(name, 'recognised_id', fields['recognised_id'], NO_EXPERIENCE, MAX_ID)
    check_range(name, 'agreement', fields['agreement'], 0.0, 1.0)
    check_range(name, 'view_spacing_m', fields['view_spacing_m'], 0.0, MAX_SPACING_M)
    action = MapAction(
        kind, fields['source_id'], fields['target_id'], fields['template_id'],
        fields['relative_rad'], Place(fields['pc_x'], fields['pc_y'], fields['pc_theta']),
        _decode_correction(name, fields.get('correction')),
        (position['relative_x_m'], position['relative_y_m']),
        fields['recognised_id'], fields['agreement'], fields['view_spacing_m'],
    )  # fmt: skip
    return decode_stamp(fields['stamp']), fields['sequence'], action, fields['memory']


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
    fields: dict[str, Any] = {
        'schema_version': SCHEMA_VERSION, 'stamp': encode_stamp(stamp_ns), 'sequence': sequence,
        'memory': memory_ns,
    }  # fmt: skip
    if relocation is not None:
        x_m, y_m, heading_rad = relocation.offset
        fields['relocation'] = {
            'experience_id': relocation.experience_id, 'template_id': relocation.template_id,
            'relative_x_m': x_m, 'relative_y_m': y_m, 'relative_rad': heading_rad,
        }  # fmt: skip
    return encode_json(fields)


def decode_relocation(payload: str) -> tuple[int, MapRelocation | None, int]:
    """Return (sequence, relocation, memory_ns) of an ``experience_map/relocation`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    name = 'experience_map/relocation'
    fields = decode_fields(payload, name, {'stamp': dict, 'sequence': int, 'memory': int})
    for key in ('sequence', 'memory'):
        check_range(name, key, fields[key], 0, MAX_COUNT)
    decode_stamp(fields['stamp'])
    place = fields.get('relocation')
    if place is None:
        return fields['sequence'], None, fields['memory']
    if not isinstance(place, dict):
        raise MalformedMessage(f'{name}: relocation is {shown(place)}; expected an object')
    check_types(place, name, {
        'experience_id': int, 'template_id': int, 'relative_x_m': float, 'relative_y_m': float,
        'relative_rad': float,
    })  # fmt: skip
    for key, low, high in (
        ('experience_id', 0, MAX_ID), ('template_id', 0, MAX_ID),
        ('relative_rad', -math.pi, math.pi),
    ):  # fmt: skip
        check_range(name, key, place[key], low, high)
    relocation = MapRelocation(
        place['experience_id'], place['template_id'],
        Pose(place['relative_x_m'], place['relative_y_m'], place['relative_rad']),
    )  # fmt: skip
    return fields['sequence'], relocation, fields['memory']


def _decode_correction(name: str, fields: Any) -> TurnCorrection | None:
    """Return the correction of an action, None if the sender does not calibrate."""
    if fields is None:
        return None
    if not isinstance(fields, dict):
        raise MalformedMessage(f'{name}: correction is {shown(fields)}; expected an object')
    check_types(fields, name, {'gain': float, 'per_m_rad': float})
    check_range(name, 'gain', fields['gain'], 1.0 / MAX_GAIN, MAX_GAIN)
    check_range(name, 'per_m_rad', fields['per_m_rad'], -MAX_TURN_PER_M_RAD, MAX_TURN_PER_M_RAD)
    return TurnCorrection(fields['gain'], fields['per_m_rad'])


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
    return encode_json(
        {
            'schema_version': SCHEMA_VERSION,
            'stamp': encode_stamp(stamp_ns),
            'goal': goal,
            'bearing_rad': bearing_rad,
            'remaining_s': remaining_s if math.isfinite(remaining_s) else None,
            'reached': reached,
        }
    )


def encode_active(stamp_ns: int, template_id: int, active: Sequence[tuple[int, float]]) -> str:
    """Return the payload of ``pose_cells/active_experiences``.

    Args:
        stamp_ns: stamp of the template message.
        template_id: the current template.
        active: (id, activity) of the template's experiences near the activity peak.
    """
    return encode_json(
        {
            'schema_version': SCHEMA_VERSION,
            'stamp': encode_stamp(stamp_ns),
            'template_id': template_id,
            'experiences': [{'id': i, 'activity': activity} for i, activity in active],
        }
    )


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
        head = encode_json(
            {
                'schema_version': SCHEMA_VERSION,
                'frame_id': experience_map.frame_id,
                'stamp': encode_stamp(stamp_ns),
                'current_experience_id': experience_map.current_id,
                **({'components': components} if any(components) else {}),
            }
        )
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
