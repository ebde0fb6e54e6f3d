# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Distance since the last known place, and its effect on failed tries."""

from __future__ import annotations

import pytest
from route_maps import NOWHERE

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.navigator import (
    MAX_TRY_COUNT,
    MAX_UNCERTAIN_TRY_COUNT,
    Navigator,
)
from ratslam_ros.core.pose_cells.map_action import MapAction


def step(graph: ExperienceMap) -> None:
    """Drive 0.5 m in 1 s and create an experience."""
    graph.integrate(Motion(1.0, 0.5, 0.0))
    new = len(graph)
    graph.apply(MapAction('create', graph.current_id, new, new, 0.0, NOWHERE))


def straight(length: int) -> ExperienceMap:
    """Return a map of a straight drive of ``length`` steps."""
    graph = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    for _ in range(length):
        step(graph)
    return graph


def navigator_to_start(graph: ExperienceMap) -> Navigator:
    navigator = Navigator(GoalRecallParameters(goal_sure_m=2.0, goal_radius_m=0.1), graph)
    navigator.go_to(0)
    navigator.update(0)
    return navigator


def test_certain_position_counts_failures() -> None:
    navigator = navigator_to_start(straight(10))
    assert all(navigator.report_blocked() for _ in range(MAX_TRY_COUNT))
    assert not navigator.update(1).explore
    navigator.report_blocked()
    assert navigator.update(2).explore  # the position must be wrong


def test_uncertain_position_starts_recovery() -> None:
    graph = straight(10)
    navigator = navigator_to_start(graph)
    for stamp_ns in range(1, 4):
        step(graph)  # away from the goal, on unknown ground
        for _ in range(3):
            guidance = navigator.update(stamp_ns)
    assert guidance.unknown_m == pytest.approx(0.6)  # a jump counts as MAX_STEP_M
    assert navigator.report_blocked()
    for stamp_ns in range(4, 20):
        step(graph)
        guidance = navigator.update(stamp_ns)
    assert guidance.unknown_m > 2.0
    for _ in range(MAX_UNCERTAIN_TRY_COUNT + 1):
        assert not navigator.report_blocked()
    assert navigator.update(20).explore


def test_aligned_scan_resets_unknown_distance() -> None:
    graph = straight(10)
    navigator = navigator_to_start(graph)
    for stamp_ns in range(1, 12):
        step(graph)
        guidance = navigator.update(stamp_ns)
    assert guidance.unknown_m > 2.0
    graph.scan_confirmed_m = 1.0
    assert navigator.update(12).unknown_m < 0.3
    for stamp_ns in range(13, 24):
        step(graph)
        guidance = navigator.update(stamp_ns)
    assert guidance.unknown_m > 2.0  # only one scan was aligned


def test_new_experience_with_reused_id_is_unknown() -> None:
    graph = straight(10)
    navigator = navigator_to_start(graph)
    for stamp_ns in range(1, 12):
        graph.integrate(Motion(1.0, 0.5, 0.0))
        number = 1 + stamp_ns % 5
        graph.apply(MapAction('create', graph.current_id, number, 20, 0.0, NOWHERE))
        guidance = navigator.update(stamp_ns)
    assert guidance.unknown_m > 2.0
