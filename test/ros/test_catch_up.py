# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Histories that a restarted process collects, and what it does about its neighbours."""

from __future__ import annotations

from typing import Any
from unittest.mock import MagicMock

import pytest
from helpers import START_NS, template_text

MS = 1_000_000
KEPT, OTHER = 'kept', 'other'


class Setting:
    """A process that collects, without ROS: its time and what arrives are given."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, publishers: dict[str, str]) -> None:
        from rclpy.qos import DurabilityPolicy

        from ratslam_ros.ros.restart import catch_up, recovery

        self.now_s = 100.0
        for module in (catch_up, recovery):
            clock = MagicMock(monotonic=lambda: self.now_s)
            monkeypatch.setattr(module, 'time', clock)
        self.node = MagicMock()
        self.node.resolve_topic_name = str
        durability = {KEPT: DurabilityPolicy.TRANSIENT_LOCAL, OTHER: DurabilityPolicy.VOLATILE}
        self.node.get_publishers_info_by_topic = lambda topic: [
            MagicMock(qos_profile=MagicMock(durability=durability[publishers[topic]]))
        ] if topic in publishers else []
        self.received: list[int] = []
        missed = catch_up.Missed({'templates': object}, self._receive)
        self.one = catch_up.CatchUp(self.node, {'template': missed}, True, print)

    def _receive(self, message: Any) -> None:
        from ratslam_ros.ros.restart.catch_up import stamp_of

        self.received.append((stamp_of(message) - START_NS) // MS)

    @property
    def subscribed(self) -> dict[str, Any]:
        calls = self.node.create_subscription.call_args_list
        return {call.args[1]: call.args[2] for call in calls}

    def send(self, topic: str, *stamps: int) -> None:
        """Let messages of a history arrive."""
        for stamp in stamps:
            self.subscribed[topic](message(stamp))

    def arrive(self, *stamps: int) -> None:
        """Let messages arrive on the topic itself."""
        for stamp in stamps:
            self.one.keep('template', message(stamp))

    def done_after(self, wait_s: float) -> bool:
        self.now_s += wait_s
        return self.one.is_done()

    def delivered(self, known: int = -1) -> list[int]:
        self.one.close()
        self.one.deliver({} if known < 0 else {'template': START_NS + known * MS})
        return self.received


def message(stamp: int) -> Any:
    text = template_text(START_NS + stamp * MS, stamp, error=0.5, is_new=True)
    return MagicMock(spec=['data'], data=text)


HISTORY = 'ratslam/history/templates'


@pytest.mark.parametrize('name', [HISTORY, 'templates'])
def test_history_is_complete_when_it_meets_what_arrives(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    setting = Setting(monkeypatch, {name: KEPT})
    assert not setting.one.is_done()
    setting.arrive(5, 6)
    setting.send(name, 1, 2, 3, 4)
    assert not setting.done_after(0.9)
    setting.send(name, 5)
    assert not setting.done_after(0.0)  # other nodes may not be connected yet
    assert setting.done_after(0.2)
    assert setting.delivered(known=2) == [3, 4, 5, 6]


def test_history_without_new_messages_is_complete_when_it_is_quiet(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    setting = Setting(monkeypatch, {HISTORY: KEPT})
    assert not setting.done_after(3.0)  # it has a publisher
    setting.send(HISTORY, 1, 2)
    assert not setting.done_after(0.9)
    setting.send(HISTORY, 3)
    assert not setting.done_after(0.9)
    assert setting.done_after(0.2)
    assert setting.delivered() == [1, 2, 3]


def test_killed_publisher_is_not_awaited_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    setting = Setting(monkeypatch, {HISTORY: KEPT})
    assert not setting.done_after(4.9)
    assert setting.done_after(0.2)
    assert not setting.one.has_history('template')


def test_topic_that_is_not_kept_has_no_history(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing subscribes to it with a mismatch, of which a camera driver would warn."""
    setting = Setting(monkeypatch, {'templates': OTHER})
    setting.arrive(7)
    assert not setting.done_after(0.9)
    assert setting.done_after(0.2)
    assert setting.subscribed.keys() == {HISTORY}
    assert setting.delivered(known=9) == [7]  # a jump back in time is not for this to judge


def recovery_of(setting: Setting, newest: int) -> Any:
    from ratslam_ros.ros.restart.recovery import Recovery

    return Recovery(
        setting.node, ['pose_cells'], MagicMock(), lambda stream: START_NS + newest * MS
    )


def test_repetitions_are_dropped_while_a_neighbour_restarts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from ratslam_ros.messages.json_schema import encode
    from ratslam_ros.messages.restarts import Restart

    monkeypatch.setattr('ratslam_ros.ros.restart.recovery.starting', list)
    setting = Setting(monkeypatch, {})
    recovery = recovery_of(setting, 100)
    setting.now_s += 5.0
    assert recovery.accepts('template', START_NS + 50 * MS)  # may be a jump back in time
    recovery._on_restart(MagicMock(data=encode(Restart(('local_view',)))))
    answer = setting.node.create_publisher().publish.call_args.args[0].data
    assert answer == encode(Restart(('pose_cells',), heard=True))
    for _ in range(2):
        assert not recovery.accepts('template', START_NS + 50 * MS)
        assert recovery.accepts('template', START_NS + 101 * MS)
        assert recovery.accepts('template', START_NS - 60_000 * MS)
        assert recovery.is_settling()
        setting.now_s += 3.0
    recovery._on_restart(MagicMock(data=encode(Restart(('local_view',), done=True))))
    setting.now_s += 1.1
    assert not recovery.is_settling()
    assert recovery.accepts('template', START_NS + 50 * MS)


def test_first_messages_that_nobody_kept_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    from ratslam_ros.ros.restart.catch_up import CatchUp, Missed

    setting = Setting(monkeypatch, {})
    recovery = recovery_of(setting, 0)
    missed = {stream: Missed({}, print) for stream in ('image', 'odometry', 'template')}
    recovery._finish(CatchUp(setting.node, missed, True, print), {'odometry': [START_NS]}, missed)
    [note] = recovery._diagnostics.note.call_args_list
    assert 'the first messages of image may be lost' in note.args[0]
