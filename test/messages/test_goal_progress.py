# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Progress of the goals of an action, from the statuses of the experience map."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from msgspec import UNSET

from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Goal
from ratslam_ros.core.navigation.navigator import GoalTask
from ratslam_ros.core.navigation.route_following import Guidance
from ratslam_ros.messages.goal_progress import (
    ANSWER_TIMEOUT_S,
    NO_PROGRESS,
    NO_ROUTE,
    UNKNOWN,
    GoalProgress,
    Outcome,
    refusal,
)
from ratslam_ros.messages.goals import GoalRequest, GoalStatus
from ratslam_ros.messages.json_schema import MalformedMessage, decode, encode

PLACES = [(1.0, 0.0), (1.0, 3.0)]


def task(number: int, status: str = 'queued', request: str = 'mine', reason: str = '') -> GoalTask:
    return GoalTask(number, Goal(number), f'goal{number}', status=status, reason=reason,
                    request=request)


def status(
    *queue: GoalTask, ended: tuple[GoalTask, ...] = (), guidance: str = 'following',
    remaining_s: float = 4.0, reason: str = '', refused: str = '',
) -> GoalStatus:
    empty = ExperienceMap(ExperienceMapParameters())
    given: Any = guidance
    payload = encode(GoalStatus.of(
        1, empty, Guidance(given, remaining_s=remaining_s), queue, ended, reason, refused
    ))
    return decode(GoalStatus, payload)


@pytest.fixture
def progress() -> GoalProgress:
    return GoalProgress('mine', PLACES, 10.0)


def test_request_succeeds_when_all_goals_have(progress: GoalProgress) -> None:
    progress.on_status(status(task(0, 'active'), task(1)))
    progress.on_status(status(task(1, 'active'), ended=(task(0, 'succeeded'),)))
    assert progress.outcome is None
    progress.on_status(status(ended=(task(0, 'succeeded'), task(1, 'succeeded'))))
    assert progress.outcome == Outcome('succeeded')


@pytest.mark.parametrize(
    ('final', 'code'), [('failed', NO_ROUTE), ('timed_out', NO_PROGRESS), ('cancelled', UNKNOWN)]
)
def test_first_goal_not_reached_aborts_request(
    progress: GoalProgress, final: str, code: int
) -> None:
    progress.on_status(status(task(1, 'active'), ended=(task(0, final, reason='because'),)))
    assert progress.outcome is not None
    assert (progress.outcome.kind, progress.outcome.code) == ('aborted', code)
    assert 'goal0' in progress.outcome.text
    assert 'because' in progress.outcome.text


def test_cancelled_goal_is_cancelled_only_if_asked_for(progress: GoalProgress) -> None:
    progress.on_status(status(task(0, 'active'), task(1)))
    progress.is_cancelled = True
    progress.on_status(status(ended=(task(0, 'cancelled'), task(1, 'cancelled'))))
    assert progress.outcome is not None
    assert progress.outcome.kind == 'cancelled'


def test_refused_request_is_aborted_with_reason(progress: GoalProgress) -> None:
    progress.on_status(status(reason='too far', refused='other'))
    assert progress.outcome is None
    progress.on_status(status(reason='too far', refused='mine'))
    assert progress.outcome == Outcome('aborted', NO_ROUTE, 'too far')


def test_goals_of_others_do_not_count(progress: GoalProgress) -> None:
    progress.on_status(status(task(7, 'active', 'other'), ended=(task(6, 'failed', ''),)))
    assert progress.outcome is None
    assert progress.recoveries == 0


def test_reset_map_aborts_listed_request(progress: GoalProgress) -> None:
    progress.on_status(status())  # latched, from before the request
    assert progress.outcome is None
    progress.on_status(status(task(0, 'active'), task(1)))
    progress.on_status(status(guidance='idle'))
    assert progress.outcome is not None
    assert 'no longer lists' in progress.outcome.text


def test_map_that_does_not_answer_aborts_request(progress: GoalProgress) -> None:
    progress.check(10.0 + ANSWER_TIMEOUT_S)
    assert progress.outcome is None
    progress.check(10.1 + ANSWER_TIMEOUT_S)
    assert progress.outcome is not None
    assert progress.outcome.kind == 'aborted'


def test_replaced_request_keeps_its_outcome(progress: GoalProgress) -> None:
    progress.on_status(status(ended=(task(1, 'succeeded'),)))
    progress.replace()
    assert progress.outcome == Outcome('succeeded')


def test_recoveries_count_beginnings(progress: GoalProgress) -> None:
    for guidance in ('following', 'recovering', 'recovering', 'lost', 'following', 'lost'):
        progress.on_status(status(task(0, 'active'), task(1), guidance=guidance))
    assert progress.recoveries == 3


def test_estimate_adds_straight_lines_to_route(progress: GoalProgress) -> None:
    progress.on_status(status(task(0, 'active'), task(1)))
    left = progress.estimate(np.array([(0.0, 2.0), (1.0, 2.0)]), 0.0, 0.0, 0.5)
    assert left.distance_m == pytest.approx(2.0 + 1.0 + 3.0)
    assert left.time_s == pytest.approx(4.0 + 3.0 / 0.5)
    assert left.goals == 2
    progress.on_status(status(task(1, 'active'), remaining_s=math.inf))
    left = progress.estimate(np.empty((0, 2)), 1.0, 1.0, 0.5)
    assert (left.distance_m, left.time_s, left.goals) == (pytest.approx(2.0), 0.0, 1)


@pytest.mark.parametrize(
    ('places', 'tree', 'text'),
    [
        ([], '', 'no pose'), ([(0.0, 0.0)] * 1001, '', '1001'), ([(math.nan, 0.0)], '', 'nan'),
        ([(0.0, 1e12)], '', 'origin'), (PLACES, 'tree.xml', 'behavior_tree'),
    ],
)
def test_unusable_request_is_refused(
    places: list[tuple[float, float]], tree: str, text: str
) -> None:
    assert text in refusal(places, tree)
    assert refusal(PLACES, '') == ''


def test_requests_and_cancels_are_decoded_as_sent() -> None:
    request = decode(GoalRequest, encode(GoalRequest.of(PLACES, 'mine')))
    assert [(one.x_m, one.y_m) for one in request.targets] == PLACES  # type: ignore[union-attr]
    assert (request.request, request.append, request.cancel) == ('mine', False, UNSET)
    cancel = decode(GoalRequest, encode(GoalRequest(cancel='mine')))
    assert (cancel.cancel, cancel.targets) == ('mine', ())


@pytest.mark.parametrize('payload', ['{"cancel":""}', '{"cancel":1}', '{"cancel":"a","name":"b"}',
                                     '{"name":"a","request":1}'])
def test_malformed_cancel_is_refused(payload: str) -> None:
    with pytest.raises(MalformedMessage, match='experience_map/goal'):
        decode(GoalRequest, payload)
