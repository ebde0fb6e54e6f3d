# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The JSON payloads: encode, and decode strictly.

Stamps are integers ``sec`` and ``nanosec``; numbers are written as Python's repr gives them, keys
in a fixed order, and never NaN, so that equal content gives equal bytes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from ratslam_ros.core.experience_map import ExperienceMap
from ratslam_ros.core.local_view import ViewMatch
from ratslam_ros.core.pose_cells import MapAction
from ratslam_ros.core.torus import Place
from ratslam_ros.errors import UnusableInput

SCHEMA_VERSION = 1
NS_PER_S = 1_000_000_000
MOST_ID = 2**31 - 1
MOST_COUNT = 2**63 - 1
MOST_CELLS = 100_000.0


class MalformedMessage(UnusableInput):
    """A payload that does not fit its schema; none of it is used."""


def encode_template(stamp_ns: int, match: ViewMatch, memory_ns: int) -> str:
    """Return the payload of ``local_view/template``; ``memory_ns``: when the first was learned."""
    return _dumps(
        {
            'schema_version': SCHEMA_VERSION,
            'stamp': _stamp(stamp_ns),
            'id': match.template_id,
            'is_new': match.is_new,
            'error': match.error,
            'relative_rad': match.relative_rad,
            'memory': memory_ns,
        }
    )


def decode_template(payload: str) -> tuple[int, ViewMatch, int]:
    """Return (stamp_ns, match, memory_ns) of a ``local_view/template`` payload.

    Raises:
        MalformedMessage: it is not such a payload, to the last field.
    """
    fields = _loads(
        payload,
        'local_view/template',
        {
            'stamp': dict, 'id': int, 'is_new': bool, 'error': float, 'relative_rad': float,
            'memory': int,
        },
    )  # fmt: skip
    for key, low, high in (
        ('id', -1, MOST_ID), ('error', -1.0, 1.0), ('relative_rad', -math.pi, math.pi),
        ('memory', 0, MOST_COUNT),
    ):  # fmt: skip
        _check('local_view/template', key, fields[key], low, high)
    match = ViewMatch(fields['id'], fields['is_new'], fields['error'], fields['relative_rad'])
    return _stamp_ns(fields['stamp']), match, fields['memory']


def encode_action(stamp_ns: int, sequence: int, action: MapAction, memory_ns: int) -> str:
    """Return the payload of ``pose_cells/action``.

    ``sequence`` counts all actions from 0, so that a lost one is noticed; ``memory_ns``: when the
    first experience was made, 0 before.
    """
    return _dumps(
        {
            'schema_version': SCHEMA_VERSION,
            'stamp': _stamp(stamp_ns),
            'sequence': sequence,
            'action': action.action,
            'source_id': action.source_id,
            'target_id': action.target_id,
            'template_id': action.template_id,
            'relative_rad': action.relative_rad,
            'pc_x': action.place.x,
            'pc_y': action.place.y,
            'pc_theta': action.place.theta,
            'memory': memory_ns,
        }
    )


def decode_action(payload: str) -> tuple[int, int, MapAction, int]:
    """Return (stamp_ns, sequence, action, memory_ns) of a ``pose_cells/action`` payload.

    Raises:
        MalformedMessage: it is not such a payload, to the last field.
    """
    name = 'pose_cells/action'
    fields = _loads(
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
        raise MalformedMessage(f'{name}: action is {kind!r}; expected create, link, set or none')
    least = -1 if kind == 'none' else 0
    for key, low, high in (
        ('sequence', 0, MOST_COUNT), ('source_id', -1, MOST_ID), ('target_id', least, MOST_ID),
        ('template_id', least, MOST_ID), ('relative_rad', -math.pi, math.pi),
        ('pc_x', 0.0, MOST_CELLS), ('pc_y', 0.0, MOST_CELLS), ('pc_theta', 0.0, MOST_CELLS),
        ('memory', 0, MOST_COUNT),
    ):  # fmt: skip
        _check(name, key, fields[key], low, high)
    action = MapAction(
        kind, fields['source_id'], fields['target_id'], fields['template_id'],
        fields['relative_rad'], Place(fields['pc_x'], fields['pc_y'], fields['pc_theta']),
    )  # fmt: skip
    return _stamp_ns(fields['stamp']), fields['sequence'], action, fields['memory']


def encode_map(stamp_ns: int, experience_map: ExperienceMap) -> str:
    """Return the whole graph, for map.json and ``experience_map/map`` alike.

    ``stamp_ns`` is that of the last action applied, 0 before the first; an action without a
    template is not.
    """
    return _dumps(
        {
            'schema_version': SCHEMA_VERSION,
            'frame_id': experience_map.frame_id,
            'stamp': _stamp(stamp_ns),
            'current_experience_id': experience_map.current_id,
            'experiences': [
                {
                    'id': e.id,
                    'template_id': e.template_id,
                    'x_m': e.pose.x_m,
                    'y_m': e.pose.y_m,
                    'heading_rad': e.pose.heading_rad,
                    'pc_x': e.place.x,
                    'pc_y': e.place.y,
                    'pc_theta': e.place.theta,
                }
                for e in experience_map.experiences()
            ],
            'links': [
                {
                    'source_id': link.source_id,
                    'target_id': link.target_id,
                    'distance_m': link.distance_m,
                    'heading_rad': link.heading_rad,
                    'facing_rad': link.facing_rad,
                    'duration_s': link.duration_s,
                    'behaviour': link.behaviour,
                    'count': link.count,
                }
                for link in experience_map.links()
            ],
        }
    )


def _check(name: str, key: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise MalformedMessage(f'{name}: {key} is {value}; expected {low:.4g} to {high:.4g}')


def _dumps(value: Mapping[str, Any]) -> str:
    return json.dumps(value, allow_nan=False, separators=(',', ':'))


def _loads(payload: str, name: str, types: Mapping[str, type]) -> dict[str, Any]:
    """Return the fields of a payload that has the schema version and exactly these types."""
    try:
        fields = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise MalformedMessage(f'{name}: not JSON ({error}); expected an object') from None
    if not isinstance(fields, dict):
        raise MalformedMessage(f'{name}: {type(fields).__name__}; expected an object')
    version = fields.get('schema_version')
    if type(version) is not int or version != SCHEMA_VERSION:
        raise MalformedMessage(
            f'{name}: schema_version is {version!r}; expected '
            f'{SCHEMA_VERSION}: sender and receiver are of different versions'
        )
    for key, expected in types.items():
        value = fields.get(key)
        if expected is float and type(value) is int and abs(value) < 2**53:
            value = fields[key] = float(value)
        if not isinstance(value, expected) or (expected is int and isinstance(value, bool)):
            raise MalformedMessage(f'{name}: {key} is {value!r}; expected {expected.__name__}')
        if isinstance(value, float) and not math.isfinite(value):
            raise MalformedMessage(f'{name}: {key} is {value!r}; expected a finite number')
    return fields


def _stamp(stamp_ns: int) -> dict[str, int]:
    return {'sec': stamp_ns // NS_PER_S, 'nanosec': stamp_ns % NS_PER_S}


def _stamp_ns(stamp: Mapping[str, Any]) -> int:
    sec, nanosec = stamp.get('sec'), stamp.get('nanosec')
    if (
        type(sec) is not int
        or type(nanosec) is not int
        or not 0 <= sec < 2**31
        or not 0 <= nanosec < NS_PER_S
    ):
        raise MalformedMessage(
            f'stamp is {dict(stamp)!r}; expected integers, sec below 2^31 and nanosec below 10^9'
        )
    return sec * NS_PER_S + nanosec
