# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goals on the pose cells by topics and services, and their description in docs/topics.md."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from helpers import START_NS, S
from ros_messages import MakeWorld, odometry, string
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ratslam_ros.ros.pose_cells_node import PoseCellsNode

PAGE = (Path(__file__).parents[2] / 'docs/topics.md').read_text(encoding='utf-8')
ON = (
    '-p', 'base:=extended', '-p', 'goal_memory.goal_memory:=true', '-p', 'flush_after_s:=0.1',
)


def pose_cells(world: MakeWorld, *arguments: str) -> Any:
    return world(PoseCellsNode, arguments=(*ON, *arguments))


def drive(made: Any, seconds: range, speed: float, turn_rate: float = 0.0) -> None:
    """Send odometry, one message per second, and wait until it is processed."""
    for second in seconds:
        made.send('odom', odometry(START_NS + second * S, speed, turn_rate))
    [node] = made.nodes
    order = node.host.pipeline.order
    made.until(lambda: order.newest_of('odometry') == START_NS + seconds[-1] * S)
    made.until(lambda: not order.held)


def mark_and_seek_goal(made: Any) -> tuple[list[Any], str]:
    """Mark a goal, drive on and seek it; return the received messages and the goal's name."""
    drive(made, range(3), 0.5)
    answer = made.call(Trigger, 'pose_cells/mark_goal')
    assert answer.success
    drive(made, range(3, 12), 1.0)
    received = made.listen(String, 'pose_cells/goal_memory')
    made.send('pose_cells/goal', string(answer.message))
    made.spin(0.1)
    return received, answer.message


def payloads(received: list[Any]) -> list[dict[str, Any]]:
    return [json.loads(message.data) for message in received]


def test_direction_to_goal_is_published_until_reached(world: MakeWorld) -> None:
    made = pose_cells(world)
    received, name = mark_and_seek_goal(made)
    assert name == 'goal_1'
    drive(made, range(12, 14), 0.0, math.pi / 4)
    made.until(lambda: len(received) == 2)
    first, second = payloads(received)
    assert list(first) == [
        'schema_version', 'stamp', 'goal', 'bearing_rad', 'remaining_s', 'reached'
    ]
    assert first['goal'] == name
    assert first['stamp'] == {'sec': START_NS // S + 12, 'nanosec': 0}
    assert first['remaining_s'] > 4.0
    assert not first['reached']
    assert abs(first['bearing_rad']) == pytest.approx(0.75 * math.pi, abs=0.3)  # behind it
    assert abs(second['bearing_rad']) == pytest.approx(0.5 * math.pi, abs=0.3)
    drive(made, range(14, 16), 0.0, math.pi / 4)
    drive(made, range(16, 28), 1.0)
    made.spin(0.3)
    *before, last = payloads(received)
    assert last['reached']
    assert last['bearing_rad'] is None
    assert not any(message['reached'] for message in before)
    assert len(received) < 16  # none are published after it


def test_unknown_goal_is_reported_and_empty_name_cancels(world: MakeWorld) -> None:
    made = pose_cells(world)
    received, name = mark_and_seek_goal(made)
    made.send('pose_cells/goal', string('kitchen'))
    made.spin(0.1)
    state = made.diagnostics()['pose_cells']
    assert 'kitchen' in state['message'] and name in state['message']
    assert state['goal'] == name  # unchanged
    made.send('pose_cells/goal', string(''))
    made.spin(0.1)
    drive(made, range(12, 14), 1.0)
    assert payloads(received) == []


def test_goal_memory_switched_off_has_no_topics(world: MakeWorld) -> None:
    made = world(PoseCellsNode)
    [node] = made.nodes
    assert not [topic for topic in node.publishers if 'goal' in topic.topic_name]
    assert 'goal_memory' not in node.host.live.state_of(node.SECTION)
