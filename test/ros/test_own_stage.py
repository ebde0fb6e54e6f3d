# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stages of the user as nodes, in the place of local_view and beside all nodes."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import pytest
from ros_messages import MakeWorld
from std_msgs.msg import String
from test_map_operations import SMALL, Nodes

from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.maps.system import load_map
from ratslam_ros.messages.map_commands import SUFFIX
from ratslam_ros.own_stages import own_stages
from ratslam_ros.ros.host import Host
from ratslam_ros.ros.own_nodes import node_of, with_own
from ratslam_ros.ros.qos import LATCHED
from ratslam_ros.ros.single_process import KINDS

ROOT = Path(__file__).parents[2]
IMAGES = 12
NAMES = [
    f'{ROOT}/examples/custom_stage.py:HashView',
    f'{ROOT}/test/own_counters.py:Brightness',
]
HASH_VIEW, BRIGHTNESS = own_stages(NAMES)


def test_stage_with_a_name_of_its_own_is_a_node_beside_the_others(
    world: MakeWorld, tmp_path: Path
) -> None:
    given = '-p', f'map:={tmp_path}/a.map', '-p', f'memory_folder:={tmp_path}'
    counts: list[list[int]] = []
    for session in (0, 1):
        host = Host()
        kinds = with_own(KINDS[1:], NAMES)
        assert [kind.SECTION for kind in kinds] == [
            'local_view', 'pose_cells', 'experience_map', 'brightness'
        ]
        nodes = Nodes.__new__(Nodes)
        made = nodes.world = world(
            *(partial(kind, Config(), host) for kind in kinds), arguments=(*SMALL, *given)
        )
        host.start()
        host.map.open()
        nodes.statuses = made.listen(String, 'ratslam/map_status', LATCHED)
        nodes.count = session * IMAGES
        nodes.drive(IMAGES)
        stage: Any = host.pipeline.stages['brightness']
        made.until(lambda stage=stage, count=nodes.count: stage.counts[1] == count)
        assert nodes.ask('save', 'all')['state'] == 'done'
        made.close()
        made.close = lambda: None
        for path in (tmp_path / 'a.map', tmp_path / f'all{SUFFIX}'):
            slam: Any = load_map(path, stages=[HASH_VIEW, BRIGHTNESS])
            counts.append(slam.pipeline.stages['brightness'].counts.tolist())
            hashes = slam.pipeline.stages['local_view'].state()['hashes']
            assert len(hashes) == nodes.count
    assert [actions for _, actions in counts] == [IMAGES, IMAGES, 2 * IMAGES, 2 * IMAGES]
    assert counts[3][0] > counts[1][0] == counts[0][0] > 0


def test_own_stage_in_the_place_of_another_node_is_refused() -> None:
    kind = type('Cells', (BRIGHTNESS,), {'NAME': 'pose_cells'})
    with pytest.raises(UnusableParameter, match=r'Cells .* pose_cells .*--stages'):
        node_of(kind)
