# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The layouts for RViz and Foxglove: well-formed, and of documented topics."""

import json
import re
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]
RVIZ: dict[str, Any] = yaml.safe_load((ROOT / 'rviz' / 'ratslam.rviz').read_text('utf-8'))
FOXGLOVE: dict[str, Any] = json.loads((ROOT / 'foxglove' / 'ratslam.json').read_text('utf-8'))

PAGE = (ROOT / 'docs' / 'topics.md').read_text('utf-8')
TABLE = PAGE[PAGE.index('## Topics\n') : PAGE.index('### Stamps')]
ROWS = re.findall(r'^\| (`[^|]+) \| ([^|]+) \|', TABLE, re.MULTILINE)


def named(rows: list[tuple[str, str]]) -> set[str]:
    """Return the names of topics in the root namespace."""
    names = [name for topics, _ in rows for name in re.findall(r'`([^`]+)`', topics)]
    return {'/' + name.lstrip('/') for name in names}


TOPICS = named(ROWS)
LATCHED = named([row for row in ROWS if 'latched' in row[1]])
OF_FOXGLOVE = {'/clicked_point', '/initialpose'}  # Tools of Foxglove itself.


def test_documentation_of_topics_is_parsed() -> None:
    assert {'/image', '/image/compressed', '/tf', '/goal_pose', '/experience_map/map'} <= TOPICS
    assert '/experience_map/markers' in LATCHED and '/odom' not in LATCHED


def displays() -> list[dict[str, Any]]:
    manager = RVIZ['Visualization Manager']
    return [*manager['Displays'], *manager['Tools']]


def test_rviz_shows_documented_topics_in_map_frame() -> None:
    shown = {display['Topic']['Value'] for display in displays() if 'Topic' in display}
    assert shown <= TOPICS
    assert shown >= {
        '/image', '/local_view/matched', '/pose_cells/activity', '/experience_map/markers',
        '/experience_map/pose', '/experience_map/route', '/odom', '/goal_pose',
    }  # fmt: skip
    assert RVIZ['Visualization Manager']['Global Options']['Fixed Frame'] == 'map'
    assert 'rviz_default_plugins/TF' in {display['Class'] for display in displays()}


def test_rviz_durability_matches_the_publishers() -> None:
    for display in displays():
        if 'Topic' in display:
            topic = display['Topic']
            wanted = 'Transient Local' if topic['Value'] in LATCHED else 'Volatile'
            assert topic['Durability Policy'] == wanted, topic['Value']


def test_foxglove_shows_documented_topics() -> None:
    found = set(re.findall(r'"(/[a-z_/]+)[".]', json.dumps(FOXGLOVE)))
    assert found <= TOPICS | OF_FOXGLOVE
    assert found >= {
        '/image', '/local_view/matched', '/pose_cells/activity', '/experience_map/markers',
        '/experience_map/route', '/diagnostics', '/goal_pose',
    }  # fmt: skip


def test_foxglove_layout_has_each_panel_once() -> None:
    def panels(layout: Any) -> list[str]:
        if isinstance(layout, str):
            return [layout]
        return panels(layout['first']) + panels(layout['second'])

    assert sorted(panels(FOXGLOVE['layout'])) == sorted(FOXGLOVE['configById'])
    kinds = {panel.split('!')[0] for panel in FOXGLOVE['configById']}
    assert kinds == {'3D', 'Image', 'DiagnosticSummary', 'RawMessages'}
