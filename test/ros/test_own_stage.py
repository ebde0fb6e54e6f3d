# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stages of the user as nodes, in the place of local_view and beside all nodes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from test_map_operations import SMALL as MAP_SMALL
from test_map_operations import Nodes

from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.maps.system import load_map
from ratslam_ros.own_stages import own_stages

ROOT = Path(__file__).parents[2]
IMAGES = 12
NAMES = [
    f'{ROOT}/examples/custom_stage.py:HashView',
    f'{ROOT}/test/own_counters.py:Brightness',
]
HASH_VIEW, BRIGHTNESS = own_stages(NAMES)


def test_own_stage_as_a_node_is_saved_and_continued(
    world: Callable[..., Any], tmp_path: Path
) -> None:
    from ratslam_ros.ros.own_nodes import node_of

    path = tmp_path / 'a.map'
    for session in (0, 1):
        nodes = Nodes(world, '-p', f'map:={path}', local_view=node_of(HASH_VIEW))
        nodes.count = session * IMAGES  # A restarted memory would number its views from 0.
        nodes.drive(IMAGES)
        nodes.until_mapped()
        assert nodes.world.nodes[0]._last.template_id == nodes.count - 1
        nodes.world.close()
        nodes.world.close = lambda: None
    slam = load_map(path, stages=[HASH_VIEW])
    assert len(slam.pipeline.stages['local_view'].state()['hashes']) == nodes.count
    assert [label[0] for label in slam.experience_map.labels][-1] > IMAGES


def test_stage_with_a_name_of_its_own_is_a_node_beside_the_others(
    world: Callable[..., Any], tmp_path: Path
) -> None:

    from ratslam_ros.ros.host import Host
    from ratslam_ros.ros.own_nodes import with_own
    from ratslam_ros.ros.single_process import KINDS

    counts: list[list[int]] = []
    for session in (0, 1):
        host = Host()
        made = Nodes.__new__(Nodes)
        kinds = with_own(KINDS[1:], NAMES)
        assert [kind.SECTION for kind in kinds] == [
            'local_view', 'pose_cells', 'experience_map', 'brightness'
        ]  # fmt: skip
        made.world = world(
            *(partial(kind, Config(), host) for kind in kinds),
            arguments=(*MAP_SMALL, '-p', f'map:={tmp_path}/a.map'),
        )
        host.start()
        for node in made.world.nodes:
            node.open_map()
        made.count = session * IMAGES
        made.drive(IMAGES)
        made.world.until(lambda host=host: not host.pipeline.order.held)  # type: ignore[misc]
        made.world.close()
        made.world.close = lambda: None
        slam = load_map(tmp_path / 'a.map', stages=[HASH_VIEW, BRIGHTNESS])
        counts.append(slam.pipeline.stages['brightness'].counts.tolist())  # type: ignore[attr-defined]
    assert counts[1][1] == 2 * IMAGES
    assert counts[1][0] > counts[0][0] > 0


def test_own_stage_in_the_place_of_another_node_is_refused() -> None:
    from ratslam_ros.ros.own_nodes import node_of

    kind = type('Cells', (BRIGHTNESS,), {'NAME': 'pose_cells'})
    with pytest.raises(UnusableParameter, match=r'Cells .* pose_cells .*--stages'):
        node_of(kind)
