# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads of goals and behaviours: encoding and strict decoding.

Goals and names are typed by people: such a payload may leave out ``schema_version``, and unknown
keys are refused, so that a misspelt one is not ignored.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Goal, Position, Target
from ratslam_ros.core.navigation.navigator import GoalTask
from ratslam_ros.core.navigation.route_following import Guidance
from ratslam_ros.core.navigation.route_planner import TemporalMap
from ratslam_ros.limits import MAX_COORDINATE_M
from ratslam_ros.messages.json_schema import (
    MAX_ID,
    MAX_PAYLOAD_CHARACTERS,
    NS_PER_S,
    SCHEMA_VERSION,
    MalformedMessage,
    check_range,
    check_text,
    check_types,
    decode_fields,
    decode_stamp,
    encode_json,
    encode_stamp,
    shown,
)

MAX_OUTCOMES = 10
"""Number of ended goals listed in the status."""

MAX_BEHAVIOUR_CHARACTERS = 100

MAX_NAME_CHARACTERS = 100
"""Largest accepted name of a place."""

MAX_REQUEST_CHARACTERS = 100
"""Largest accepted name of a request."""

MAX_GOALS = 1000
"""Largest accepted number of goals in a request: each is planned a route to."""


_NEIGHBOUR: dict[str, type] = {'id': int, 'distance_m': float, 'direction_rad': float}
_TASK: dict[str, type] = {'number': int, 'goal': str, 'status': str, 'reason': str}
"""Fields of the objects in a status that are never null."""


@dataclass(frozen=True, slots=True)
class GoalRequest:
    """Places to drive to, in order, see ``Navigator.go_to``; or a request to cancel.

    ``request``: the client's name of the request; ``cancel``: name of the request whose goals are
    cancelled, without targets then.
    """

    targets: tuple[Target, ...] = ()
    append: bool = False
    timeout_s: float | None = None
    request: str = ''
    cancel: str = ''


@dataclass(frozen=True, slots=True)
class NameRequest:
    """A request to name the robot's current place, or to rename or remove a name."""

    name: str
    rename_to: str | None = None
    remove: bool = False


@dataclass(frozen=True, slots=True)
class BehaviourReport:
    """Behaviour of the robot from a stamp on.

    ``failed``: the attempt was blocked; ``ahead_rad``: its intended direction in the map's frame.
    """

    stamp_ns: int
    behaviour: str
    failed: bool = False
    ahead_rad: float = 0.0


def decode_goal(payload: str) -> GoalRequest:
    """Return the request of an ``experience_map/goal`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    name = 'experience_map/goal'
    fields = _typed(payload, name)
    if 'cancel' in fields:
        check_types(fields, name, {'cancel': str})
        _check_keys(fields, name, ('cancel',))
        check_text(name, 'cancel', fields['cancel'], MAX_REQUEST_CHARACTERS)
        if not fields['cancel']:
            raise MalformedMessage(f'{name}: cancel is empty; expected the name of a request')
        return GoalRequest(cancel=fields['cancel'])
    targets = [fields]
    options = {'append': bool, 'timeout_s': float, 'request': str}
    if 'goals' in fields:
        targets = fields['goals']
        if not isinstance(targets, list) or not targets:
            raise MalformedMessage(f'{name}: goals is {shown(targets)}; expected a list of goals')
        if len(targets) > MAX_GOALS:
            raise MalformedMessage(f'{name}: {len(targets)} goals; expected at most {MAX_GOALS}')
        _check_keys(fields, name, ('goals', *options))
    check_types(fields, name, {key: options[key] for key in options if key in fields})
    allowed = () if 'goals' in fields else tuple(options)
    timeout_s = fields.get('timeout_s')
    if timeout_s is not None:
        check_range(name, 'timeout_s', timeout_s, 0.0, 1e9)
    check_text(name, 'request', fields.get('request', ''), MAX_REQUEST_CHARACTERS)
    return GoalRequest(
        tuple(_target(target, name, allowed) for target in targets),
        fields.get('append', False), timeout_s, fields.get('request', ''),
    )  # fmt: skip


def encode_request(positions_m: Iterable[tuple[float, float]], request: str) -> str:
    """Return the payload of ``experience_map/goal`` that requests positions on the map.

    Args:
        positions_m: x and y of each goal in m, in order.
        request: name of the request, which the status repeats.
    """
    goals = [{'x_m': x, 'y_m': y} for x, y in positions_m]
    return encode_json({'schema_version': SCHEMA_VERSION, 'goals': goals, 'request': request})


def encode_cancel(request: str) -> str:
    """Return the payload of ``experience_map/goal`` that cancels the goals of a request."""
    return encode_json({'schema_version': SCHEMA_VERSION, 'cancel': request})


def _target(fields: Any, name: str, allowed: Sequence[str]) -> Target:
    if not isinstance(fields, dict):
        raise MalformedMessage(f'{name}: {shown(fields)} is not a goal; expected an object')
    kinds: tuple[Mapping[str, type], ...] = (
        {'name': str}, {'experience_id': int}, {'x_m': float, 'y_m': float},
    )  # fmt: skip
    given = [types for types in kinds if not types.keys().isdisjoint(fields)]
    if len(given) != 1:
        raise MalformedMessage(
            f'{name}: {shown(fields)} names {len(given) or "no"} places; expected one by name, '
            'by experience_id, or by x_m and y_m'
        )
    [types] = given
    check_types(fields, name, types)
    _check_keys(fields, name, (*types, *allowed))
    if 'x_m' in types:
        for key in types:
            check_range(name, key, fields[key], -MAX_COORDINATE_M, MAX_COORDINATE_M)
        return Position(fields['x_m'], fields['y_m'])
    if 'name' in types:
        check_text(name, 'name', fields['name'], MAX_NAME_CHARACTERS)
        return str(fields['name'])
    check_range(name, 'experience_id', fields['experience_id'], 0, MAX_ID)
    return int(fields['experience_id'])


def decode_name(payload: str) -> NameRequest:
    """Return the request of an ``experience_map/name_place`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    topic = 'experience_map/name_place'
    fields = _typed(payload, topic)
    types = {'name': str, 'rename_to': str, 'remove': bool}
    check_types(
        fields, topic, {key: types[key] for key in types if key == 'name' or key in fields}
    )
    _check_keys(fields, topic, tuple(types))
    for key in ('name', 'rename_to'):
        check_text(topic, key, fields.get(key, ''), MAX_NAME_CHARACTERS)
    request = NameRequest(**{key: fields[key] for key in types if key in fields})
    if request.remove and request.rename_to is not None:
        raise MalformedMessage(f'{topic}: {shown(fields)}; expected rename_to or remove')
    return request


def encode_behaviour(report: BehaviourReport) -> str:
    """Return the payload of ``goal_follower/behaviour``."""
    return encode_json(
        {
            'schema_version': SCHEMA_VERSION,
            'stamp': encode_stamp(report.stamp_ns),
            'behaviour': report.behaviour,
            'failed': report.failed,
            'ahead_rad': report.ahead_rad,
        }
    )


def decode_behaviour(payload: str) -> BehaviourReport:
    """Return the report of a ``goal_follower/behaviour`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    name = 'goal_follower/behaviour'
    types = {'stamp': dict, 'behaviour': str, 'failed': bool, 'ahead_rad': float}
    fields = decode_fields(payload, name, types)
    check_range(name, 'ahead_rad', fields['ahead_rad'], -math.tau, math.tau)
    if len(fields['behaviour']) > MAX_BEHAVIOUR_CHARACTERS:
        raise MalformedMessage(
            f'{name}: expected a behaviour of at most '
            f'{MAX_BEHAVIOUR_CHARACTERS} characters'
        )
    return BehaviourReport(
        decode_stamp(fields['stamp']), fields['behaviour'], fields['failed'], fields['ahead_rad']
    )


def encode_status(
    stamp_ns: int, experience_map: ExperienceMap, guidance: Guidance, queue: Iterable[GoalTask],
    outcomes: Iterable[GoalTask], reason: str = '', refused: str = '',
) -> str:  # fmt: skip
    """Return the payload of ``experience_map/status``.

    Args:
        stamp_ns: stamp of the odometry.
        experience_map: the map, for the neighbours of the current experience.
        guidance: the current guidance of the navigator.
        queue: the goals that have not ended.
        outcomes: the ended goals, of which the last MAX_OUTCOMES are listed.
        reason: why the last requested goal has no route, else empty.
        refused: name of the request that was refused for this reason, '' for none.
    """
    current_id = experience_map.current_id
    neighbours = experience_map.neighbours(current_id) if current_id >= 0 else []
    directions = [(other, experience_map.distance_and_direction(other)) for other in neighbours]
    goal, remaining_s = guidance.goal, guidance.remaining_s
    return encode_json(
        {
            'schema_version': SCHEMA_VERSION,
            'stamp': encode_stamp(stamp_ns),
            'status': guidance.status,
            'explore': guidance.explore,
            'behaviour': guidance.behaviour,
            'reason': reason,
            **({'refused': refused} if refused else {}),
            'experience_id': current_id,
            'neighbours': [
                {'id': i, 'distance_m': at.distance_m, 'direction_rad': at.direction_rad}
                for i, at in directions
            ],
            'goal': None if goal is None else {'x_m': goal.x_m, 'y_m': goal.y_m},
            'remaining_s': remaining_s if math.isfinite(remaining_s) else None,
            'replanned': guidance.replanned,
            'switched': guidance.switched,
            'queue': [_task_fields(task) for task in queue],
            'outcomes': [_task_fields(task) for task in list(outcomes)[-MAX_OUTCOMES:]],
        }
    )


def decode_status(payload: str) -> dict[str, Any]:
    """Return the fields of an ``experience_map/status`` payload, and its ``stamp_ns``.

    Missing ``behaviour``, of an earlier release, ``refused`` and ``request`` are set to ''.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    name = 'experience_map/status'
    fields = decode_fields(
        payload, name,
        {
            'stamp': dict, 'status': str, 'explore': bool, 'reason': str, 'experience_id': int,
            'neighbours': list, 'replanned': int, 'switched': int, 'queue': list,
            'outcomes': list,
        },
    )  # fmt: skip
    for key, types in (('neighbours', _NEIGHBOUR), ('queue', _TASK), ('outcomes', _TASK)):
        for entry in fields[key]:
            if not isinstance(entry, dict):
                raise MalformedMessage(f'{name}: {key} has {shown(entry)}; expected objects')
            if key != 'neighbours':
                entry.setdefault('request', '')
                types = types | {'request': str}
            check_types(entry, name, types)
    goal = fields.get('goal')
    if goal is not None:
        if not isinstance(goal, dict):
            raise MalformedMessage(f'{name}: goal is {shown(goal)}; expected an object or null')
        check_types(goal, name, {'x_m': float, 'y_m': float})
    if fields.get('remaining_s') is not None:
        check_types(fields, name, {'remaining_s': float})
    fields = {'behaviour': '', 'refused': '', **fields}
    check_types(fields, name, {'behaviour': str, 'refused': str})
    return {**fields, 'stamp_ns': decode_stamp(fields['stamp'])}


def _task_fields(task: GoalTask) -> dict[str, Any]:
    took_s = None
    if task.started_ns is not None and task.ended_ns is not None:
        took_s = (task.ended_ns - task.started_ns) / NS_PER_S
    return {
        'number': task.number, 'goal': task.asked, 'status': task.status,
        'reason': task.reason, 'expected_s': task.expected_s, 'took_s': took_s,
        **({'request': task.request} if task.request else {}),
    }  # fmt: skip


def encode_goals(experience_map: ExperienceMap, goals: Iterable[Goal]) -> str:
    """Return the answer of ``experience_map/list_goals``: the names and their poses on the map."""
    places = [(goal, goal.pose_on(experience_map)) for goal in goals]
    return encode_json(
        {
            'schema_version': SCHEMA_VERSION,
            'goals': [
                {
                    'name': goal.name, 'experience_id': goal.experience_id, 'x_m': pose.x_m,
                    'y_m': pose.y_m, 'heading_rad': pose.heading_rad,
                }
                for goal, pose in places
            ],
        }
    )  # fmt: skip


def encode_times(times: TemporalMap) -> str:
    """Return the answer of ``experience_map/temporal_map``; null for unreachable experiences."""
    return encode_json(
        {
            'schema_version': SCHEMA_VERSION,
            'experience_id': times.start_id,
            'arrival_s': [t if math.isfinite(t) else None for t in times.arrival_s.tolist()],
        }
    )


def _typed(payload: str, name: str) -> dict[str, Any]:
    """Return the fields of a payload typed by a person; ``schema_version`` may be left out."""
    fields = None
    if len(payload) < MAX_PAYLOAD_CHARACTERS:
        with suppress(ValueError, RecursionError):
            fields = json.loads(payload)
    if isinstance(fields, dict) and 'schema_version' not in fields:
        version = f'"schema_version":{SCHEMA_VERSION}{"," if fields else ""}'
        payload = f'{{{version}{payload.lstrip()[1:]}'
    return decode_fields(payload, name, {})


def _check_keys(fields: Mapping[str, Any], name: str, known: Sequence[str]) -> None:
    unknown = fields.keys() - {*known, 'schema_version'}
    if unknown:
        some = ', '.join(shown(key)[1:-1] for key in sorted(unknown)[:5])
        raise MalformedMessage(f'{name}: {some} is unknown here; expected {", ".join(known)}')
