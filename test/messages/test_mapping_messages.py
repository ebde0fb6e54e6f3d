# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Payloads: equal content gives equal bytes, and malformed payloads are refused entirely."""

import json
import math
import random
from dataclasses import replace
from typing import Any

import pytest
from helpers import START_NS, ahead, template_text, turning
from hypothesis import given
from hypothesis import strategies as st

from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.messages.json_schema import MalformedMessage, decode, encode
from ratslam_ros.messages.mapping import ActionPayload, TemplatePayload, encode_map
from ratslam_ros.messages.pose_cells import ActivePayload

KEYS = ['schema_version', 'stamp', 'id', 'is_new', 'error', 'relative_rad', 'memory']


def without(key: str) -> str:
    fields = json.loads(template_text(5, 3))
    del fields[key]
    return json.dumps(fields)


def refused(payload: str) -> str:
    with pytest.raises(MalformedMessage) as error:
        decode(TemplatePayload, payload)
    return str(error.value)


# Templates


@given(
    st.integers(0, 2**31 * 10**9 - 1), st.integers(-1, 10**6), st.booleans(), st.floats(-1.0, 1.0),
    st.floats(-3.14, 3.14), st.integers(0, 2**62), st.just(-1.0) | st.floats(0.0, 1.0),
    st.integers(0, 1000), st.lists(st.integers(0, 10**6), max_size=3).map(tuple),
)
def test_template_round_trips_bit_identically(
    stamp_ns: int, number: int, is_new: bool, error: float, relative: float, memory: int,
    threshold: float, related: int, removed: tuple[int, ...],
) -> None:
    match = ViewMatch(number, is_new, error, relative, threshold, related, removed)
    payload = encode(TemplatePayload.of(stamp_ns, match, memory))
    found = decode(TemplatePayload, payload)
    assert (found.stamp.ns, found.match, found.memory) == (stamp_ns, match, memory)
    assert encode(TemplatePayload.of(stamp_ns, found.match, memory)) == payload


def test_template_payload_has_exactly_the_documented_keys() -> None:
    match = ViewMatch(3, False, 0.1, -0.5, threshold=float('-1'))
    payload = encode(TemplatePayload.of(START_NS + 42, match, 7))
    assert payload == (
        '{"schema_version":1,"stamp":{"sec":1700000000,"nanosec":42},"id":3,"is_new":false,'
        '"error":0.1,"relative_rad":-0.5,"memory":7}'
    )


def test_automatic_template_payload_has_threshold_and_related() -> None:
    payload = encode(TemplatePayload.of(START_NS, ViewMatch(3, False, 0.1, 0.0, 0.2, 4), 7))
    assert payload.endswith('"memory":7,"threshold":0.2,"related":4}')
    for wrong in ('"threshold":1.5', '"threshold":"x"', '"related":-1', '"related":0.5'):
        key, _, _ = wrong.partition(':')
        value = {'"threshold"': '0.2', '"related"': '4'}[key]
        assert key.strip('"') in refused(payload.replace(f'{key}:{value}', wrong))


@pytest.mark.parametrize(('key', 'value'), [
    ('id', 1.0), ('id', -2), ('is_new', 1), ('error', '0.1'), ('error', 10**400),
    ('relative_rad', 7.0), ('memory', 2**63), ('memory', -1),
    ('schema_version', 0), ('schema_version', 2), ('schema_version', True),
    ('stamp', None), ('stamp', {'sec': 1}), ('stamp', {'sec': 1, 'nanosec': 10**9}),
    ('stamp', {'sec': 1, 'nanosec': -1}), ('stamp', {'sec': -1, 'nanosec': 0}),
    ('stamp', {'sec': 2**31, 'nanosec': 0}),
    ('removed', None), ('removed', [-1]), ('removed', [2**31]),
], ids=lambda value: str(value)[:30])
def test_template_with_invalid_value_is_refused(key: str, value: Any) -> None:
    assert key.split('_')[0] in refused(template_text(5, 3, **{key: value}))


@pytest.mark.parametrize('payload', [
    '', ' ', '{', 'nonsense', '[]', '3', 'null', '"text"', 'true', template_text(5, 3)[:-1],
    template_text(5, 3) + '}', '{}', '\x00', '[' * 100_000, '{"a":' * 100_000, '1' * 5000,
], ids=lambda payload: repr(payload[:12]))
def test_payload_that_is_no_json_object_is_refused(payload: str) -> None:
    assert len(refused(payload)) < 1000


def test_integer_is_accepted_and_converted_for_float() -> None:
    match = decode(TemplatePayload, template_text(5, 3, error=0, relative_rad=1)).match
    assert (match.error, match.relative_rad) == (0.0, 1.0)
    assert type(match.error) is type(match.relative_rad) is float


@given(st.sampled_from(KEYS), st.none() | st.integers() | st.floats() | st.text() | st.booleans())
def test_any_value_of_any_key_is_valid_or_refused(key: str, value: Any) -> None:
    try:
        found = decode(TemplatePayload, template_text(5, 3, **{key: value}))
    except MalformedMessage:
        return
    assert 0 <= found.stamp.ns < 2**31 * 10**9
    assert found.id >= -1
    assert abs(found.relative_rad) <= 3.15
    assert type(found.memory) is int


# The map


def small_map() -> ExperienceMap:
    graph = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0, exp_loops=0))
    graph.apply(MapAction('create', -1, 0, 4, 0.0, Place(1.0, 2.0, 3.5)))
    graph.integrate(turning(0.5))
    graph.integrate(ahead(2.0))
    graph.apply(MapAction('create', 0, 1, 6, 0.0, Place(2.0, 0.1, 35.9)), 'wänder')
    return graph


def plain_json(stamp_ns: int, graph: ExperienceMap) -> str:
    """Return the map's text by one plain call of json: the reference for ``encode_map``."""
    content = {
        'schema_version': 1,
        'frame_id': graph.frame_id,
        'stamp': {'sec': stamp_ns // 10**9, 'nanosec': stamp_ns % 10**9},
        'current_experience_id': graph.current_id,
        'view_spacing_m': graph.view_spacing_m,
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
            for e in graph.experiences()
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
                **({'share': share} if share < 1.0 else {}),
            }
            for link, share in zip(graph.links(), graph.link_table.shares.tolist(), strict=True)
        ],
    }
    return json.dumps(content, allow_nan=False, separators=(',', ':'))


def check_text(graph: ExperienceMap) -> None:
    """Check that the text has the values of the map, bit for bit; numbers are formatted freely."""
    content = json.loads(encode_map(START_NS, graph))
    assert json.dumps(content, separators=(',', ':')) == plain_json(START_NS, graph)


# Actions

ACTION_KEYS = [
    'schema_version', 'stamp', 'sequence', 'action', 'source_id', 'target_id', 'template_id',
    'relative_rad', 'pc_x', 'pc_y', 'pc_theta', 'memory',
]
ACTION = MapAction('link', 3, 4, 5, 0.5, Place(1.25, 2.5, 35.0))


def action_text(**changed: Any) -> str:
    return json.dumps(json.loads(encode(ActionPayload.of(START_NS, 8, ACTION, 7))) | changed)


@given(
    st.integers(0, 2**31 * 10**9 - 1), st.integers(0, 2**53),
    st.sampled_from(['create', 'link', 'set', 'none']), st.integers(-1, 10**6),
    st.integers(0, 10**6), st.integers(0, 10**6), st.floats(-3.14, 3.14),
    st.tuples(st.floats(0.0, 999.0), st.floats(0.0, 999.0), st.floats(0.0, 35.9)),
    st.integers(0, 2**62),
)
def test_action_round_trips_bit_identically(
    stamp_ns: int, sequence: int, kind: Any, source: int, target: int, template: int,
    relative: float, place: tuple[float, float, float], memory: int,
) -> None:
    action = MapAction(kind, source, target, template, relative, Place(*place))
    found = decode(ActionPayload, encode(ActionPayload.of(stamp_ns, sequence, action, memory)))
    assert (found.stamp.ns, found.sequence, found.change) == (stamp_ns, sequence, action)
    assert found.memory == memory


@pytest.mark.parametrize('optional', [
    {}, {'correction': TurnCorrection(1.0 / 3.0, -0.1 / 3.0)},
    {'recognised_id': 2, 'agreement': 2.0 / 7.0, 'view_spacing_m': 1.0 / 3.0},
], ids=['required', 'correction', 'recognition'])
def test_action_has_the_documented_keys_and_exact_values(optional: dict[str, Any]) -> None:
    action = replace(ACTION, **optional)
    payload = encode(ActionPayload.of(START_NS, 8, action, 7))
    assert list(json.loads(payload)) == [*ACTION_KEYS, *optional]
    assert decode(ActionPayload, payload).change == action


@pytest.mark.parametrize('changed', [
    {'recognised_id': -2}, {'recognised_id': 1.5}, {'agreement': 1.5}, {'agreement': '1'},
    {'view_spacing_m': -1.0}, {'view_spacing_m': 1e300},
])
def test_invalid_recognition_is_refused(changed: dict[str, Any]) -> None:
    with pytest.raises(MalformedMessage, match='pose_cells/action: '):
        decode(ActionPayload, action_text(**changed))


@pytest.mark.parametrize('correction', [
    1.0, {'gain': 1.0}, {'gain': 0.0, 'per_m_rad': 0.0}, {'gain': 1.0, 'per_m_rad': 1e9},
    {'gain': '1', 'per_m_rad': 0.0},
])
def test_invalid_correction_is_refused(correction: Any) -> None:
    with pytest.raises(MalformedMessage, match='pose_cells/action: '):
        decode(ActionPayload, action_text(correction=correction))


@pytest.mark.parametrize(('key', 'value'), [
    ('action', 'jump'), ('target_id', -1), ('template_id', -1), ('source_id', -2),
    ('target_id', 2**31), ('sequence', -1), ('memory', 2**63),
    ('stamp', {'sec': 2**31, 'nanosec': 0}), ('pc_x', -0.1), ('pc_theta', 1e9),
    ('relative_rad', 4.0), ('source_id', 1.5), ('schema_version', 2),
])
def test_action_with_invalid_value_is_refused(key: str, value: Any) -> None:
    with pytest.raises(MalformedMessage, match=key.split('_')[0]):
        decode(ActionPayload, action_text(**{key: value}))


# Active experiences


@given(
    st.integers(0, 2**31 * 10**9 - 1), st.integers(-1, 10**6),
    st.lists(st.tuples(st.integers(0, 10**6), st.floats(0.0, 2.0)), max_size=5),
)
def test_active_experiences_round_trip_bit_identically(
    stamp_ns: int, template_id: int, active: list[tuple[int, float]]
) -> None:
    fields = json.loads(encode(ActivePayload.of(stamp_ns, template_id, active)))
    assert list(fields) == ['schema_version', 'stamp', 'template_id', 'experiences']
    assert fields['stamp']['sec'] * 10**9 + fields['stamp']['nanosec'] == stamp_ns
    assert fields['template_id'] == template_id
    assert [(item['id'], item['activity']) for item in fields['experiences']] == active


def test_empty_map_is_encoded() -> None:
    assert encode_map(0, ExperienceMap(ExperienceMapParameters())) == (
        '{"schema_version":1,"frame_id":"map","stamp":{"sec":0,"nanosec":0},'
        '"current_experience_id":-1,"view_spacing_m":0.0,"experiences":[],"links":[]}'
    )


NAMES = ['', 'wander', 'wänder', '環境', 'say "go"\\\n', 'null', '\U0001f916', '\x00\x7f']
ODD = [0.0, -0.0, 1e-7, 1e-5, 0.1, 3.0, 1e15, 1e16, 1e22, 2.0**53, 5e-324, 1.7976931348623157e308]
PARAMETERS = [
    ExperienceMapParameters(map_frame='kärte"1"'),
    ExperienceMapParameters(exp_relaxation='sweep'),
    ExperienceMapParameters(exp_loops=0),
]


@pytest.mark.parametrize('seed', range(3))
def test_text_has_the_values_of_any_map(seed: int) -> None:
    rng = random.Random(seed)
    parameters = PARAMETERS[seed % len(PARAMETERS)]
    graph = ExperienceMap(parameters)
    check_text(graph)
    for step in range(150):
        graph.integrate(turning(rng.uniform(-2.0, 2.0)))
        graph.integrate(ahead(rng.choice([0.0, rng.uniform(0.0, 3.0)])))
        known, current = len(graph), graph.current_id
        place = Place(rng.uniform(0.0, 30.0), rng.choice([0.0, 7.0]), rng.uniform(0.0, 36.0))
        if known < 3 or rng.random() < 0.5:
            action = MapAction('create', current, known, step, rng.uniform(-0.1, 0.1), place)
        elif rng.random() < 0.3:
            action = MapAction('set', -1, rng.randrange(known), step, 0.0, place)
        else:  # few targets, so that links are averaged
            target = (current + rng.randrange(1, 3)) % known
            action = MapAction('link', current, target, step, rng.uniform(-0.1, 0.1), place)
        graph.apply(action, rng.choice(NAMES))
        if rng.random() < 0.1:
            graph.settle()
        if rng.random() < 0.1:
            state, graph = graph.state(), ExperienceMap(parameters)
            graph.restore(state)
        if rng.random() < 0.5:  # else several changes come at once
            check_text(graph)
    assert len(set(graph.link_table.counts.tolist())) > 2
    check_text(graph)


@given(st.lists(
    st.tuples(st.integers(0, 13), st.sampled_from(ODD) | st.floats(allow_nan=False,
                                                                   allow_infinity=False)),
    max_size=20,
))
def test_numbers_of_the_map_are_exact(changes: list[tuple[int, float]]) -> None:
    graph = small_map()
    check_text(graph)
    for at, value in changes:
        value = math.copysign(value, (-1) ** at)
        if at < 6:
            graph._poses.values[divmod(at, 3)] = value
        elif at < 9:
            graph.link_table.shapes[0, at - 6] = value
        elif at == 9:
            graph.link_table.durations_s[0] = value
        else:
            graph._labels[at % 2] = at, Place(value, at, -value)  # a whole number stays one
        check_text(graph)


@pytest.mark.parametrize('value', [math.nan, math.inf])
@pytest.mark.parametrize('part', ['poses', 'links', 'places'])
def test_map_with_a_number_that_is_not_finite_is_no_text(part: str, value: float) -> None:
    graph = small_map()
    if part == 'places':
        graph._labels[1] = 6, Place(2.0, value, 35.9)
    else:
        (graph._poses.values if part == 'poses' else graph.link_table.shapes)[0, 0] = value
    with pytest.raises(ValueError, match='JSON'):
        encode_map(0, graph)
