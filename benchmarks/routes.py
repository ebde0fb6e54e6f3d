# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a route costs on a large map, and what following it costs an action.

    python benchmarks/routes.py

The C++ figures are OpenRatSLAM's core, compiled -O3, one thread, on a machine of the same kind.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.route_planner import GoalTree, RoutePlanner
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place

REPEATS = 100
ACTIONS = 500
NEXT = 10
"""Experiences of the way ahead that a robot asks for at every action."""

CPP_MS = {6_000: 29.0, 50_000: 2_678.0}
NOWHERE = Place(0.0, 0.0, 0.0)


def go(graph: ExperienceMap, target: int, rng: np.random.Generator) -> None:
    """Drive about 1 m from the current experience to another, new or known."""
    graph.integrate(Motion(rng.uniform(0.5, 2.0), 1.0, rng.normal(0.0, 0.2)))
    kind = 'create' if target == len(graph) else 'link'
    graph.apply(MapAction(kind, graph.current_id, target, target, 0.0, NOWHERE))


def older(graph: ExperienceMap, rng: np.random.Generator) -> int:
    """Return an experience a few hundred older than the newest."""
    return max(0, len(graph) - 1 - int(rng.integers(200, 500)))


def make_map(count: int, revisits: float = 0.1) -> ExperienceMap:
    """Drive new ways; after this share of the experiences the robot is back at an older one."""
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
    """Return the times of routes from the newest experience to goals anywhere, warm."""
    rng = np.random.default_rng(0)
    graph = make_map(count, revisits)
    recall = RoutePlanner(GoalRecallParameters())
    recall.route_to(graph, 0)
    goals = rng.integers(0, count, repeats).tolist()
    return [call_ms(lambda goal=goal: recall.route_to(graph, goal)) for goal in goals]


def first_route_ms(count: int) -> float:
    """Return the time of a route to the oldest experience right after a link has changed."""
    rng = np.random.default_rng(0)
    graph = make_map(count)
    recall = RoutePlanner(GoalRecallParameters())
    recall.route_to(graph, 0)
    go(graph, older(graph, rng), rng)
    return call_ms(lambda: recall.route_to(graph, 0))


def replan_ms(count: int, actions: int) -> list[float]:
    """Return what each action costs a robot that asks for the time left and the way ahead."""
    graph = make_map(count)
    tree = GoalTree(RoutePlanner(GoalRecallParameters()), graph, 0)
    tree.route()
    return _driving_ms(graph, actions, lambda: (tree.remaining_s(), tree.route(most=NEXT)))


def follow_ms(count: int, actions: int) -> list[float]:
    """Return what each action costs with the whole route to a place, as the node sends it."""
    graph = make_map(count)
    recall = RoutePlanner(GoalRecallParameters())
    x_m, y_m, _ = graph.poses[0].tolist()
    recall.follow(graph, x_m, y_m)
    return _driving_ms(graph, actions, lambda: recall.follow(graph, x_m, y_m))


def _driving_ms(graph: ExperienceMap, actions: int, ask: Callable[[], object]) -> list[float]:
    """Drive along known links to the next experience; one action in ten makes a new one.

    From there a link leads back to an older one. Every action changes a link.
    """
    rng = np.random.default_rng(1)
    times_ms = []
    for action in range(actions):
        on = min(graph.current_id + 1, len(graph) - 1)
        go(graph, {3: len(graph), 4: older(graph, rng)}.get(action % 10, on), rng)
        times_ms.append(call_ms(ask))
    return times_ms


def main() -> None:
    print(f'{REPEATS} routes, {ACTIONS} actions; ms')
    print('experiences   C++ -O3   median route   after a change   along one chain   '
          'time and way ahead, an action (worst)   whole route, an action (worst)')  # fmt: skip
    for count, cpp_ms in CPP_MS.items():
        route = statistics.median(route_ms(count, REPEATS))
        chain = statistics.median(route_ms(count, REPEATS, revisits=0.0))
        ahead, whole = replan_ms(count, ACTIONS), follow_ms(count, ACTIONS)
        print(f'{count:11,}   {cpp_ms:7,.0f}   {route:12.2f}   {first_route_ms(count):14.2f}   '
              f'{chain:15.2f}   {statistics.mean(ahead):29.3f} {max(ahead):7.2f}   '
              f'{statistics.mean(whole):22.3f} {max(whole):7.2f}')  # fmt: skip


if __name__ == '__main__':
    main()
