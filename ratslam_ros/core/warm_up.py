# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Warm-up: compile all numba functions, or load them from the cache, before the first message."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion, MotionFromOdometry, Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.rotation_gain import scale_of_turns
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.common.turn_correction import UNCORRECTED
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.link_learning import has_detour
from ratslam_ros.core.mapping.mapping_step import apply_action
from ratslam_ros.core.pose_cells.map_action import Action, MapAction
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.built_in import BUILT_IN
from ratslam_ros.core.vision.local_view import LocalView, ViewMatch
from ratslam_ros.core.vision.visual_odometry import VisualOdometry

_SMALL_CONFIG = {
    'local_view.template_x_size': 4, 'local_view.template_y_size': 2,
    'local_view.vt_shift_match': 1, 'local_view.vt_shift_match_y': 0,
    'local_view.vt_patch_normalise': 1, 'local_view.vt_match_threshold': 0.03,
    'local_view.vt_recent_templates': 0,
    'pose_cells.pc_dim_x': 21, 'pose_cells.pc_dim_y': 21, 'pose_cells.pc_cell_x_size': 1.0,
    'pose_cells.exp_delta_pc_threshold': 2.0, 'pose_cells.pc_vt_agree_cells': 3.0,
    'pose_cells.pc_vt_agree_spacing': 2.0,
}
"""Parameters that make warming up fast, and values in place of automatic ones, which need longer
drives; the compiled code does not depend on them."""

_MOTION = Motion(1.0, 1.0, 0.1)
"""Any motion that translates and rotates."""


def warm_up(*parts: str) -> None:
    """Call every compiled function of some parts once; slow if nothing is cached yet.

    Args:
        parts: names of the parameter sections of the parts that will run; ``'scan_alignment'``
            stands for scan matching, ``'relocation'`` for relocation by scans. By default, all
            parts that build a map, without navigation.
    """
    config = Config().with_values(_SMALL_CONFIG)
    wrap(0.0)  # Used by all parts.
    for part in parts or _MAPPING:
        _PARTS[part](config)


def _images() -> list[NDArray[np.uint8]]:
    ramp = np.add.outer(np.arange(4), np.arange(8))
    return [(5 * ramp + 60 * frame).astype(np.uint8) for frame in range(3)]


def _visual_odometry(config: Config) -> None:
    for refined in (False, True):
        parameters = replace(config.visual_odometry, vrot_subpixel=refined)
        visual_odometry = VisualOdometry(parameters)
        for frame, image in enumerate(_images()):
            visual_odometry.estimate(frame, image)


def _local_view(config: Config) -> None:
    for descriptor in BUILT_IN:
        local_view = LocalView(
            replace(config.local_view, vt_descriptor=descriptor, vt_min_structure=1e-6)
        )
        for image in _images():
            local_view.match(image)


def _pose_cells(config: Config) -> None:
    motion_from = MotionFromOdometry(config.inputs.odom_source)
    for views in (0.0, 1.0):  # With 0, every recognised view injects activity.
        pose_cells = PoseCells(replace(config.pose_cells, pc_vt_agree_views=views))
        for n in range(30):  # Two rounds: in the second, recognised views inject activity.
            motion_from.update(Odometry(n * 10**9, Twist(1.0, 0.1), Pose(0.0, 0.0, 0.0)))
            pose_cells.integrate(_MOTION)
            pose_cells.view(ViewMatch(n % 15, n < 15, 0.0, 0.0))
    scale_of_turns(np.full(10, 6.0), 0.5, 2.0)
    pose_cells.activity()


def _experience_map(config: Config) -> ExperienceMap:
    for relaxation in ('sweep', 'batch', 'solve'):
        parameters = replace(config.experience_map, exp_relaxation=relaxation)
        experience_map = ExperienceMap(parameters)
        for n in (0, 1, 2, 0):
            experience_map.integrate(_MOTION)
            kind: Action = 'create' if n == len(experience_map) else 'link'
            source = experience_map.current_id
            experience_map.apply(MapAction(kind, source, n, n, 0.0, Place(0.0, 0.0, 0.0)))
    experience_map.correct_turns(UNCORRECTED, UNCORRECTED)
    experience_map.unlearn_blocked('wait', 0.0)
    experience_map.apply(MapAction('create', 0, 2, 3, 0.0, Place(0.0, 0.0, 0.0)))
    place = Place(0.0, 0.0, 0.0)
    experience_map.apply(
        MapAction('none', 2, 2, 0, 0.0, place, recognised_id=0, agreement=1.0, view_spacing_m=1.0)
    )
    links = experience_map.link_ends, experience_map.link_table.durations_s
    has_detour(*links, 0, len(experience_map))
    experience_map.covariance.on_map(0.0)
    return experience_map


def _scan_alignment(config: Config) -> None:
    from ratslam_ros.core.mapping.icp import align
    from ratslam_ros.core.mapping.occupancy_grid import OccupancyGrid
    from ratslam_ros.core.mapping.scan_match import VIEW_SD_M
    from ratslam_ros.core.mapping.scan_matching import ScanMatcher

    corner = np.concatenate([np.arange(40.0)[:, None] * step for step in ((0.1, 0.0), (0.0, 0.1))])
    align(corner, corner, Pose(0.0, 0.0, 0.0), VIEW_SD_M)
    grid = OccupancyGrid(1.0)
    experience_map, matcher = _experience_map(config), ScanMatcher()
    matcher.integrate(0, _MOTION)
    matcher.scan(_room_scan(0))
    action = MapAction('create', -1, 0, 9, 0.0, Place(0.0, 0.0, 0.0))
    apply_action(experience_map, matcher, 0, action)
    grid.update(experience_map, matcher, 1)
    for _ in grid.picture():
        pass


def _relocation(config: Config) -> None:
    from ratslam_ros.core.landmarks.relocalisation import relocalise
    from ratslam_ros.core.mapping.keyframes import landmarks_of
    from ratslam_ros.core.mapping.place_landmarks import features_of
    from ratslam_ros.core.mapping.relocator import WHEN_LOST, Relocator
    from ratslam_ros.core.mapping.scan_matching import ScanMatcher

    experience_map, matcher = _experience_map(config), ScanMatcher()
    relocator = Relocator(experience_map, matcher)
    for n in range(8):  # Each experience sees the corners of the room, and is compared.
        stamp_ns = n * 10**8
        matcher.integrate(stamp_ns, _MOTION)
        matcher.scan(_room_scan(stamp_ns))
        experience_map.integrate(_MOTION)
        action = MapAction(
            'create', experience_map.current_id, len(experience_map), 9 + n, 0.0,
            Place(0.0, 0.0, 0.0),
        )
        apply_action(experience_map, matcher, stamp_ns, action, relocator=relocator)
    relocator.search()
    observed = matcher.observed(stamp_ns)
    assert observed is not None
    features = features_of(landmarks_of(observed))
    relocalise(features, features, WHEN_LOST, 0)


def _room_scan(stamp_ns: int) -> Scan:
    """Return the scan of a square room of 4 m."""
    angles = np.radians(np.arange(-180.0, 180.0))
    ranges_m = 2.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    return Scan(stamp_ns, -np.pi, float(angles[1] - angles[0]), ranges_m)


def _goal_recall(config: Config) -> None:
    from ratslam_ros.core.navigation.navigator import Navigator  # Imports SciPy.

    experience_map = _experience_map(config)
    navigator = Navigator(replace(config.goal_recall, goal_radius_m=0.0), experience_map)
    navigator.go_to(1)
    navigator.update(0)
    experience_map.apply(MapAction('link', 0, 0, 0, 0.0, Place(0.0, 0.0, 0.0)))
    navigator.update(0)  # After a change of the links.


def _goal_memory(config: Config) -> None:
    from ratslam_ros.core.goal_memory.goal_routes import GoalRoutes  # Imports SciPy.

    memory, pose_cells = GoalRoutes(config.pose_cells), PoseCells(config.pose_cells)
    for _ in range(4):
        pose_cells.integrate(_MOTION)
        memory.integrate(_MOTION, pose_cells)
    times = memory.recall(pose_cells.peak)
    memory.bearing(times, pose_cells.peak)


def _goal_follower(config: Config) -> None:
    from ratslam_ros.core.driving.goal_follower import GoalFollower

    follow = GoalFollower(config.goal_follower)
    for ahead_m in (2.0, 0.5):  # Free, then blocked by an obstacle.
        scan = Scan(0, -1.0, 1.0, np.array([1.0, ahead_m, 1.0]))
        follow.command(scan, np.array([[0.0, 0.0], [1.0, 0.0]]))


def _landmark_map(config: Config) -> None:
    from ratslam_ros.core.landmarks.laser_map import LaserMap

    # The corners of the room are confirmed, added, seen again, and found when lost.
    scan = _room_scan(0)
    laser_map = LaserMap(interval_m=0.0)
    for _ in range(6):
        laser_map.integrate(Motion(1.0, 1e-3, 0.0))
        laser_map.scan(scan)
    laser_map.lose()
    for _ in range(2):
        laser_map.integrate(Motion(1.0, 1e-3, 0.0))
        laser_map.scan(scan)
    laser_map.memory.map.features()


_MAPPING: dict[str, Callable[[Config], object]] = {
    'visual_odometry': _visual_odometry,
    'local_view': _local_view,
    'pose_cells': _pose_cells,
    'experience_map': _experience_map,
}
"""Functions that warm up the parts of the mapping pipeline."""

_PARTS = {
    **_MAPPING, 'goal_recall': _goal_recall, 'goal_memory': _goal_memory,
    'goal_follower': _goal_follower, 'scan_alignment': _scan_alignment,
    'relocation': _relocation,
    'landmark_map': _landmark_map,
}
"""Functions that warm up each part by name."""
