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

from ratslam_ros.core.driving.goal_queue import MAX_TRY_COUNT
from ratslam_ros.messages.goals import BehaviourReport
from ratslam_ros.messages.json_schema import encode
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
    drive(made, range(12, 14), 1.0)
    made.send('pose_cells/goal', string(''))
    made.spin(0.1)
    drive(made, range(14, 16), 1.0)
    *before, last = payloads(received)
    assert len(before) == 2 and not any('given_up' in message for message in before)
    assert (last['goal'], last['given_up'], last['reached']) == (name, 'cancelled', False)
    assert last['bearing_rad'] is None and last['remaining_s'] is None


def test_goals_sent_one_after_the_other_are_sought_in_order(world: MakeWorld) -> None:
    made = pose_cells(world)
    received, first = mark_and_seek_goal(made)
    made.send('pose_cells/mark_goal', string('dock'))
    made.reported('pose_cells', goals=f'{first}, dock')
    made.send('pose_cells/goal', string('dock'))
    made.send('pose_cells/goal', string(first))
    made.spin(0.1)
    state = made.diagnostics()['pose_cells']
    assert (state['goal'], state['goals_waiting']) == (first, '2')
    drive(made, range(12, 16), 0.0, math.pi / 4)
    drive(made, range(16, 28), 1.0)
    made.send('pose_cells/mark_goal', string('dock'))  # it is elsewhere now: here
    made.spin(0.1)
    drive(made, range(28, 30), 0.0)
    made.spin(0.3)
    found = payloads(received)
    assert found[0]['waiting'] == ['dock', first]
    reached = [message for message in found if message['reached']]
    assert [message['goal'] for message in reached] == [first, 'dock']
    assert [message.get('waiting') for message in reached] == [['dock', first], [first]]
    assert 'waiting' not in found[-1]
    assert abs(next(m for m in found if m['goal'] == 'dock')['bearing_rad']) > 2.0  # behind it


def test_goal_marked_anew_changes_published_direction_at_once(world: MakeWorld) -> None:
    made = pose_cells(world)
    received, name = mark_and_seek_goal(made)
    drive(made, range(12, 13), 0.0)
    drive(made, range(13, 17), 0.0, math.pi / 4)
    made.send('pose_cells/mark_goal', string(name))
    drive(made, range(17, 18), 2.0)
    made.spin(0.3)
    first, *_, last = payloads(received)
    assert abs(first['bearing_rad']) > 2.0 and first['remaining_s'] > 4.0
    assert last['remaining_s'] < 4.0


def test_failed_attempts_change_links_until_goal_is_given_up(world: MakeWorld) -> None:
    made = pose_cells(world)
    received, name = mark_and_seek_goal(made)
    commands = made.listen(String, 'ratslam/command')
    drive(made, range(12, 16), 0.0, math.pi / 4)
    report = encode(BehaviourReport.of(START_NS, 'centreline', True))
    for _ in range(MAX_TRY_COUNT):
        made.send('goal_follower/behaviour', string(report))
    made.until(lambda: sum('BlockWay' in one.data for one in commands) == MAX_TRY_COUNT)
    drive(made, range(16, 18), 0.0)
    made.until(lambda: 'given_up' in payloads(received)[-1])
    before, last = payloads(received)[-2:]
    assert last['goal'] == name
    assert last['given_up'] == 'the way is blocked: 12 tries have failed'
    assert last['remaining_s'] > before['remaining_s'] + 3.0
    assert made.diagnostics()['pose_cells']['goal'] == 'none'


def test_goal_memory_switched_off_has_no_topics(world: MakeWorld) -> None:
    made = world(PoseCellsNode)
    [node] = made.nodes
    assert not [topic for topic in node.publishers if 'goal' in topic.topic_name]
    assert 'goal_memory' not in node.host.live.state_of(node.SECTION)
