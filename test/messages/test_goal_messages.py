# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The JSON payloads of goals and behaviours."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from graphs import corridor
from msgspec import UNSET

from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Goal, Position, Target
from ratslam_ros.core.navigation.navigator import Navigator
from ratslam_ros.core.navigation.route_planner import TemporalMap
from ratslam_ros.messages.goals import (
    ArrivalTimes,
    BehaviourReport,
    GoalRequest,
    GoalStatus,
    NamedPlaces,
    NameRequest,
)
from ratslam_ros.messages.json_schema import MalformedMessage, decode, encode


@pytest.mark.parametrize(('payload', 'targets', 'append', 'timeout_s'), [
    ('{"name":"kitchen"}', ('kitchen',), False, UNSET),
    (' {"experience_id": 3, "append": true}', (3,), True, UNSET),
    ('{"x_m":1,"y_m":-2.5,"timeout_s":9}', (Position(1.0, -2.5),), False, 9.0),
    ('{"schema_version":1,"goals":[{"name":"a"},{"experience_id":0}]}', ('a', 0), False, UNSET),
])
def test_goal_request_accepts_every_kind_of_target(
    payload: str, targets: tuple[Target, ...], append: bool, timeout_s: Any
) -> None:
    found = decode(GoalRequest, payload)
    assert (found.targets, found.append, found.timeout_s) == (targets, append, timeout_s)


@pytest.mark.parametrize(('payload', 'reason'), [
    ('kitchen', 'not JSON'), ('[]', 'expected `object`'), ('{}', 'no place'),
    ('{"schema_version":2,"name":"a"}', 'schema_version is 2'),
    ('{"name":"a","experience_id":1}', 'name, experience_id; expected one place'),
    ('{"name":1}', 'name is 1; expected `str`'), ('{"x_m":1.0}', 'a goal with x_m; expected'),
    ('{"x_m":NaN,"y_m":0}', 'not JSON'), ('{"experience_id":true}', 'expected `int`'),
    ('{"experience_id":-1}', 'experience_id is -1'), ('{"name":"a","appent":true}', 'appent'),
    ('{"name":"a","append":1}', 'append is 1'), ('{"name":"a","timeout_s":-1}', 'timeout_s is -1'),
    ('{"goals":[]}', 'length >= 1'), ('{"goals":["a"]}', r"goals\[0\] is 'a'; expected `object`"),
    ('{"goals":[{"name":"a","append":true}]}', 'unknown field `append`'),
    ('{"goals":[{"name":"a"}],"name":"b"}', 'goals and name; expected only one'),
    ('{"name":"a","append":null}', 'append is None'), ('{"name":"a","a\\nb":1}', r'field `a\\nb`'),
])
def test_malformed_goal_request_is_refused_with_reason(payload: str, reason: str) -> None:
    with pytest.raises(MalformedMessage, match=reason):
        decode(GoalRequest, payload)


def test_name_request_names_renames_or_removes() -> None:
    assert decode(NameRequest, '{"name":"a"}') == NameRequest('a')
    assert decode(NameRequest, '{"name":"a","rename_to":"b"}') == NameRequest('a', rename_to='b')
    assert decode(NameRequest, '{"name":"a","remove":true}') == NameRequest('a', remove=True)
    for payload in ('{}', '{"name":"a","remove":true,"rename_to":"b"}', '{"name":"a","to":"b"}'):
        with pytest.raises(MalformedMessage):
            decode(NameRequest, payload)


def test_behaviour_report_round_trips_and_malformed_is_refused() -> None:
    report = BehaviourReport.of(1_700_000_000_500_000_000, 'left_wall', True, -1.25)
    assert decode(BehaviourReport, encode(report)) == report
    text = encode(report)
    for wrong in (
        text.replace('true', '1'), text.replace('-1.25', '9.0'), text.replace('"failed"', '"f"'),
        text.replace('left_wall', 'x' * 101), text.replace('500000000', '-1'),
    ):
        with pytest.raises(MalformedMessage):
            decode(BehaviourReport, wrong)


def test_status_contains_neighbours_queue_and_outcomes() -> None:
    graph = corridor(3, beyond_m=0.25)
    navigator = Navigator(GoalRecallParameters(), graph)
    navigator.goals.name_place(graph, 'here')
    navigator.go_to(1)
    navigator.go_to(0, 'here')
    guidance = navigator.update(0)
    text = encode(GoalStatus.of(
        5, graph, guidance, navigator.queue, navigator.outcomes, 'no such place'
    ))
    fields = decode(GoalStatus, text)
    assert (fields.status, fields.experience_id, fields.reason) == (
        'following', 2, 'no such place'
    )
    [neighbour] = fields.neighbours
    assert neighbour.id == 1
    assert neighbour.distance_m == pytest.approx(1.25)
    assert abs(neighbour.direction_rad) == pytest.approx(math.pi)
    assert [(task.goal, task.status) for task in fields.queue] == [
        ('experience 0', 'active'), ('here', 'queued')
    ]
    assert [(task.goal, task.status, task.took_s) for task in fields.outcomes] == [
        ('experience 1', 'cancelled', None)
    ]
    assert fields.remaining_s == pytest.approx(4.0)
    empty = ExperienceMap(ExperienceMapParameters())
    idle = Navigator(GoalRecallParameters(), empty)
    text = encode(GoalStatus.of(0, empty, idle.update(0), idle.queue, idle.outcomes))
    fields = decode(GoalStatus, text)
    assert (fields.status, fields.goal, fields.remaining_s) == ('idle', None, None)
    assert fields.neighbours == []


def test_named_places_and_arrival_times_are_encoded() -> None:
    graph = corridor(3, beyond_m=0.25)
    fields = json.loads(encode(NamedPlaces.of(graph, [Goal(1, name='kitchen')])))
    assert fields['goals'] == [
        {'name': 'kitchen', 'experience_id': 1, 'x_m': 1.0, 'y_m': 0.0, 'heading_rad': 0.0}
    ]
    times = TemporalMap(2, np.array([3.0, math.inf]), np.array([-1, -1], np.int32))
    fields = json.loads(encode(ArrivalTimes.of(times)))
    assert fields == {'schema_version': 1, 'experience_id': 2, 'arrival_s': [3.0, None]}
