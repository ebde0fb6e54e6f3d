# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The map message is written in slices, and has the bytes of map.json."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from graphs import new_map
from helpers import ahead
from rclpy.serialization import deserialize_message
from ros_messages import MakeWorld
from std_msgs.msg import String

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.messages.mapping import BLOCK_ROWS, encode_map, map_text
from ratslam_ros.ros.convert import serialised_text
from ratslam_ros.ros.mapping import map_sender, sliced_publisher
from ratslam_ros.ros.qos import LATCHED

COUNT = 3 * BLOCK_ROWS + 7


def chain(count: int) -> ExperienceMap:
    graph = new_map()
    for n in range(count):
        extend(graph, n)
    return graph


def extend(graph: ExperienceMap, target: int) -> None:
    graph.integrate(ahead(0.1))
    graph.apply(MapAction('create', graph.current_id, target, 3, 0.0, Place(1.5, 0.0, 0.0)))


def test_text_is_that_of_the_map_at_the_first_step() -> None:
    graph = chain(COUNT)
    expected = encode_map(5, graph)
    parts = []
    for part in map_text(5, graph):
        parts.append(part)
        graph._poses.values[:COUNT] += 0.5
        extend(graph, len(graph))
        graph.link_table.delete([len(parts)])
    assert len(parts) == 11  # 4 blocks of experiences and of links, and what is around them
    assert b''.join(parts).decode() == expected


class Sender:
    """A sender that writes one block per call, at a simulated time."""

    def __init__(
        self, world: MakeWorld, monkeypatch: pytest.MonkeyPatch, count: int, **settings: Any
    ) -> None:
        for name, value in settings.items():
            monkeypatch.setattr(sliced_publisher, name, value)
        self.clock_s = 0.0
        clocks = SimpleNamespace(monotonic=lambda: self.clock_s, thread_time=lambda: 0.0)
        for module in (map_sender, sliced_publisher):
            monkeypatch.setattr(module, 'time', clocks)
        self.world = world()
        self.graph = chain(count)
        self.stage: Any = SimpleNamespace(core=self.graph, action_ns=9)
        self.sender = map_sender.MapSender(self.world.tester, self.stage)
        self.received = self.world.listen(String, 'experience_map/map', LATCHED)
        self.world.until(lambda: self.sender._publisher.get_subscription_count() == 1)

    def text(self) -> Any:
        """Return the next received map."""
        self.world.until(lambda: self.received)
        return self.received.pop(0).data


def test_large_map_is_sent_in_slices(world: MakeWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    sending = Sender(world, monkeypatch, COUNT, SLICE_S=-1.0, THREAD_BYTES=1000)
    graph, sender = sending.graph, sending.sender
    sender.has_changed = True
    expected = encode_map(9, graph)
    calls = 1
    while not sender.advance(period_s=1.0):
        calls += 1
        graph._poses.values[:COUNT] += 0.5
    assert calls == 12  # one for each part, and one that finds the end
    assert sending.text() == expected
    assert sender._thread is not None
    sender._thread.join()
    sender.has_changed = True
    assert not sender.advance(period_s=1.0)  # the period has not passed
    assert sender.has_changed
    sending.clock_s = 1.0
    sender.advance(period_s=1.0)
    assert not sender.has_changed


def test_finish_sends_the_last_map_at_once(
    world: MakeWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    sending = Sender(world, monkeypatch, COUNT, SLICE_S=-1.0)
    graph, sender = sending.graph, sending.sender
    sender.has_changed = True
    assert not sender.advance(period_s=1.0)
    extend(graph, COUNT)  # while the map is being written
    sending.stage.action_ns = 10
    sender.finish()
    assert sending.text() == encode_map(10, graph)
    sender.finish()
    sending.world.spin(0.1)
    assert not sending.received


def test_unchanged_map_is_not_sent(world: MakeWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    sending = Sender(world, monkeypatch, 3)
    assert not sending.sender.advance(period_s=0.0)
    assert not sending.sender.has_sent


@pytest.mark.parametrize('length', range(5))
def test_serialised_text_equals_that_of_a_message(length: int) -> None:
    data = serialised_text([b'', b'x' * length, b'y'])
    assert len(data) % 4 == 0
    assert deserialize_message(data, String).data == 'x' * length + 'y'
