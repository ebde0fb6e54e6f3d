# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Result files of a drive whose odometry has gaps."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from gap_drives import GAP_NS, LAP_STEPS, PERIOD_NS, Drive, config, true_pose
from helpers import seen, twist

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.results.plots import draw_map
from ratslam_ros.results.trajectory import read_tum
from ratslam_ros.results.writer import Results


def test_poses_after_a_gap_move_with_the_component(tmp_path: Path) -> None:
    """trajectory_final is continuous where only an odometry message precedes the next view."""
    drive = Drive(config())
    results = Results(tmp_path, config())
    drive.forward(15)
    drive.carry(15)
    for n in range(1, 40):  # odometry is five times as frequent as views
        drive.at += 1
        for part in range(1, 6):
            drive.stamp_ns += PERIOD_NS // 5
            turn = wrap(true_pose(drive.at).heading_rad - true_pose(drive.at - 1).heading_rad)
            rate = 0.0 if part < 5 else turn / (PERIOD_NS * 1e-9 / 5)
            drive.steps += drive.slam.odometry(twist(drive.stamp_ns, 1.0, rate))
            if n == 12 and part == 2:
                drive.stamp_ns += GAP_NS
        drive.truths[drive.stamp_ns] = true_pose(drive.at)
        drive.steps += drive.slam.template(drive.stamp_ns, seen(drive.at % LAP_STEPS))
    drive.forward(LAP_STEPS)
    graph = drive.finish().experience_map
    for step in drive.steps:
        results.add(step)
    assert results.gap_count == 2
    results.finish(graph, {})
    lines = (tmp_path / 'trajectory_final.tum').read_text().splitlines()
    comments = [line for line in lines if line.startswith('#')]
    assert comments == [f'# odometry gap of {s} s: unknown motion' for s in ('10.000', '10.100')]
    final = read_tum(tmp_path / 'trajectory_final.tum').position_m
    gaps = [n - k for k, n in enumerate(i for i, t in enumerate(lines) if t.startswith('#'))]
    steps_m = np.linalg.norm(np.diff(final, axis=0), axis=1)
    steps_m[[n - 1 for n in gaps]] = 0.0
    first, second = gaps
    assert steps_m[first : second + 20].max() < 0.3
    assert json.loads((tmp_path / 'map.json').read_text())['current_experience_id'] >= 0


def test_map_with_separate_component_is_drawn_in_two_colours(tmp_path: Path) -> None:
    drive = Drive(config())
    drive.forward(15)
    drive.carry(15)
    drive.forward(30)
    drive.finish()
    results = Results(tmp_path, config())
    for step in drive.steps:
        results.add(step)
    results.finish(drive.slam.experience_map, {})
    image = cv2.imread(str(draw_map(tmp_path)))
    pink = np.array([0xA7, 0x79, 0xCC])
    assert (np.abs(image.astype(int) - pink).max(axis=2) < 8).sum() > 50
