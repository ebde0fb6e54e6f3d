# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two nodes that publish templates: one of them is used, the other is named and ignored."""

from __future__ import annotations

from typing import Any

import pytest
from helpers import START_NS, S
from rclpy.node import Node
from ros_messages import MakeWorld
from std_msgs.msg import String

from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.errors import UnusableInput
from ratslam_ros.messages.json_schema import decode, encode
from ratslam_ros.messages.mapping import UNKNOWN_SENDER, TemplatePayload
from ratslam_ros.ros import inputs
from ratslam_ros.ros.inputs import SingleSender
from ratslam_ros.ros.qos import INPUT

FIRST, SECOND = 1_700_000_000_000_000_001, 1_700_000_000_000_000_002


def template(number: int, sender: int) -> Any:
    match = ViewMatch(number, True, 0.5, 0.0)
    return String(data=encode(TemplatePayload.of(START_NS + number * S, match, START_NS, sender)))


class Receiver:
    """A node that receives templates, and the publishers of two others."""

    def __init__(self, world: MakeWorld) -> None:
        class Plain(Node):  # type: ignore[misc]
            def close(self) -> None:
                pass

        names = iter(('sink', 'local_view', 'local_view'))
        self.made = world(*[lambda: Plain(next(names))] * 3)
        sink, *self.others = self.made.nodes
        self.used: list[int] = []
        self.reports: list[str] = []
        self.single = SingleSender(sink, 'local_view/template')
        self.publishers = [
            node.create_publisher(String, 'local_view/template', INPUT) for node in self.others
        ]
        self.made.until(lambda: sink.count_publishers('local_view/template') == 2)

    def take(self, message: Any) -> None:
        """Receive a message as the nodes do."""
        sender = decode(TemplatePayload, message.data).sender
        try:
            self.single.check(sender)
        except UnusableInput as error:
            self.reports.append(str(error))
        else:
            self.used.append(sender)


def test_second_sender_is_ignored_and_named(world: MakeWorld) -> None:
    receiver = Receiver(world)
    for number in range(3):
        receiver.take(template(number, FIRST))
        receiver.take(template(number, SECOND))
    receiver.take(template(3, FIRST))
    assert receiver.used == [FIRST] * 4
    assert len(receiver.reports) == 3
    assert '/local_view' in receiver.reports[0]
    assert 'end one of the two' in receiver.reports[0]


def test_successor_of_a_killed_sender_is_used_after_a_pause(
    world: MakeWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The graph still shows the killed one for some seconds."""
    receiver = Receiver(world)
    receiver.take(template(0, FIRST))
    receiver.take(template(1, SECOND))
    monkeypatch.setattr(inputs, 'HOLD_S', 0.0)
    receiver.take(template(2, SECOND))
    receiver.take(template(3, SECOND))
    assert receiver.used == [FIRST, SECOND, SECOND]


def test_successor_of_a_sender_that_has_ended_is_used_at_once(world: MakeWorld) -> None:
    receiver = Receiver(world)
    receiver.take(template(0, FIRST))
    receiver.others[0].destroy_publisher(receiver.publishers[0])
    sink = receiver.made.nodes[0]
    receiver.made.until(lambda: sink.count_publishers('local_view/template') == 1)
    receiver.take(template(1, SECOND))
    assert receiver.used == [FIRST, SECOND]


def test_message_without_a_sender_is_passed_on(world: MakeWorld) -> None:
    receiver = Receiver(world)
    receiver.take(template(0, FIRST))
    receiver.take(template(1, UNKNOWN_SENDER))
    assert len(receiver.used) == 2
