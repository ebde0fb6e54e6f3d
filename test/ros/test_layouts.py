# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The layouts for RViz and Foxglove show what the nodes publish, with its types and durability."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from rclpy.qos import DurabilityPolicy
from ros_messages import MakeWorld
from test_topics_page import ROS_TOPICS, node_classes

ROOT = Path(__file__).parents[2]
FOXGLOVE: dict[str, Any] = json.loads((ROOT / 'foxglove/ratslam.json').read_text('utf-8'))
LAYOUTS = sorted((ROOT / 'rviz').glob('*.rviz'))

ARGUMENTS = (
    '-p', 'goal_memory.goal_memory:=true', '-p', 'exp_relocate:=both',
    '-p', 'exp_align_scans:=true', '-p', 'pc_cell_x_size:=1.0',
)
"""Parameters by which the nodes publish all topics that they can."""

RVIZ_TYPES = {
    'Image': 'Image', 'MarkerArray': 'MarkerArray', 'Pose': 'PoseStamped', 'Path': 'Path',
    'Odometry': 'Odometry', 'LaserScan': 'LaserScan', 'PointCloud2': 'PointCloud2',
    'SetGoal': 'PoseStamped', 'SetInitialPose': 'PoseWithCovarianceStamped',
    'PoseWithCovariance': 'PoseWithCovarianceStamped', 'Map': 'OccupancyGrid',
}
"""Type that each display or tool of RViz with a topic needs."""

RVIZ_OTHERS = {'Grid', 'Axes', 'TF', 'MoveCamera', 'Select', 'FocusCamera', 'Measure'}
"""Displays and tools of RViz without a topic."""

NOT_IN_RVIZ = {
    '/ground_truth/pose': 'no transform connects its frame `world` to the map',
}

FOXGLOVE_TYPES = {
    '3D': {
        'MarkerArray', 'PoseStamped', 'Path', 'Odometry', 'LaserScan', 'PointCloud2',
        'OccupancyGrid', 'PoseWithCovarianceStamped',
    },
    'Image': {'Image', 'CompressedImage'},
    'DiagnosticSummary': {'DiagnosticArray'},
    'Plot': None, 'RawMessages': None, 'Tab': None,
}
"""Types that each panel of Foxglove can show; None: any."""

NOT_IN_FOXGLOVE = {
    '/experience_map/map': 'up to 8 MB of text; the markers show the map',
    '/ratslam/map_command': 'between nodes; map_status shows progress and result',
    '/ratslam/map_result': 'as map_command',
    '/ratslam/command': 'what services and topics that are shown have asked for',
    '/tf': 'the 3D panel uses all transforms, without an entry for the topic',
    '/tf_static': 'as /tf',
    '/camera_info': 'nothing to show beside the image',
}


class Topic(NamedTuple):
    """A topic of the nodes: its message class, and whether it is published and latched."""

    kind: Any
    is_published: bool
    is_latched: bool


@pytest.fixture(scope='module')
def cache() -> dict[str, Topic]:
    return {}


@pytest.fixture
def topics(world: MakeWorld, cache: dict[str, Topic]) -> dict[str, Topic]:
    """Return the topics of all nodes, as the nodes declare them."""
    if not cache:
        nodes = world(*node_classes(), arguments=ARGUMENTS).nodes
        for node in nodes:
            for found in node.subscriptions:
                cache[found.topic_name] = Topic(found.msg_type, False, False)
        for node in nodes:
            for found in node.publishers:
                durability = found.qos_profile.durability
                is_latched = durability == DurabilityPolicy.TRANSIENT_LOCAL
                cache[found.topic_name] = Topic(found.msg_type, True, is_latched)
        for name in ROS_TOPICS:
            cache.pop(name, None)
    return cache


def published(topics: dict[str, Topic]) -> set[str]:
    return {name for name, topic in topics.items() if topic.is_published}


def test_topics_are_found_with_types(topics: dict[str, Topic]) -> None:
    assert {'/tf', '/goal_pose', '/experience_map/map', '/pose_cells/goal_memory'} <= set(topics)
    assert topics['/experience_map/markers'].kind.__name__ == 'MarkerArray'
    assert topics['/experience_map/markers'].is_latched and not topics['/odom'].is_latched
    assert topics['/cmd_vel'].is_published and not topics['/goal_pose'].is_published


# RViz


def load(path: Path) -> dict[str, Any]:
    content = yaml.safe_load(path.read_text('utf-8'))
    assert isinstance(content, dict)
    return content


def displays(path: Path) -> list[dict[str, Any]]:
    """Return the displays and tools of an RViz layout."""
    manager = load(path)['Visualization Manager']
    return [*manager['Displays'], *manager['Tools']]


def with_topic(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Return the class, and the settings of the topic, of every display and tool with one."""
    for display in displays(path):
        package, kind = display['Class'].split('/')
        assert package == 'rviz_default_plugins'
        assert ('Topic' in display) == (kind in RVIZ_TYPES), kind
        assert kind in RVIZ_TYPES or kind in RVIZ_OTHERS
        if 'Topic' in display:
            yield kind, display['Topic']


layout = pytest.mark.parametrize('path', LAYOUTS, ids=lambda path: path.name)


@layout
def test_rviz_topics_have_type_and_durability_of_nodes(
    path: Path, topics: dict[str, Topic]
) -> None:
    for kind, settings in with_topic(path):
        topic = topics[settings['Value']]
        assert topic.kind.__name__ == RVIZ_TYPES[kind], settings['Value']
        durability = 'Transient Local' if topic.is_latched else 'Volatile'
        assert settings['Durability Policy'] == durability, settings['Value']


@layout
def test_rviz_displays_have_unique_names_and_known_view(path: Path) -> None:
    manager = load(path)['Visualization Manager']
    names = [display['Name'] for display in manager['Displays']]
    assert len(set(names)) == len(names)
    view = manager['Views']['Current']['Class']
    assert view in ('rviz_default_plugins/TopDownOrtho', 'rviz_default_plugins/Orbit')
    docks = set(load(path)['Window Geometry'])
    images = {one['Name'] for one in manager['Displays'] if one['Class'].endswith('/Image')}
    assert images <= docks


def test_rviz_shows_every_topic_that_it_can(topics: dict[str, Topic]) -> None:
    shown = {settings['Value'] for path in LAYOUTS for _, settings in with_topic(path)}
    can = {name for name in published(topics) if topics[name].kind.__name__ in RVIZ_TYPES.values()}
    assert can - shown == set(NOT_IN_RVIZ)
    assert shown - can == {'/goal_pose', '/initialpose'}  # tools publish them
    main = ROOT / 'rviz/ratslam.rviz'
    assert load(main)['Visualization Manager']['Global Options']['Fixed Frame'] == 'map'
    assert 'rviz_default_plugins/TF' in {display['Class'] for display in displays(main)}


# Foxglove

OF_FOXGLOVE = {'/clicked_point'}  # A tool of Foxglove itself.


def paths_of(kind: str, config: dict[str, Any]) -> list[str]:
    """Return the message paths, TOPIC or TOPIC.FIELD.FIELD, that a panel shows."""
    match kind:
        case '3D':
            return list(config['topics'])
        case 'Image':
            return [config['imageMode']['imageTopic']]
        case 'DiagnosticSummary':
            return [config['topicToRender']]
        case 'Plot':
            return [path['value'] for path in config['paths']]
        case 'RawMessages':
            return [config['topicPath']]
    assert kind == 'Tab'
    return []


def panels() -> list[tuple[str, dict[str, Any]]]:
    return [(panel.split('!')[0], config) for panel, config in FOXGLOVE['configById'].items()]


def test_foxglove_paths_exist_with_types_of_nodes(topics: dict[str, Topic]) -> None:
    for kind, config in panels():
        for path in paths_of(kind, config):
            name, *fields = path.split('.')
            topic = topics[name]
            allowed = FOXGLOVE_TYPES[kind]
            assert allowed is None or topic.kind.__name__ in allowed, path
            functools.reduce(getattr, fields, topic.kind())


def test_foxglove_shows_every_published_topic(topics: dict[str, Topic]) -> None:
    shown = {path.split('.')[0] for panel in panels() for path in paths_of(*panel)}
    goals = {'/experience_map/goal'}  # of the actions, with nav2_msgs only: requests, not results
    assert published(topics) - shown - goals == set(NOT_IN_FOXGLOVE)
    mentioned = set(re.findall(r'"(/[a-z_/]+)[".]', json.dumps(FOXGLOVE)))
    assert mentioned - set(topics) == OF_FOXGLOVE
    assert {'/goal_pose', '/initialpose'} <= mentioned


def test_foxglove_layout_has_each_panel_once() -> None:
    def named(layout: Any) -> list[str]:
        if isinstance(layout, dict):
            return named(layout['first']) + named(layout['second'])
        tabs = FOXGLOVE['configById'][layout].get('tabs', ())
        return [layout, *(panel for tab in tabs for panel in named(tab['layout']))]

    assert sorted(named(FOXGLOVE['layout'])) == sorted(FOXGLOVE['configById'])
