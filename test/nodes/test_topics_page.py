# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""docs/topics.md says what there is, and its examples are what the nodes send."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

PAGE = (Path(__file__).parents[2] / 'docs/topics.md').read_text(encoding='utf-8')
OF_ROS = ('/rosout', '/parameter_events', '/clock')
SERVICES_OF_ROS = (
    'describe_parameters', 'get_parameter_types', 'get_parameters', 'list_parameters',
    'set_parameters', 'set_parameters_atomically', 'get_type_description',
)  # fmt: skip


def makers() -> list[Any]:
    from ratslam_ros.nodes.experience_map_node import ExperienceMapNode
    from ratslam_ros.nodes.local_view_node import LocalViewNode
    from ratslam_ros.nodes.pose_cells_node import PoseCellsNode
    from ratslam_ros.nodes.visual_odometry_node import VisualOdometryNode

    return [VisualOdometryNode, LocalViewNode, PoseCellsNode, ExperienceMapNode]


def test_every_topic_and_service_is_described(world: Callable[..., Any]) -> None:
    made = world(*makers())
    topics = {
        found.topic_name
        for node in made.nodes for found in (*node.publishers, *node.subscriptions)
    } - set(OF_ROS)  # fmt: skip
    for topic in topics:
        assert f'`{topic}`' in PAGE or f'`{topic.lstrip("/")}`' in PAGE, topic
    services = {
        found.srv_name.lstrip('/') for node in made.nodes for found in node.services
    }  # fmt: skip
    for service in services:
        name = service.rpartition('/')[2]
        if name not in SERVICES_OF_ROS:
            same = f'`{service.rpartition("/")[0]}/save`' if name == 'load' else f'`{service}`'
            known = same in PAGE or f'`NODE/{name}`' in PAGE
            assert known, service


def test_every_topic_of_the_page_is_there(world: Callable[..., Any]) -> None:
    made = world(*makers())
    named = {
        name
        for line in PAGE.split('## Topics')[1].split('###')[0].splitlines()
        if line.startswith('| `')
        for name in re.findall(r'`([a-z_/]+)`', line.split('|')[1])
    }
    assert len(named) >= 14
    there = {
        found.topic_name.lstrip('/')
        for node in made.nodes for found in (*node.publishers, *node.subscriptions)
    }  # fmt: skip
    assert {name.lstrip('/') for name in named} <= there


def test_the_examples_are_payloads() -> None:
    from ratslam_ros.messages import decode_action, decode_template, encode_action, encode_template

    template, action = re.findall(r'```json\n(.*?)\n```', PAGE)
    assert encode_template(*decode_template(template)) == template
    assert encode_action(*decode_action(action)) == action
