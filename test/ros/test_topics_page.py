# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""docs/topics.md describes all topics and services, and its examples are real payloads."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from payload_docs import PAYLOADS, description
from ros_messages import MakeWorld

from ratslam_ros.core.mapping.loop_closure_gate import ClosureEvent
from ratslam_ros.core.pose_cells.active_cells import ActiveCells
from ratslam_ros.messages.commands import CommandPayload
from ratslam_ros.messages.json_schema import decode, encode
from ratslam_ros.messages.map_changes import ClosurePayload, MapChangePayload
from ratslam_ros.messages.mapping import (
    ActionPayload,
    Correction,
    RelocationPayload,
    TemplatePayload,
)
from ratslam_ros.messages.pose_cells import PacketsPayload
from ratslam_ros.pipeline.codec import command_from_state, command_state
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.landmark_map_node import LandmarkMapNode
from ratslam_ros.ros.local_view_node import LocalViewNode
from ratslam_ros.ros.navigation.goal_follower_node import GoalFollowerNode
from ratslam_ros.ros.pose_cells_node import PoseCellsNode
from ratslam_ros.ros.visual_odometry_node import VisualOdometryNode
from ratslam_simulator.node import SimulatorNode

PAGE = (Path(__file__).parents[2] / 'docs/topics.md').read_text(encoding='utf-8')
ROS_TOPICS = ('/rosout', '/parameter_events', '/clock')
ROS_SERVICES = (
    'describe_parameters', 'get_parameter_types', 'get_parameters', 'list_parameters',
    'set_parameters', 'set_parameters_atomically', 'get_type_description',
)


def node_classes() -> list[Any]:
    return [
        VisualOdometryNode, LocalViewNode, PoseCellsNode, ExperienceMapNode, GoalFollowerNode,
        SimulatorNode, LandmarkMapNode,
    ]


def test_every_topic_and_service_is_documented(world: MakeWorld) -> None:
    made = world(*node_classes(), arguments=(
        '-p', 'goal_memory.goal_memory:=true', '-p', 'pc_cell_x_size:=1.0',
    ))
    topics = {
        found.topic_name
        for node in made.nodes for found in (*node.publishers, *node.subscriptions)
    } - set(ROS_TOPICS)
    for topic in topics:
        assert f'`{topic}`' in PAGE or f'`{topic.lstrip("/")}`' in PAGE, topic
    services = {
        found.srv_name.lstrip('/') for node in made.nodes for found in node.services
    }
    for service in services:
        name = service.rpartition('/')[2]
        if name not in ROS_SERVICES:
            same = f'`{service.rpartition("/")[0]}/save`' if name == 'load' else f'`{service}`'
            known = same in PAGE or f'`NODE/{name}`' in PAGE
            assert known, service


def test_every_documented_topic_exists(world: MakeWorld) -> None:
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
    }
    assert {name.lstrip('/') for name in named} <= existing


def test_every_payload_is_described_on_a_page() -> None:
    results = (Path(__file__).parents[2] / 'docs/results.md').read_text(encoding='utf-8')
    assert len(PAYLOADS) >= 19
    for topic, kind in PAYLOADS.items():
        assert description(kind) in PAGE + results, f'run "make docs"; {topic} needs its marks'


@pytest.mark.parametrize('line', [
    '| `id` | integer, -1 to 2^31 - 1 | the template; -1 if the image could not be decoded, or '
    'matches no template while learning is off |',
    '| `per_m_rad` | number, -1000 to 1000 rad/m | added per metre |',
    '| `x_mm`, `y_mm` | optional list of: integer, -10^12 to 10^12 mm | their positions on the '
    'map |',
    '| `dims` | list of 3: integer, 1 to 100000 | numbers of cells in x, y and heading; the cells '
    'wrap around |',
])
def test_description_has_types_ranges_units_and_meanings(line: str) -> None:
    assert f'\n{line}\n' in PAGE


def test_examples_are_what_the_nodes_send() -> None:
    def example(kind: Any) -> tuple[str, Any]:
        mark = f'<!-- Payload of {kind.TOPIC},'
        text = re.findall(r'```json\n(.*?)\n```', PAGE[PAGE.index(mark) :])[0]
        return text, decode(kind, text)

    text, found = example(CommandPayload)
    assert encode(CommandPayload.of(found.stamp.ns, found.command)) == text
    assert command_state(command_from_state(found.command))

    text, found = example(TemplatePayload)
    assert encode(TemplatePayload.of(found.stamp.ns, found.match, found.memory)) == text
    text, found = example(ActionPayload)
    again = ActionPayload.of(found.stamp.ns, found.sequence, found.change, found.memory)
    assert encode(again) == text
    text, found = example(RelocationPayload)
    again = RelocationPayload.of(found.stamp.ns, found.sequence, found.adopted, found.memory)
    assert encode(again) == text
    text, found = example(Correction)
    poses = found.before.pose, found.after.pose
    assert encode(Correction.of(found.stamp.ns, found.experience_id, *poses)) == text
    text, found = example(MapChangePayload)
    again = MapChangePayload.of(found.change, found.sequence, found.sender, found.frame_id)
    assert encode(again) == text
    text, found = example(ClosurePayload)
    event = ClosureEvent(found.outcome, found.source_id, found.target_id, found.reason)
    assert encode(ClosurePayload.of(found.stamp.ns, found.sequence, event)) == text
    text, found = example(PacketsPayload)
    active = ActiveCells(np.empty((0, 3), np.int64), np.empty(0), *found.arrays)
    assert encode(PacketsPayload.of(found.stamp.ns, found.dims, active)) == text
