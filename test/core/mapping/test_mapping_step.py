# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Mapping step: one map action, applied to the scan matcher and the experience map."""

from __future__ import annotations

import pytest
from graphs import new_map, place_of
from helpers import ahead, circles_of_actions
from rooms import corridor
from scans import HALL, ORIGIN, ROOM, TICK_NS, drive, map_action, pose_error

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.mapping.experience_map import ExperienceMap, MapUpdate
from ratslam_ros.core.mapping.mapping_step import apply_action
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
    graph = new_map(exp_jump_drift=0.05)
    matcher = ScanMatcher() if with_matcher else None
    for target in range(13):
        assert apply_action(graph, matcher, 0, action_on(graph, 'create', target)) == MapUpdate()
        graph.integrate(ahead(1.0))
    update = apply_action(graph, matcher, 0, action_on(graph, 'link', 2))
    assert update.rejected and update.pruned is None
    assert graph.current_id == 12


def test_scan_corrects_the_pose_on_the_map() -> None:
    graph, matcher = new_map(), ScanMatcher()
    created_at, tick = drive(matcher, ROOM, ORIGIN, 0, 5)
    apply_action(graph, matcher, tick * TICK_NS, map_action('create', 0))
    recognised_at, tick = drive(matcher, ROOM, Pose(-0.1, 0.2, 0.1), tick, 5)
    apply_action(graph, matcher, tick * TICK_NS, map_action('set', 0))
    error_m, error_rad = pose_error(graph.offset, composed(inverse(created_at), recognised_at))
    assert error_m < 0.03
    assert error_rad < 0.02


def offset_after_recognition(closure: str) -> float:
    """Return the robot's offset, in m, from an experience that is recognised 0.6 m early.

    The scans of a bare corridor do not measure the offset, so it depends on the position variance
    of the scan matcher.

    Args:
        closure: what precedes that recognition. 'none': nothing. 'rejected': a closure that the
            loop-closure gate rejects. 'not undone': the effect of such a closure on the scan
            matcher alone.
    """
    graph, matcher, tick = new_map(exp_jump_drift=0.05), ScanMatcher(), 0
    for target in range(13):
        _, tick = drive(matcher, corridor(), ORIGIN, tick, 4, still=True)
        apply_action(graph, matcher, tick * TICK_NS, action_on(graph, 'create', target))
        if target < 12:
            graph.integrate(ahead(1.0))
            matcher.integrate(tick * TICK_NS, Motion(0.1, 1.0, 0.0))
    for _ in range(40):  # repeated recognitions reduce the position variance
        matcher.locate(tick * TICK_NS, map_action('link', 12), -1, ORIGIN, ORIGIN)
    graph.integrate(ahead(0.6))
    if closure != 'none':
        _, tick = drive(matcher, HALL, ORIGIN, tick, 4, still=True)
        false_closure = action_on(graph, 'link', 2)
        if closure == 'rejected':
            assert apply_action(graph, matcher, tick * TICK_NS, false_closure).rejected
        else:
            matcher.locate(tick * TICK_NS, false_closure, 12, graph.offset, Pose(10.6, 0.0, 0.0))
    _, tick = drive(matcher, corridor(), ORIGIN, tick, 4, still=True)
    assert not apply_action(
        graph, matcher, tick * TICK_NS, action_on(graph, 'set', 12)
    ).rejected
    return graph.offset.x_m


def test_rejected_closure_restores_the_position_variance() -> None:
    undisturbed_m = offset_after_recognition('none')
    assert offset_after_recognition('rejected') == pytest.approx(undisturbed_m, abs=1e-6)
    assert offset_after_recognition('not undone') < undisturbed_m - 0.1
