# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from floor_clearance import clearance_m

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_simulator.closed_loop import ClosedLoop
from ratslam_simulator.floor_plan import load_floor_plan, parse_floor_plan
from ratslam_simulator.shortest_paths import DrivenGraph, FloorGraph, FloorPath
from ratslam_simulator.simulation import SimulationOptions, Simulator
from ratslam_simulator.trials import Trial, attempt, choose_goals, reversals_of

ROOM = parse_floor_plan('\n'.join(['#' * 12, *['#..........#'] * 10, '#' * 12]), 0.5)
WALLED = parse_floor_plan(
    '\n'.join(['#' * 12, *['#....#.....#'] * 8, *['#..........#'] * 2, '#' * 12]), 0.5
)
RADIUS_M = 0.22
P = GoalFollowerParameters(speed_mps=0.5, braking_mps2=0.25, turn_rate_radps=1.0)


def path_through(*points):
    return FloorPath(np.array(points, np.float64))


@pytest.mark.parametrize('degrees', (0, 27, 45, 90))
def test_floor_path_across_room_is_nearly_straight(degrees):
    start = Pose(1.0, 1.0, 0.0)
    goal = 1.0 + 3.5 * math.cos(math.radians(degrees)), 1.0 + 3.5 * math.sin(math.radians(degrees))
    found = FloorGraph(ROOM.solid, ROOM.cell_m, RADIUS_M).shortest_path(start, goal)
    assert 3.5 - 1e-9 <= found.length_m <= 3.5 * 1.04
    assert found.positions_m[0].tolist() == [1.0, 1.0]
    assert tuple(found.positions_m[-1]) == goal


def test_floor_path_around_wall_keeps_body_radius():
    start, goal = Pose(1.0, 5.0, 0.0), (5.0, 5.0)
    found = FloorGraph(WALLED.solid, WALLED.cell_m, RADIUS_M).shortest_path(start, goal)
    assert 8.0 < found.length_m < 9.5
    assert min(clearance_m(WALLED, x, y) for x, y in found.positions_m) >= RADIUS_M - 1e-9


def test_floor_path_to_unreachable_goal_is_none():
    solid = WALLED.solid.copy()
    solid[:, 5] = True
    floor = FloorGraph(solid, WALLED.cell_m, RADIUS_M)
    assert floor.shortest_path(Pose(1.0, 5.0, 0.0), (5.0, 5.0)) is None
    assert floor.shortest_path(Pose(1.0, 5.0, 0.0), (50.0, 5.0)) is None
    no_room = FloorGraph(np.ones_like(solid), 0.5, RADIUS_M)
    assert no_room.shortest_path(Pose(1.0, 5.0, 0.0), (2.0, 5.0)) is None


def test_driven_path_uses_only_driven_free_places():
    t = np.linspace(0.0, 1.0, 200)[:, None]
    corners = np.array([[1.0, 5.0], [1.0, 1.0], [5.0, 1.0], [5.0, 5.0]])
    path = np.concatenate([a + t * (b - a) for a, b in pairwise(corners)])
    driven = DrivenGraph(path)
    assert len(driven.positions_m) < 150
    start = Pose(1.0, 5.0, 0.0)
    assert driven.shortest_path(start, (5.0, 5.0)).length_m == pytest.approx(12.0, abs=0.3)
    assert driven.shortest_path(start, (3.0, 5.0)) is None
    # Driving the path a second time, backwards, adds no shortcut.
    again = DrivenGraph(np.concatenate([path, path[::-1]]))
    assert again.shortest_path(start, (5.0, 5.0)).length_m == pytest.approx(12.0, abs=0.3)
    solid = ROOM.solid.copy()
    solid[1:4, 6] = True
    assert driven.without(solid, 0.5, RADIUS_M).shortest_path(start, (5.0, 5.0)) is None


def test_path_time_includes_turning_and_acceleration():
    straight = path_through((0.0, 0.0), (1.0, 0.0), (10.0, 0.0))
    assert straight.time_s(0.0, P) == pytest.approx(22.0)
    assert straight.time_s(math.pi, P) == pytest.approx(22.0 + math.pi)
    assert straight.time_s(-math.pi / 2, P) == pytest.approx(22.0 + math.pi / 2)
    assert path_through((0.0, 0.0), (0.25, 0.0)).time_s(0.0, P) == pytest.approx(2.0)
    short = path_through((0.0, 0.0), (1.0, 0.0)).time_s(0.0, P)
    assert short == pytest.approx(path_through((0.0, 0.0), (1.0 + 1e-9, 0.0)).time_s(0.0, P))


def test_trial_success_requires_outcome_distance_and_time():
    shortest = path_through((0.0, 0.0), (10.0, 0.0))
    trial = Trial('A', (10.0, 0.0), 'succeeded', 0.4, 11.0, 60.0, shortest, None, 22.0, math.inf,
                  np.zeros((1, 3)))
    assert trial.succeeded
    assert trial.ratio == pytest.approx(1.1)
    assert math.isnan(trial.floor_ratio)
    assert not replace(trial, error_m=0.51).succeeded
    assert not replace(trial, took_s=66.1).succeeded
    assert not replace(trial, outcome='timed_out').succeeded


def test_reversals_count_turns_to_the_other_side():
    assert reversals_of([0.0, 0.5, 0.5, 0.1, 0.5]) == 0
    assert reversals_of([0.5, -0.1, -0.5, 0.0, 0.4, 0.3]) == 2  # steadying is no turn
    assert reversals_of([]) == 0


def test_chosen_goals_are_distant_in_random_order():
    places = {f'{x}{y}': (float(x), float(y)) for x in range(9) for y in range(9)}
    orders = set()
    for seed in range(8):
        rng = np.random.default_rng(seed)
        chosen = choose_goals(places, Pose(0.0, 0.0, 0.0), 3, rng)
        assert set(chosen) == {'88', '08', '80'}
        orders.add(tuple(chosen))
    assert len(orders) > 2
    assert choose_goals({}, Pose(0.0, 0.0, 0.0), 3, rng) == []
    assert len(choose_goals({'A': (1.0, 1.0)}, Pose(0.0, 0.0, 0.0), 3, rng)) == 1


def test_attempt_unknown_goal_fails_as_refused():
    plan = load_floor_plan('obstacle_loop')
    x_m, y_m = plan.places['S']
    simulator = Simulator(plan, Pose(x_m, y_m, 0.0), 1, SimulationOptions(camera=None))
    loop = ClosedLoop(simulator, Config(), 1)
    loop.explore(5.0)
    trial = attempt(loop, 'G', plan.places['G'])
    assert trial.outcome == 'refused'
    assert not trial.succeeded
    assert trial.shortest is None
    gap_m = math.dist((simulator.truth.x_m, simulator.truth.y_m), plan.places['G'])
    assert trial.error_m == pytest.approx(gap_m)
    assert gap_m <= trial.floor.length_m < gap_m * 1.1
