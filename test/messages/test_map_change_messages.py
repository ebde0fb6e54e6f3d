# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON of changes of the map and of closures: round trip, strict decoding, gaps."""

from __future__ import annotations

import contextlib
import json
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from states import differences

from ratslam_ros.core.mapping.loop_closure_gate import ClosureEvent
from ratslam_ros.core.mapping.map_changes import ExperienceRows, LinkRows, MapChange
from ratslam_ros.messages.json_schema import MalformedMessage, decode, encode
from ratslam_ros.messages.map_changes import ClosurePayload, MapChangeFollower, MapChangePayload

CHANGE = MapChange(
    1_700_000_012_500_000_000, 20, 19, False,
    ExperienceRows(
        np.array([3, 19]), np.array([5, 1000]),
        np.array([[1.5, -2.25, 3.142], [0.0, 0.001, -1.0]]), np.array([0, 2]),
    ),
    LinkRows(
        np.array([[3, 19], [19, 3]]), np.array([[0.5, -3.141, 3.142], [1e3, 0.0, 0.001]]),
        np.array([0.033, 12.5]), np.array([1.0, 0.333]), np.array([1, 17]),
        np.array([False, True]), ('left_wall', ''),
    ),
    np.array([[7, 8]]), 12,
)
EMPTY = MapChange(0, 0, -1, True)


@pytest.mark.parametrize('change', [CHANGE, EMPTY, replace(CHANGE, links=LinkRows())])
def test_round_trip_keeps_every_field(change: MapChange) -> None:
    text = encode(MapChangePayload.of(change, 41, 99, 'map'))
    message = decode(MapChangePayload, text)
    assert list(differences(asdict(message.change), asdict(change))) == []
    assert (message.sequence, message.sender, message.frame_id) == (41, 99, 'map')
    assert encode(MapChangePayload.of(message.change, 41, 99, 'map')) == text


def test_numbers_are_rounded_integers() -> None:
    rows = ExperienceRows(
        np.array([0]), np.array([0]), np.array([[1.23456, -0.0004, 1.5708]]), np.array([0])
    )
    text = encode(MapChangePayload.of(MapChange(0, 1, 0, False, rows), 0, 0, 'map'))
    assert json.loads(text)['experiences'] == {
        'ids': [0], 'template_ids': [0], 'x_mm': [1235], 'y_mm': [0], 'heading_mrad': [1571],
    }


def changed(path: str, value: Any) -> str:
    """Return the encoded change with one value replaced; None removes it."""
    found = json.loads(encode(MapChangePayload.of(CHANGE, 41, 99, 'map')))
    at = found
    *parents, last = path.split('.')
    for key in parents:
        at = at[key]
    if value is None:
        del at[last]
    else:
        at[last] = value
    return json.dumps(found)


@pytest.mark.parametrize(('path', 'value'), [
    ('schema_version', 2), ('sequence', -1), ('sequence', 1.0), ('sender', 2**64),
    ('restart', 1), ('experience_count', 10**9), ('experience_count', -1),
    ('experience_count', 5), ('current_experience_id', 20), ('pending', None), ('frame_id', 7),
    ('frame_id', 'm' * 2000), ('experiences', []), ('experiences.ids', [3]),
    ('experiences.ids', [3, 20]), ('experiences.ids', [3, 3]), ('experiences.ids', [3, -1]),
    ('experiences.ids', [3, True]), ('experiences.x_mm', [1.5, 2]),
    ('experiences.x_mm', [0, 10**18]), ('experiences.heading_mrad', None),
    ('experiences.heading_mrad', [0, 7000]), ('experiences.y_mm', {'0': 1}),
    ('experiences.components', [0, -1]), ('links.source_ids', [3, 20]),
    ('links.counts', [1, 2**70]), ('links.confidence_1000', [0, 1001]),
    ('links.recognised', [0, 2]), ('links.behaviours', [0, 2]), ('links.names', None),
    ('links.names', [1, 2]), ('links.names', ['a' * 2000, '']), ('removed_links', 5),
    ('removed_links.target_ids', None), ('removed_links.target_ids', [20]), ('stamp', {}),
])
def test_malformed_change_is_refused(path: str, value: Any) -> None:
    with pytest.raises(MalformedMessage, match=r'experience_map/changes|stamp'):
        decode(MapChangePayload, changed(path, value))


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=40), st.integers(0, 2000), st.integers(0, 60))
def test_damaged_change_is_refused_or_decoded(inserted: str, start: int, length: int) -> None:
    text = encode(MapChangePayload.of(CHANGE, 41, 99, 'map'))
    start %= len(text)
    damaged = text[:start] + inserted + text[start + length :]
    with contextlib.suppress(MalformedMessage):
        decode(MapChangePayload, damaged)


def message(sequence: int, sender: int = 1, restart: bool = False) -> MapChangePayload:
    return MapChangePayload.of(MapChange(0, 0, -1, restart), sequence, sender, 'map')


def test_follower_waits_for_the_first_restart() -> None:
    follower = MapChangeFollower()
    assert follower.needs_all
    assert not follower.accepts(message(5))
    assert follower.accepts(message(6, restart=True))
    assert follower.accepts(message(7))
    assert not follower.needs_all


def test_follower_needs_all_after_a_gap() -> None:
    follower = MapChangeFollower()
    follower.accepts(message(0, restart=True))
    assert not follower.accepts(message(3))
    assert follower.needs_all
    assert not follower.accepts(message(4))
    assert follower.accepts(message(5, restart=True))


def test_follower_needs_all_after_a_restarted_sender() -> None:
    follower = MapChangeFollower()
    follower.accepts(message(0, restart=True))
    assert not follower.accepts(message(1, sender=2))
    assert follower.needs_all


CLOSURE = ClosureEvent('rejected', 11, 2, 'moves the robot by 9.0 m')


@pytest.mark.parametrize('event', [CLOSURE, ClosureEvent('closed', -1, 0)])
def test_closure_round_trip(event: ClosureEvent) -> None:
    sent = ClosurePayload.of(12, 3, event)
    assert decode(ClosurePayload, encode(sent)) == sent


@pytest.mark.parametrize(('key', 'value'), [
    ('outcome', 'open'), ('source_id', -2), ('target_id', -1), ('reason', 'x' * 2000),
    ('sequence', True), ('stamp', {'sec': 0}),
])
def test_malformed_closure_is_refused(key: str, value: Any) -> None:
    found = json.loads(encode(ClosurePayload.of(12, 3, CLOSURE)))
    with pytest.raises(MalformedMessage):
        decode(ClosurePayload, json.dumps({**found, key: value}))
