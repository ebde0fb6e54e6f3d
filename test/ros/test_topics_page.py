# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""docs/topics.md describes all topics and services, and its examples are real payloads."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

PAGE = (Path(__file__).parents[2] / 'docs/topics.md').read_text(encoding='utf-8')
ROS_TOPICS = ('/rosout', '/parameter_events', '/clock')
ROS_SERVICES = (
    'describe_parameters', 'get_parameter_types', 'get_parameters', 'list_parameters',
    'set_parameters', 'set_parameters_atomically', 'get_type_description',
)  # fmt: skip


def node_classes() -> list[Any]:
    from ratslam_ros.ros.experience_map_node import ExperienceMapNode
    from ratslam_ros.ros.landmark_map_node import LandmarkMapNode
    from ratslam_ros.ros.local_view_node import LocalViewNode
    from ratslam_ros.ros.navigation.goal_follower_node import GoalFollowerNode
    from ratslam_ros.ros.pose_cells_node import PoseCellsNode
    from ratslam_ros.ros.simulator_node import SimulatorNode
    from ratslam_ros.ros.visual_odometry_node import VisualOdometryNode

    return [
        VisualOdometryNode, LocalViewNode, PoseCellsNode, ExperienceMapNode, GoalFollowerNode,
        SimulatorNode, LandmarkMapNode,
    ]


def test_every_topic_and_service_is_documented(world: Callable[..., Any]) -> None:
    made = world(*node_classes())
    topics = {
        found.topic_name
        for node in made.nodes for found in (*node.publishers, *node.subscriptions)
    } - set(ROS_TOPICS)  # fmt: skip
    for topic in topics:
        assert f'`{topic}`' in PAGE or f'`{topic.lstrip("/")}`' in PAGE, topic
    services = {
        found.srv_name.lstrip('/') for node in made.nodes for found in node.services
    }  # fmt: skip
    for service in services:
        name = service.rpartition('/')[2]
        if name not in ROS_SERVICES:
            same = f'`{service.rpartition("/")[0]}/save`' if name == 'load' else f'`{service}`'
            known = same in PAGE or f'`NODE/{name}`' in PAGE
            assert known, service


def test_every_documented_topic_exists(world: Callable[..., Any]) -> None:
    made = world(*node_classes(), arguments=('-p', 'exp_align_scans:=true'))
    named = {
        name
        for line in PAGE.split('## Topics')[1].split('###')[0].splitlines()
        if line.startswith('| `')
        for name in re.findall(r'`([a-z_/]+)`', line.split('|')[1])
    }
    assert len(named) >= 14
    existing = {
        found.topic_name.lstrip('/')
        for node in made.nodes for found in (*node.publishers, *node.subscriptions)
    }  # fmt: skip
    assert {name.lstrip('/') for name in named} <= existing


def test_examples_are_valid_payloads() -> None:
    from ratslam_ros.core.navigation.goals import Position
    from ratslam_ros.core.pose_cells.active_cells import ActiveCells
    from ratslam_ros.messages.commands import decode_command, encode_command
    from ratslam_ros.messages.corrections import decode_correction, encode_correction
    from ratslam_ros.messages.goals import (
        GoalRequest,
        NameRequest,
        decode_behaviour,
        decode_goal,
        decode_name,
        decode_status,
        encode_behaviour,
    )
    from ratslam_ros.messages.map_changes import (
        decode_closure,
        decode_map_change,
        encode_closure,
        encode_map_change,
    )
    from ratslam_ros.messages.mapping import (
        decode_action,
        decode_relocation,
        decode_template,
        encode_action,
        encode_relocation,
        encode_template,
    )
    from ratslam_ros.messages.pose_cells import decode_packets, encode_packets
    from ratslam_ros.pipeline.item_states import command_from_state, command_state

    (
        template, action, relocation, correction, change, closure, packets, goal, name, status,
        behaviour, command,
    ) = re.findall(r'```json\n(.*?)\n```', PAGE)  # fmt: skip
    assert encode_template(*decode_template(template)) == template
    assert encode_action(*decode_action(action)) == action
    stamp_ns = decode_action(action)[0]
    assert encode_relocation(stamp_ns, *decode_relocation(relocation)) == relocation
    assert encode_correction(decode_correction(correction)) == correction
    message = decode_map_change(change)
    again = encode_map_change(
        message.change, message.sequence, message.sender, message.frame_id
    )
    assert again == change
    assert encode_closure(*decode_closure(closure)) == closure
    stamp_ns, dims, places, injections = decode_packets(packets)
    active = ActiveCells(np.empty((0, 3), np.int64), np.empty(0), places, injections)
    assert encode_packets(stamp_ns, dims, active) == packets
    assert encode_behaviour(decode_behaviour(behaviour)) == behaviour
    assert encode_command(*decode_command(command)) == command
    assert command_state(command_from_state(decode_command(command)[1]))
    targets = ('kitchen', 17, Position(1.5, -2.0))
    assert decode_goal(goal) == GoalRequest(targets, append=True, timeout_s=120.0)
    assert decode_name(name) == NameRequest('kitchen')
    assert status == example_of_status()
    assert decode_status(status)['status'] == 'following'


def example_of_status() -> str:
    """Return the encoded status of the example in the page."""
    from ratslam_ros.core.common.pose import Pose
    from ratslam_ros.core.config import ExperienceMapParameters
    from ratslam_ros.core.mapping.experience_map import Direction, ExperienceMap
    from ratslam_ros.core.navigation.goals import Goal
    from ratslam_ros.core.navigation.navigator import GoalTask
    from ratslam_ros.core.navigation.route_following import Guidance
    from ratslam_ros.messages.goals import encode_status

    class Around(ExperienceMap):
        def neighbours(self, experience_id: int) -> list[int]:
            return [12, 39]

        def distance_and_direction(self, target_id: int) -> Direction:
            return {12: Direction(0.5, 0.25), 39: Direction(0.75, 3.0)}[target_id]

    around = Around(ExperienceMapParameters())
    around.current_id = 40
    place = Goal(12)
    active = GoalTask(3, place, 'kitchen', status='active', expected_s=24.0)
    ended = GoalTask(
        2, place, '(1, 0)', status='timed_out', reason='not reached within 60 s', started_ns=0,
        expected_s=12.5, ended_ns=60_000_000_000,
    )  # fmt: skip
    guidance = Guidance(
        'following', remaining_s=18.5, behaviour='left_wall', goal=Pose(1.5, -2.0, 0.0),
        replanned=1, switched=0,
    )  # fmt: skip
    return encode_status(1700000012500000000, around, guidance, [active], [ended])
