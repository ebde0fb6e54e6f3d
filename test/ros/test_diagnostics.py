# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics: what is logged, and how the level returns to OK."""

from __future__ import annotations

from typing import Any

import pytest

from ratslam_ros.ros import diagnostics as module
from ratslam_ros.ros.diagnostics import MAX_KINDS, WARN_PERIOD_S, WARNING_SHOWN_S, Diagnostics


class Clock:
    """A steady clock that the test sets."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s


class FakeNode:
    """What Diagnostics uses of a node; it keeps what is logged and published."""

    def __init__(self) -> None:
        self.logged: list[str] = []
        self.published: list[Any] = []

    def create_publisher(self, *_: object) -> FakeNode:
        return self

    def publish(self, message: Any) -> None:
        self.published.append(message)

    def get_logger(self) -> FakeNode:
        return self

    def warning(self, text: str) -> None:
        self.logged.append(text)

    def get_fully_qualified_name(self) -> str:
        return '/robot/pose_cells'

    def get_clock(self) -> FakeNode:
        return self

    def now(self) -> FakeNode:
        return self

    nanoseconds = 0


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(module, 'time', clock)
    return clock


def status(node: FakeNode, made: Diagnostics, state: str = 'running') -> tuple[int, str]:
    made.publish({}, state)
    last = node.published[-1].status[0]
    level = last.level
    return level[0] if isinstance(level, bytes) else int(level), last.message


def test_a_different_warning_is_logged_at_once(clock: Clock) -> None:
    node = FakeNode()
    made = Diagnostics(node)
    made.drop('refused', 'a message of odometry was refused: stamp 1.5 s')
    made.drop('refused', 'a message of odometry was refused: stamp 2.75 s')
    made.drop('refused', 'a message of odometry was refused: twist is not finite')
    assert node.logged == [
        'a message of odometry was refused: stamp 1.5 s',
        'a message of odometry was refused: twist is not finite',
    ]
    clock.now_s += WARN_PERIOD_S
    made.drop('refused', 'a message of odometry was refused: stamp 9 s')
    assert node.logged[-1] == (
        'a message of odometry was refused: stamp 9 s (1 more of this kind)'
    )
    assert made.counts['refused'] == 4


def test_malformed_messages_of_any_kind_are_logged_at_growing_intervals(clock: Clock) -> None:
    """Twelve hours of 200 messages a minute, of which each quotes another letter."""
    node = FakeNode()
    made = Diagnostics(node)
    for _ in range(12 * 60):
        for letter in range(200):
            made.drop('refused', f'not valid: {chr(0x4e00 + letter)}')
        clock.now_s += 60.0
    assert len(node.logged) < 25 * MAX_KINDS
    assert made.counts['refused'] == 12 * 60 * 200


def test_a_rare_warning_is_always_logged(clock: Clock) -> None:
    node = FakeNode()
    made = Diagnostics(node)
    for _ in range(9):
        made.warn('odometry has a gap')
        clock.now_s += 2 * 3600.0
        made.warn('odometry has a gap')
        clock.now_s += WARN_PERIOD_S
    assert len(node.logged) == 18


def test_the_level_returns_to_ok(clock: Clock) -> None:
    node = FakeNode()
    made = Diagnostics(node)
    assert status(node, made, 'waiting for image') == (0, 'waiting for image')
    made.drop('late', 'a message came too late')
    assert status(node, made) == (1, 'a message came too late')
    clock.now_s += WARNING_SHOWN_S
    assert status(node, made) == (0, 'running; messages not used since the start: 1 late')


def test_a_notice_is_logged_once_and_kept_as_a_value(clock: Clock) -> None:
    node = FakeNode()
    made = Diagnostics(node)
    made.note('this node started late')
    clock.now_s += WARNING_SHOWN_S
    made.note('this node started late')
    assert node.logged == ['this node started late']
    assert status(node, made) == (0, 'running')
    values = {item.key: item.value for item in node.published[-1].status[0].values}
    assert values['notice'] == 'this node started late'
    made.clear()
    made.note('this node started late')
    assert len(node.logged) == 2


def test_restarts_at_short_intervals_are_shown(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('RATSLAM_RESTARTS', 'restart 4 at short intervals')
    node = FakeNode()
    assert status(node, Diagnostics(node)) == (1, 'restart 4 at short intervals')


def test_what_is_missing_keeps_the_level_until_it_is_there(clock: Clock) -> None:
    node = FakeNode()
    made = Diagnostics(node)
    made.missing['image'] = 'no image yet'
    clock.now_s += 10.0 * WARNING_SHOWN_S
    assert status(node, made) == (1, 'no image yet')
    del made.missing['image']
    assert status(node, made) == (0, 'running')
