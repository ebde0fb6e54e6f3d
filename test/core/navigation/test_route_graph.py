# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The graph for route planning: link durations and shortcuts."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from route_maps import BACK, NOWHERE, link_times, wander
from states import filed

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.navigator import Navigator
from ratslam_ros.core.navigation.route_graph import route_graph
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.errors import UnreachableGoal


@pytest.mark.parametrize('back', [1.0, BACK, math.inf])
@pytest.mark.parametrize('seed', range(2))
def test_edge_weights_are_fastest_links(seed: int, back: float) -> None:
    rng = np.random.default_rng(seed)
    graph = ExperienceMap(ExperienceMapParameters())
    for _ in range(60):
        wander(graph, rng, islands=True)
        times = link_times(graph, back)
        matrix = route_graph(graph, 1.0, back)
        assert dict(zip(zip(*matrix.nonzero(), strict=True), matrix.data, strict=True)) == times
        assert (route_graph(graph, back, 1.0) != matrix.T).nnz == 0
    types = (matrix.data.dtype, matrix.indices.dtype, matrix.indptr.dtype)
    assert types == (np.float64, np.int32, np.int32)
    assert matrix.has_canonical_format


def step(graph: ExperienceMap, turn_rad: float = 0.0, behaviour: str = '') -> None:
    """Turn on the spot, drive 0.5 m in 1 s, and create an experience."""
    graph.integrate(Motion(0.0, 0.0, turn_rad))
    graph.integrate(Motion(1.0, 0.5, 0.0))
    new = len(graph)
    graph.apply(MapAction('create', graph.current_id, new, new, 0.0, NOWHERE), behaviour)


def there_and_back(length: int) -> ExperienceMap:
    """Drive ``length`` steps, turn, and drive back beside the same path."""
    graph = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    for _ in range(length):
        step(graph)
    step(graph, math.pi)
    for _ in range(length - 2):
        step(graph)
    return graph


def test_shortcut_avoids_detour_through_room() -> None:
    graph = there_and_back(7)
    without = RoutePlanner(GoalRecallParameters(), graph).route_to(0)
    with_shortcuts = RoutePlanner(GoalRecallParameters(route_join_m=0.35), graph).route_to(0)
    assert len(without.experience_ids) == len(graph)
    # The robot is at the goal already, with the opposite heading.
    assert with_shortcuts.arrival_s[-1] == pytest.approx(math.pi, abs=0.2)


def square(side: int) -> ExperienceMap:
    """Drive ``side`` steps along each side of a square, and stop 0.3 m before the start."""
    graph = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    for corner in range(4):
        for n in range(side):
            step(graph, math.pi / 2 if n == 0 and corner else 0.0)
    graph.integrate(Motion(0.0, 0.0, math.pi / 2))
    graph.integrate(Motion(0.4, 0.2, 0.0))
    graph.apply(MapAction('create', graph.current_id, len(graph), len(graph), 0.0, NOWHERE))
    return graph


@pytest.mark.parametrize('side', [3, 20])
def test_shortcut_joins_ends_of_loop(side: int) -> None:
    graph = square(side)
    assert np.hypot(*(graph.poses[-1, :2] - graph.poses[0, :2])) == pytest.approx(0.3)
    planner = RoutePlanner(GoalRecallParameters(route_join_m=0.35), graph)
    assert planner.route_to(0).experience_ids == (len(graph) - 1, 0)


def test_shortcut_survives_unlearning_of_connecting_links(tmp_path: Path) -> None:
    """A drive along a corridor and back, which is later blocked before the turning point."""
    graph = there_and_back(7)
    last = len(graph) - 1
    while graph.unlearn_blocked('centreline', 0.0, Pose(2.9, 0.0, 0.0)) == 0:
        pass
    with pytest.raises(UnreachableGoal, match='no link leads'):
        RoutePlanner(GoalRecallParameters(), graph).temporal_map().route_to(0)
    loaded = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    loaded.restore(filed({'experience_map': graph.state()}, tmp_path)['experience_map'])
    for one in (graph, loaded):
        planner = RoutePlanner(GoalRecallParameters(route_join_m=0.35), one)
        assert planner.route_to(0).experience_ids == (last, 0)
    # The unlearned links of a removed experience are dropped, because its id is reused.
    turning_point = int(graph.poses[:, 0].argmax())
    assert turning_point in graph.unlearned_ends
    action = MapAction('create', last, turning_point, last + 1, 0.0, NOWHERE)
    graph.integrate(Motion(1.0, 0.5, 0.0))
    graph.apply(action)
    assert turning_point not in graph.unlearned_ends


def test_rejected_shortcut_stays_rejected() -> None:
    graph = there_and_back(7)
    planner = RoutePlanner(GoalRecallParameters(route_join_m=0.35), graph)
    last = len(graph) - 1
    assert planner.route_to(0).experience_ids == (last, 0)
    planner.rejected_shortcuts.add(last)
    assert len(planner.route_to(0).experience_ids) == len(graph)
    step(graph)  # also after the map has grown
    assert len(planner.route_to(0).experience_ids) == len(graph)
    another = RoutePlanner(planner.parameters, graph)
    assert another.route_to(0).experience_ids == (last + 1, last, 0)


def test_failed_try_on_shortcut_rejects_it() -> None:
    graph = there_and_back(7)
    for _ in range(2):
        step(graph)
    navigator = Navigator(GoalRecallParameters(route_join_m=0.35), graph)
    navigator.go_to(0)
    before = navigator.update(0)
    assert len(before.positions_m) < 5
    assert navigator.report_blocked()  # the map counts the failure as well
    assert navigator.planner.rejected_shortcuts
    after = navigator.update(1)
    assert after.status == 'following'
    assert len(after.positions_m) == len(graph)
    assert after.replanned == 2
