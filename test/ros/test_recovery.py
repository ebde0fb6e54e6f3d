# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Histories that a restarted process collects."""

from __future__ import annotations

from typing import Any
from unittest.mock import MagicMock

import pytest
from helpers import START_NS, template_text

from ratslam_ros.ros.convert import stamp_of
from ratslam_ros.ros.restart import recovery

MS = 1_000_000
HISTORY = 'ratslam/history/templates'


class Setting:
    """A process that collects, without ROS: its time and what arrives are given."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, has_history: bool = True) -> None:
        self.now_s = 100.0
        monkeypatch.setattr(recovery, 'time', MagicMock(monotonic=lambda: self.now_s))
        self.node = MagicMock()
        self.node.resolve_topic_name = str
        self.node.count_publishers = lambda topic: has_history and topic == HISTORY
        self.received: list[int] = []
        self.processed: list[Any] = []
        self.one = recovery.Recovery([self.node])
        self._arrive = self.one.receiver(
            'template', {'templates': object}, self.processed.append, self._receive
        )
        self.missed = self.one.inputs['template']
        self.one.begin(MagicMock())

    def _receive(self, message: Any) -> None:
        self.received.append((stamp_of(message) - START_NS) // MS)

    def send(self, *stamps: int) -> None:
        """Let messages of the history arrive."""
        [call] = self.node.create_subscription.call_args_list
        assert call.args[1] == HISTORY
        for stamp in stamps:
            call.args[2](message(stamp))

    def arrive(self, *stamps: int) -> None:
        """Let messages arrive on the topic itself."""
        for stamp in stamps:
            self._arrive(message(stamp))
        assert not self.processed

    def done_after(self, wait_s: float) -> bool:
        self.now_s += wait_s
        return self.one.is_done()

    def delivered(self, floor: int = 0) -> list[int]:
        self.one.deliver({}, lambda stream: START_NS + floor * MS)
        return self.received


def message(stamp: int) -> Any:
    text = template_text(START_NS + stamp * MS, stamp, error=0.5, is_new=True)
    return MagicMock(spec=['data'], data=text)


def test_history_is_complete_when_it_meets_what_arrives(monkeypatch: pytest.MonkeyPatch) -> None:
    setting = Setting(monkeypatch)
    assert not setting.one.is_done()
    setting.arrive(5, 6)
    setting.send(1, 2, 3, 4)
    assert not setting.done_after(0.9)
    setting.send(5)
    assert not setting.done_after(0.0)  # other nodes may not be connected yet
    assert setting.done_after(0.2)
    assert setting.missed.is_complete(START_NS + 2 * MS)
    assert not setting.missed.is_complete(START_NS)
    assert setting.delivered(floor=2) == [3, 4, 5, 6]


def test_messages_beyond_the_limit_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    setting = Setting(monkeypatch)
    size = recovery.size_of(message(5))
    monkeypatch.setattr(recovery, 'KEPT_BYTES', 3 * size)
    setting.arrive(*range(5, 10))
    reports = setting.node.diagnostics.drop.call_args_list
    assert [call.args[0] for call in reports] == ['lost', 'lost']
    assert setting.delivered() == [5, 6, 7]


def test_history_without_new_messages_is_complete_when_it_is_quiet(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    setting = Setting(monkeypatch)
    assert not setting.done_after(3.0)  # it has a publisher
    setting.send(1, 2)
    assert not setting.done_after(0.9)
    setting.send(3)
    assert not setting.done_after(0.9)
    assert setting.done_after(0.2)
    assert setting.delivered() == [1, 2, 3]


def test_killed_publisher_is_not_awaited_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    setting = Setting(monkeypatch)
    assert not setting.done_after(4.9)
    assert setting.done_after(0.2)
    assert not setting.missed.history


def test_topic_without_a_history_is_not_awaited(monkeypatch: pytest.MonkeyPatch) -> None:
    setting = Setting(monkeypatch, has_history=False)
    setting.arrive(7)
    assert not setting.done_after(0.9)
    assert setting.done_after(0.2)
    assert setting.delivered(floor=9) == [7]  # a jump back in time is not for this to judge


def test_first_messages_that_nobody_kept_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    setting = Setting(monkeypatch, has_history=False)
    one = recovery.Recovery([setting.node])
    for stream in ('image', 'odometry', 'template'):
        one.receiver(stream, {}, print, print)
    one.begin(MagicMock())
    one.deliver({'odometry': [START_NS]}, lambda stream: 0)
    [note] = setting.node.diagnostics.note.call_args_list
    assert 'the first messages of image may be lost' in note.args[0]
