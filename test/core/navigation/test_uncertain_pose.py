# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Arrival and failed tries while the pose is uncertain."""

from __future__ import annotations

import pytest
from route_maps import NOWHERE

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.pose_covariance import UNCERTAIN_M, isotropic
from ratslam_ros.core.navigation.navigator import MAX_TRY_COUNT, MAX_UNCERTAIN_TRY_COUNT, Navigator
from ratslam_ros.core.pose_cells.map_action import MapAction

CERTAIN, UNCERTAIN = isotropic(0.9 * UNCERTAIN_M, 0.1), isotropic(1.1 * UNCERTAIN_M, 0.1)


def straight(length: int) -> ExperienceMap:
    """Return a map of a straight drive of ``length`` steps."""
    graph = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    for new in range(length):
        graph.integrate(Motion(1.0, 0.5, 0.0))
        graph.apply(MapAction('create', graph.current_id, new, new, 0.0, NOWHERE))
    return graph


def navigator_to(graph: ExperienceMap, goal: int) -> Navigator:
    navigator = Navigator(GoalRecallParameters(goal_radius_m=0.1), graph)
    navigator.go_to(goal)
    navigator.update(0)
    return navigator


def test_certain_pose_counts_failures() -> None:
    graph = straight(10)
    graph.covariance.replace(CERTAIN)
    navigator = navigator_to(graph, 0)
    assert all(navigator.report_blocked() for _ in range(MAX_TRY_COUNT))
    assert not navigator.update(1).explore
    navigator.report_blocked()
    assert navigator.update(2).explore  # the position must be wrong


def test_uncertain_pose_starts_recovery() -> None:
    graph = straight(10)
    navigator = navigator_to(graph, 0)
    graph.covariance.replace(UNCERTAIN)
    for _ in range(MAX_UNCERTAIN_TRY_COUNT + 1):
        assert not navigator.report_blocked()
    assert navigator.update(1).explore


@pytest.mark.parametrize('is_certain', [True, False])
def test_goal_is_reached_only_at_a_certain_pose(is_certain: bool) -> None:
    graph = straight(10)
    navigator = Navigator(GoalRecallParameters(goal_radius_m=0.1), graph)
    navigator.go_to(9)
    graph.covariance.replace(CERTAIN if is_certain else UNCERTAIN)
    assert (navigator.update(1).status == 'succeeded') == is_certain
    graph.covariance.replace(CERTAIN)
    assert is_certain or navigator.update(2).status == 'succeeded'
