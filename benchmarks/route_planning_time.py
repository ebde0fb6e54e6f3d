# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Time route planning on a large map, and re-planning while the robot drives.

    python benchmarks/route_planning_time.py

The C++ times are those of the OpenRatSLAM core: -O3, one thread, comparable machine.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goal_tree import GoalTree
from ratslam_ros.core.navigation.navigator import Navigator
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place

ROUTE_COUNT = 100
ACTION_COUNT = 500

CPP_MS = {6_000: 29.0, 50_000: 2_678.0}
"""Planning times of OpenRatSLAM by number of experiences, in ms."""

NOWHERE = Place(0.0, 0.0, 0.0)


def go(graph: ExperienceMap, target: int, rng: np.random.Generator) -> None:
    """Drive about 1 m from the current experience to a new or existing one."""
    graph.integrate(Motion(rng.uniform(0.5, 2.0), 1.0, rng.normal(0.0, 0.2)))
    kind = 'create' if target == len(graph) else 'link'
    graph.apply(MapAction(kind, graph.current_id, target, target, 0.0, NOWHERE))


def older(graph: ExperienceMap, rng: np.random.Generator) -> int:
    """Return an experience that is 200 to 500 older than the newest."""
    return max(0, len(graph) - 1 - int(rng.integers(200, 500)))


def make_map(count: int, revisits: float = 0.1) -> ExperienceMap:
    """Return a map of new paths with a loop closure after a ratio ``revisits`` of experiences."""
    rng = np.random.default_rng(count)
    graph = ExperienceMap(ExperienceMapParameters(exp_loops=0))
    while len(graph) < count:
        go(graph, len(graph), rng)
        if len(graph) < count and rng.uniform() < revisits:
            go(graph, older(graph, rng), rng)
    return graph


def call_ms(step: Callable[[], object]) -> float:
    start_s = time.perf_counter()
    step()
    return (time.perf_counter() - start_s) * 1e3


def route_ms(count: int, repeats: int, revisits: float = 0.1) -> list[float]:
    """Return the planning times from the newest experience to random goals, in ms, warm."""
    rng = np.random.default_rng(0)
    graph = make_map(count, revisits)
    planner = RoutePlanner(GoalRecallParameters(), graph)
    planner.route_to(0)
    goals = rng.integers(0, count, repeats).tolist()
    return [call_ms(lambda goal=goal: planner.route_to(goal)) for goal in goals]


def first_route_ms(count: int) -> float:
    """Return the planning time to the oldest experience just after a link changed, in ms."""
    rng = np.random.default_rng(0)
    graph = make_map(count)
    planner = RoutePlanner(GoalRecallParameters(), graph)
    planner.route_to(0)
    go(graph, older(graph, rng), rng)
    return call_ms(lambda: planner.route_to(0))


def replan_ms(count: int, actions: int) -> list[float]:
    """Return the times in ms of reading the whole route from the goal tree after each action."""
    graph = make_map(count)
    tree = GoalTree(RoutePlanner(GoalRecallParameters(), graph), 0)
    tree.route()
    return _driving_ms(graph, actions, lambda _: tree.route())


def update_ms(count: int, actions: int) -> list[float]:
    """Return the times in ms of the navigator's update after each action, as in the node."""
    graph = make_map(count)
    navigator = Navigator(GoalRecallParameters(), graph)
    navigator.go_to(0, timeout_s=0.0)
    navigator.update(0)
    return _driving_ms(graph, actions, lambda second: navigator.update(second * 10**9))


def _driving_ms(
    graph: ExperienceMap, actions: int, timed: Callable[[int], object]
) -> list[float]:
    """Time a call after each action of a drive along existing links.

    One action in ten creates an experience, and the next one links it to an older experience.
    Every action changes a link.
    """
    rng = np.random.default_rng(1)
    times_ms = []
    for action in range(actions):
        following = min(graph.current_id + 1, len(graph) - 1)
        go(graph, {3: len(graph), 4: older(graph, rng)}.get(action % 10, following), rng)
        times_ms.append(call_ms(lambda second=action + 1: timed(second)))
    return times_ms


def main() -> None:
    print(f'{ROUTE_COUNT} routes, {ACTION_COUNT} actions; ms')
    print('experiences   C++ -O3   median route   after a change   along one chain   '
          'route from the goal tree, mean (worst)   navigator update, mean (worst)')
    for count, cpp_ms in CPP_MS.items():
        route = statistics.median(route_ms(count, ROUTE_COUNT))
        chain = statistics.median(route_ms(count, ROUTE_COUNT, revisits=0.0))
        tree, update = replan_ms(count, ACTION_COUNT), update_ms(count, ACTION_COUNT)
        print(f'{count:11,}   {cpp_ms:7,.0f}   {route:12.2f}   {first_route_ms(count):14.2f}   '
              f'{chain:15.2f}   {statistics.mean(tree):29.3f} {max(tree):8.2f}   '
              f'{statistics.mean(update):21.3f} {max(update):8.2f}')


if __name__ == '__main__':
    main()
