# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes of the pose cells and the map, for odometry with gaps."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

from gap_drives import LAP_STEPS, Drive, config
from geometry_msgs.msg import PoseStamped
from ros_messages import MakeWorld, odometry, template
from std_msgs.msg import String

from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.pose_cells_node import PoseCellsNode
from ratslam_ros.ros.qos import LATCHED


def drive_with_gaps() -> Drive:
    drive = Drive(config())
    drive.forward(15)
    drive.carry(15)
    drive.forward(20)
    drive.carry(10)
    drive.forward(LAP_STEPS)
    drive.finish()
    return drive


def parameters(folder: Path) -> tuple[str, ...]:
    return tuple(
        item for setting in (
            'base:=extended', 'max_odom_gap_s:=2.0', 'pc_dim_xy:=41',
            'exp_delta_pc_threshold:=0.4', 'exp_initial_em_deg:=0.0', 'map_period_s:=0.05',
            f'memory_folder:={folder}',
            'flush_after_s:=1.0', 'max_lateness_s:=60.0',
        ) for item in ('-p', setting)
    )


def send(made: Any, drive: Drive, first: int, end: int) -> None:
    for stamp_ns, moved in list(drive.messages.items())[first:end]:
        made.send('odom', odometry(stamp_ns, *moved.twist[:2]))
        found = template(stamp_ns, drive.templates[stamp_ns], error=0.0)
        made.send('local_view/template', found)
        for _ in range(6):  # both nodes, and the action from one to the other
            made.executor.spin_once(timeout_sec=0.002)


def test_nodes_build_the_map_of_a_replay(world: MakeWorld, tmp_path: Path) -> None:
    drive = drive_with_gaps()
    made = world(PoseCellsNode, ExperienceMapNode, arguments=parameters(tmp_path))
    maps = made.listen(String, 'experience_map/map', LATCHED)
    poses = made.listen(PoseStamped, 'experience_map/pose')
    end = len(drive.messages)
    send(made, drive, 0, 30)
    made.until(lambda: maps and json.loads(maps[-1].data).get('components', [0])[-1] == 1)
    send(made, drive, 30, end)
    last_ns = max(drive.messages)
    expected = encode_map(last_ns, drive.slam.experience_map)
    made.until(lambda: maps[-1].data == expected)
    status = made.diagnostics()
    assert status['pose_cells']['odometry_gaps'] == '2'
    assert status['experience_map']['components'] == '1'
    assert json.loads(expected).get('components') is None
    steps_m = [
        abs(b.pose.position.x - a.pose.position.x) + abs(b.pose.position.y - a.pose.position.y)
        for a, b in itertools.pairwise(poses[:40])
    ]
    # Continuous at the gap; two steps pass until the jump of the stamps is confirmed.
    assert max(steps_m) < 1.5
