# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Mapping step: one map action, applied to the scan matcher and the experience map."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from graphs import new_map, place_of
from helpers import ahead, circles_of_actions
from rooms import corridor, scan_in
from scans import ORIGIN, ROOM, TICK_NS, drive, map_action, pose_error

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.map_update import MapUpdate
from ratslam_ros.core.mapping.mapping_step import apply_action
from ratslam_ros.core.mapping.odometry_noise import UNMEASURED_VIEW
from ratslam_ros.core.mapping.scan_matching import ScanMatcher
from ratslam_ros.core.pose_cells.map_action import Action, MapAction
from ratslam_ros.messages.mapping import encode_map


def action_on(graph: ExperienceMap, kind: Action, target: int) -> MapAction:
    return MapAction(kind, graph.current_id, target, target, 0.0, place_of(target))


def test_without_scan_matcher_action_is_applied_directly() -> None:
    graph, direct = new_map(), new_map()
    for sequence, action in circles_of_actions(5, 3):
        for one in (graph, direct):
            one.integrate(ahead(1.0))
        update = apply_action(graph, None, sequence, action, 'left_wall')
        assert update == direct.apply(action, 'left_wall')
    assert encode_map(1, graph) == encode_map(1, direct)
    assert {link.behaviour for link in graph.links()} == {'left_wall'}


@pytest.mark.parametrize('with_matcher', [False, True])
def test_rejected_closure_is_reported(with_matcher: bool) -> None:
    graph = new_map(exp_gate_closures=True)
    matcher = ScanMatcher() if with_matcher else None
    for target in range(13):
        assert apply_action(graph, matcher, 0, action_on(graph, 'create', target)) == MapUpdate()
        graph.integrate(ahead(1.0))
    update = apply_action(graph, matcher, 0, action_on(graph, 'link', 2))
    assert update.reason and update.pruned is None
    assert graph.current_id == 12


def test_scan_corrects_the_pose_on_the_map() -> None:
    graph, matcher = new_map(), ScanMatcher()
    created_at, tick = drive(matcher, ROOM, ORIGIN, 0, 5)
    apply_action(graph, matcher, tick * TICK_NS, map_action('create', 0))
    graph.covariance.replace(UNMEASURED_VIEW)  # the odometry does not measure where it is carried
    recognised_at, tick = drive(matcher, ROOM, Pose(-0.1, 0.2, 0.1), tick, 5)
    apply_action(graph, matcher, tick * TICK_NS, map_action('set', 0))
    error_m, error_rad = pose_error(graph.offset, composed(inverse(created_at), recognised_at))
    assert error_m < 0.03
    assert error_rad < 0.02


def test_rejected_closure_leaves_the_covariance() -> None:
    graph, matcher, tick = new_map(exp_gate_closures=True), ScanMatcher(), 0
    for target in range(13):
        _, tick = drive(matcher, corridor(), ORIGIN, tick, 4, still=True)
        apply_action(graph, matcher, tick * TICK_NS, action_on(graph, 'create', target))
        graph.integrate(ahead(1.0))
    before = graph.covariance.matrix.copy()
    false_closure = action_on(graph, 'link', 2)
    assert apply_action(graph, matcher, tick * TICK_NS, false_closure).reason
    assert np.array_equal(graph.covariance.matrix, before)


def test_aligned_scan_gives_the_covariance_of_its_alignment() -> None:
    """A bare corridor does not measure the position along its axis."""
    graph, matcher = new_map(), ScanMatcher()
    _, tick = drive(matcher, corridor(), ORIGIN, 0, 4, still=True)
    apply_action(graph, matcher, tick * TICK_NS, map_action('create', 0))
    graph.covariance.replace(UNMEASURED_VIEW)
    apply_action(graph, matcher, tick * TICK_NS, map_action('set', 0))
    along_m2, across_m2, heading_rad2 = np.diag(graph.covariance.matrix)
    assert along_m2 == pytest.approx(UNMEASURED_VIEW[0, 0], rel=0.01)
    assert across_m2 < 0.02 * along_m2
    assert heading_rad2 < 0.1 * UNMEASURED_VIEW[2, 2]


def test_aligned_scans_keep_the_covariance_consistent_on_new_ground() -> None:
    """The heading drifts much more than the robot assumes before scans have measured it."""
    nees, heading_std_rad = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        graph, matcher = new_map(), ScanMatcher()
        true = ORIGIN
        for tick in range(120):
            if tick % 3 == 0:
                scan = scan_in(ROOM, true, tick * TICK_NS, beams=181)
                noisy_m = scan.ranges_m + rng.normal(0.0, 0.01, 181)
                matcher.scan(replace(scan, ranges_m=noisy_m))
            motion = Motion(0.1, 0.05, 0.06)
            matcher.integrate(tick * TICK_NS, motion)
            graph.integrate(motion)
            error_rad = float(rng.normal(0.0, 0.006))
            true = composed(true, Pose(0.05, 0.0, 0.06 + error_rad))
            if tick % 6 == 2:
                stamp_ns = tick * TICK_NS
                apply_action(graph, matcher, stamp_ns, action_on(graph, 'create', len(graph)))
        x_m, y_m, heading_rad = composed(inverse(graph.pose), true)
        error = np.array([x_m, y_m, math.remainder(heading_rad, math.tau)])
        nees.append(error @ np.linalg.solve(graph.covariance.matrix, error))
        heading_std_rad.append(math.sqrt(graph.covariance.matrix[2, 2]))
    assert 1.0 < np.mean(nees) < 5.0
    assert max(heading_std_rad) < 0.5 * 0.006 * math.sqrt(120)
