# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Experience maps for the tests of route planning, and reference solutions on them."""

from __future__ import annotations

import math

import numpy as np

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goal_tree import GoalTree
from ratslam_ros.core.navigation.route_graph import MIN_EDGE_S
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnreachableGoal

PARAMETERS = GoalRecallParameters(goal_tolerance_m=0.5)
BACK = 2.5
ONE_WAY = GoalRecallParameters(goal_tolerance_m=0.5, route_back_factor=BACK)
NEVER_BACK = GoalRecallParameters(goal_tolerance_m=0.5, route_back_factor=0.0)
NOWHERE = Place(0.0, 0.0, 0.0)


def go(
    graph: ExperienceMap, target: int, duration_s: float = 2.0, way_m: float = 1.0,
    linked: bool = True,
) -> None:
    """Drive from the current experience to a new or existing one."""
    graph.integrate(Motion(duration_s, way_m, 0.0))
    kind = 'create' if target == len(graph) else 'link'
    source = graph.current_id if linked else -1
    graph.apply(MapAction(kind, source, target, target, 0.0, NOWHERE))


def line(count: int, seconds: float = 2.0) -> ExperienceMap:
    """Return a map with linked experiences at x = 1, 2, ... m and the robot at the last one."""
    graph = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    for target in range(count):
        go(graph, target, seconds)
    return graph


def planner_of(
    graph: ExperienceMap, parameters: GoalRecallParameters = PARAMETERS
) -> RoutePlanner:
    return RoutePlanner(parameters, graph)


def wander(graph: ExperienceMap, rng: np.random.Generator, islands: bool = False) -> None:
    """Apply a random action. Some durations are below the minimum, and some links are loops."""
    new = len(graph) == 0 or rng.uniform() < 0.3
    target = len(graph) if new else int(rng.integers(0, len(graph)))
    if islands and rng.uniform() < 0.3:
        graph.integrate(Motion(1.0, 1.0, 0.0))
        graph.apply(MapAction('create' if new else 'set', -1, target, target, 0.0, NOWHERE))
        return
    go(graph, target, float(rng.choice([0.0, rng.uniform(0.5, 9.0)], p=[0.1, 0.9])))


def link_times(graph: ExperienceMap, back: float = 1.0) -> dict[tuple[int, int], float]:
    """Return the duration of the fastest link for each pair of linked experiences in s."""
    times: dict[tuple[int, int], float] = {}
    for link in graph.links():
        a, b, seconds = link.source_id, link.target_id, max(link.duration_s, MIN_EDGE_S)
        for ends, duration_s in (((a, b), seconds), ((b, a), back * seconds)):
            if duration_s < math.inf:
                times[ends] = min(duration_s, times.get(ends, math.inf))
    return times


def times_to(graph: ExperienceMap, goal: int, back: float = 1.0) -> list[float]:
    """Return the cost-to-go of all experiences in s, by the Bellman-Ford algorithm."""
    best = [math.inf] * len(graph)
    best[goal] = 0.0
    links = link_times(graph, back)
    for _ in range(len(graph)):
        for (a, b), seconds in links.items():
            best[a] = min(best[a], best[b] + seconds)
    return best


def remaining_s(tree: GoalTree, start_id: int | None = None) -> float:
    """Return the cost-to-go in s, infinite if no route leads to the goal."""
    try:
        return tree.route(start_id).arrival_s[-1]
    except UnreachableGoal:
        return math.inf


def is_exact(tree: GoalTree) -> bool:
    """Return whether all routes are the fastest ones over the current links."""
    remaining_s(tree)
    return not tree._stale
