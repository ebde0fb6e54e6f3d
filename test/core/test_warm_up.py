# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""After the warm-up, no function is compiled or loaded while messages are processed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

BEFORE = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from ratslam_ros.files.config import load_config
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.core.vision.local_view import LocalView, ViewMatch
from ratslam_ros.core.common.odometry import Motion, MotionFromOdometry, Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.visual_odometry import VisualOdometry
from ratslam_ros.core.warm_up import warm_up

def loaded():
    return {
        (function.py_func.__qualname__, str(signature))
        for module in list(sys.modules.values())
        if getattr(module, '__name__', '').startswith('ratslam_ros')
        for function in vars(module).values() if isinstance(function, Dispatcher)
        for signature in function.signatures
    }

def images():
    views = np.random.default_rng(0).integers(0, 256, (90, 60, 80), np.uint8)
    views.flags.writeable = False  # As in a ROS message.
    return [views[n % 80] for n in range(160)]

config, _ = load_config('openratslam')
"""

VISUAL_ODOMETRY = """
for refined in (False, True):
    changed = config.with_values({'visual_odometry.vrot_subpixel': refined})
    visual_odometry = VisualOdometry(changed.visual_odometry)
    for n, image in enumerate(images()):
        visual_odometry.estimate(n * 10**8, image)
"""

LOCAL_VIEW = """
for changed in (
    {}, {'vt_panoramic': True}, {'vt_normalisation': 0.5}, {'vt_patch_normalise': 2},
    {'vt_step_match': 2}, {'vt_recent_templates': 5}, {'vt_shift_match_y': 1},
    {'vt_descriptor': 'gradients', 'template_x_size': 12},
    {'vt_descriptor': 'gradients', 'template_x_size': 12, 'vt_panoramic': True},
    {'vt_min_structure': 1e-6},
):
    local_view = LocalView(
        config.with_values({f'local_view.{k}': v for k, v in changed.items()}).local_view
    )
    for image in images():
        local_view.match(image)
    again = LocalView(local_view._p)
    again.restore(local_view.state())
    again.match(images()[0])
"""

POSE_CELLS = """
pose_cells = PoseCells(config.with_values({'pose_cells.odom_calibration': True}).pose_cells)
motion_from = MotionFromOdometry('twist')
for n in range(300):
    motion = motion_from.update(Odometry(n * 10**8, Twist(0.5, 0.3), Pose(0.0, 0.0, 0.0)))
    if motion is not None:
        pose_cells.integrate(motion)
    if n % 3 == 0:
        pose_cells.view(ViewMatch(n % 120, n < 120, 0.1, 0.0))
pose_cells.activity()
again = PoseCells(config.pose_cells)
again.restore(pose_cells.state())
again.integrate(motion)
"""

EXPERIENCE_MAP = """
slam = RatSLAM(config.with_values({'pose_cells.odom_calibration': True}), 'pose_cells')
warm_up('pose_cells')  # Part of RatSLAM, but not of the experience map node.
before = loaded()
for n in range(300):
    slam.odometry(Odometry(n * 10**8, Twist(0.5, 0.3), Pose(0.0, 0.0, 0.0)))
    if n % 3 == 0:
        slam.template(n * 10**8 + 1, ViewMatch(n % 120, n < 120, 0.1, 0.0))
slam.finish()
graph = slam.experience_map
assert len(graph) > 20
again = ExperienceMap(config.experience_map)
again.restore(graph.state())
again.integrate(Motion(1.0, 1.0, 0.1))
"""

GOAL_RECALL = """
RoutePlanner(config.goal_recall, graph).route_to(0)
RoutePlanner(config.goal_recall, graph).route_to_place(0.0, 0.0, 50.0)
from ratslam_ros.core.navigation.navigator import Navigator
navigator = Navigator(config.goal_recall, graph)
goal, count = len(graph) // 2, graph.link_count
navigator.go_to(goal)
for n in range(40):
    navigator.update(n * 10**8)
    graph.integrate(Motion(0.1, 0.1, 0.03))
    graph.unlearn_blocked('turn', 0.1 * n)
"""
"""Continues with the map of EXPERIENCE_MAP."""

GOAL_MEMORY = """
from ratslam_ros.core.goal_memory.goal_routes import GoalRoutes
pose_cells = PoseCells(config.pose_cells)
memory = GoalRoutes(config.pose_cells)
for n in range(100):
    motion = Motion(0.1, 0.1, 0.03)
    pose_cells.integrate(motion)
    memory.integrate(motion, pose_cells)
times = memory.recall(Place(10.0, 10.0, 0.0))
assert len(memory.route_ahead(times, pose_cells.peak)) > 3
assert memory.bearing(times, pose_cells.peak) is not None
"""

GOAL_FOLLOWER = """
from ratslam_ros.core.driving.goal_follower import GoalFollower
from ratslam_ros.core.common.scan import Scan
modules = set(sys.modules)
follow = GoalFollower(config.goal_follower)
for n in range(40):
    ranges_m = np.full(181, 2.0)
    ranges_m[70:111] = 0.1 * n
    ranges_m[100] = np.inf
    for behaviour in ('', 'left_wall'):
        scan = Scan(n * 10**8, -np.pi / 2, np.pi / 180, ranges_m)
        follow.command(scan, np.array([[0.0, 0.0], [2.5, 0.0], [3.0, 1.0]]), behaviour)
assert modules == set(sys.modules)
"""

LANDMARK_MAP = """
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.landmarks.laser_map import LaserMap

laser_map = LaserMap()
angles = np.radians(np.arange(-90.0, 91.0))
for n in range(40):
    laser_map.integrate(Motion(0.1, 0.05, 0.2))
    heading = angles + 0.2 * n
    ranges = 2.0 / np.maximum(np.abs(np.cos(heading)), np.abs(np.sin(heading)) * 0.7)
    ranges[50 + n] = np.inf
    laser_map.scan(Scan(n * 10**8, float(angles[0]), float(angles[1] - angles[0]), ranges))
    if n == 30:
        laser_map.lose()
assert len(laser_map) > 0
"""

RELOCATION = """
sys.path.insert(0, 'test')
from kidnapped_drive import Drive, config, samples
drive = Drive(config())
drive.feed(samples(1, Pose(9.5, 9.4, np.pi + 0.2), 16))
assert drive.slam.relocator.counts['found'] == 1
"""


CHECK = """
warm_up(*{parts})
before = loaded()
assert before
{code}
new = loaded() - before
assert not new, new
"""


# Each part is in one process with parts that share no compiled functions with it.
@pytest.mark.parametrize('group', [
    [('visual_odometry', VISUAL_ODOMETRY), ('goal_follower', GOAL_FOLLOWER),
     ('landmark_map', LANDMARK_MAP)],
    [('local_view', LOCAL_VIEW), ('pose_cells', POSE_CELLS),
     ('pose_cells goal_memory', GOAL_MEMORY)],
    [('experience_map', EXPERIENCE_MAP), ('goal_recall', GOAL_RECALL)],
    [('pose_cells experience_map scan_alignment relocation', RELOCATION)],
], ids=lambda group: '-'.join(parts.split()[-1] for parts, _ in group))
def test_nothing_is_compiled_after_warm_up(group: list[tuple[str, str]]) -> None:
    code = BEFORE + ''.join(CHECK.format(parts=parts.split(), code=code) for parts, code in group)
    run = subprocess.run(
        [sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
