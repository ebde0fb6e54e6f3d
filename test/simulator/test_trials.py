# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.simulator.closed_loop import ClosedLoop
from ratslam_ros.simulator.floor_plan import load_floor_plan, parse_floor_plan
from ratslam_ros.simulator.robot import Pose as TruePose
from ratslam_ros.simulator.simulation import SimulationOptions, Simulator
from ratslam_ros.simulator.trials import Driven, Floor, Trial, Way, attempt, choose_goals

ROOM = parse_floor_plan('\n'.join(['#' * 12, *['#..........#'] * 10, '#' * 12]), 0.5)
WALLED = parse_floor_plan(
    '\n'.join(['#' * 12, *['#....#.....#'] * 8, *['#..........#'] * 2, '#' * 12]), 0.5
)
RADIUS_M = 0.22
P = GoalFollowerParameters(speed_mps=0.5, braking_mps2=0.25, turn_rate_radps=1.0)


def way(*points):
    return Way(np.array(points, np.float64))


@pytest.mark.parametrize('degrees', range(0, 91, 9))
def test_the_way_across_a_room_is_as_long_as_a_straight_line(degrees):
    start = Pose(1.0, 1.0, 0.0)
    goal = 1.0 + 3.5 * math.cos(math.radians(degrees)), 1.0 + 3.5 * math.sin(math.radians(degrees))
    found = Floor(ROOM.solid, ROOM.cell_m, RADIUS_M).way(start, goal)
    assert 3.5 - 1e-9 <= found.length_m <= 3.5 * 1.04
    assert found.positions_m[0].tolist() == [1.0, 1.0]
    assert tuple(found.positions_m[-1]) == goal


def test_the_way_goes_round_walls_with_room_for_the_body():
    start, goal = Pose(1.0, 5.0, 0.0), (5.0, 5.0)
    found = Floor(WALLED.solid, WALLED.cell_m, RADIUS_M).way(start, goal)
    assert 8.0 < found.length_m < 9.5
    assert min(WALLED.clearance_m(x, y) for x, y in found.positions_m) >= RADIUS_M - 1e-9


def test_there_is_no_way_through_walls_or_off_the_plan():
    solid = WALLED.solid.copy()
    solid[:, 5] = True
    floor = Floor(solid, WALLED.cell_m, RADIUS_M)
    assert floor.way(Pose(1.0, 5.0, 0.0), (5.0, 5.0)) is None
    assert floor.way(Pose(1.0, 5.0, 0.0), (50.0, 5.0)) is None
    assert Floor(np.ones_like(solid), 0.5, RADIUS_M).way(Pose(1.0, 5.0, 0.0), (2.0, 5.0)) is None


def test_driven_ways_lead_only_where_the_robot_has_been_and_where_it_still_fits():
    t = np.linspace(0.0, 1.0, 200)[:, None]
    corners = np.array([[1.0, 5.0], [1.0, 1.0], [5.0, 1.0], [5.0, 5.0]])
    path = np.concatenate([a + t * (b - a) for a, b in pairwise(corners)])
    driven = Driven(path)
    assert len(driven.positions_m) < 150
    start = Pose(1.0, 5.0, 0.0)
    assert driven.way(start, (5.0, 5.0)).length_m == pytest.approx(12.0, abs=0.3)
    assert driven.way(start, (3.0, 5.0)) is None
    # Driving it twice, or to and fro, makes no other ways.
    again = Driven(np.concatenate([path, path[::-1]]))
    assert again.way(start, (5.0, 5.0)).length_m == pytest.approx(12.0, abs=0.3)
    solid = ROOM.solid.copy()
    solid[1:4, 6] = True
    assert driven.without(solid, 0.5, RADIUS_M).way(start, (5.0, 5.0)) is None


def test_the_shortest_time_counts_turning_starting_and_stopping():
    straight = way((0.0, 0.0), (1.0, 0.0), (10.0, 0.0))
    assert straight.time_s(0.0, P) == pytest.approx(22.0)
    assert straight.time_s(math.pi, P) == pytest.approx(22.0 + math.pi)
    assert straight.time_s(-math.pi / 2, P) == pytest.approx(22.0 + math.pi / 2)
    assert way((0.0, 0.0), (0.25, 0.0)).time_s(0.0, P) == pytest.approx(2.0)
    short = way((0.0, 0.0), (1.0, 0.0)).time_s(0.0, P)
    assert short == pytest.approx(way((0.0, 0.0), (1.0 + 1e-9, 0.0)).time_s(0.0, P))


def test_a_trial_has_succeeded_if_the_robot_says_so_and_it_is_true_and_in_time():
    shortest = way((0.0, 0.0), (10.0, 0.0))
    trial = Trial('A', (10.0, 0.0), 'succeeded', 0.4, 11.0, 60.0, shortest, None, 22.0, math.inf,
                  np.zeros((1, 3)))  # fmt: skip
    assert trial.succeeded
    assert trial.ratio == pytest.approx(1.1)
    assert math.isnan(trial.floor_ratio)
    assert not replace(trial, error_m=0.51).succeeded
    assert not replace(trial, took_s=66.1).succeeded
    assert not replace(trial, outcome='timed_out').succeeded


def test_chosen_goals_are_apart_and_their_order_is_drawn():
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


def test_a_goal_that_is_not_known_is_a_failed_trial():
    plan = load_floor_plan('obstacle_loop')
    x_m, y_m = plan.places['S']
    simulator = Simulator(plan, TruePose(x_m, y_m, 0.0), 1, SimulationOptions(camera=None))
    loop = ClosedLoop(simulator, Config(), 1)
    loop.explore(5.0)
    trial = attempt(loop, 'G', plan.places['G'])
    assert trial.outcome == 'refused'
    assert not trial.succeeded
    assert trial.shortest is None
    gap_m = math.dist((simulator.truth.x_m, simulator.truth.y_m), plan.places['G'])
    assert trial.error_m == pytest.approx(gap_m)
    assert gap_m <= trial.floor.length_m < gap_m * 1.1
