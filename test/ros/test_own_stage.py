# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A stage of the user in the place of local_view: examples/custom_stage.py as a node."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

from test_map_operations import Nodes

from ratslam_ros.maps.system import load_map
from ratslam_ros.pipeline.stage import Stage

IMAGES = 12
HASH_VIEW: type[Stage] = runpy.run_path(
    str(Path(__file__).parents[2] / 'examples' / 'custom_stage.py')
)['HashView']


def test_own_stage_as_a_node_is_saved_and_continued(
    world: Callable[..., Any], tmp_path: Path
) -> None:
    from ratslam_ros.ros.local_view_node import template_node

    path = tmp_path / 'a.map'
    for session in (0, 1):
        nodes = Nodes(world, '-p', f'map:={path}', local_view=template_node(HASH_VIEW))
        nodes.count = session * IMAGES  # A restarted memory would number its views from 0.
        nodes.drive(IMAGES)
        nodes.until_mapped()
        assert nodes.world.nodes[0]._last.template_id == nodes.count - 1
        nodes.world.close()
        nodes.world.close = lambda: None
    slam = load_map(path, stages=[HASH_VIEW])
    assert len(slam.pipeline.stages['local_view'].state()['hashes']) == nodes.count
    assert [label[0] for label in slam.experience_map.labels][-1] > IMAGES
