# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exploration of small floor plans with an ideal laser, drive and odometry."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.exploration import Exploration, LookBacks
from ratslam_ros.core.driving.free_directions import WALL_DISTANCE_MOST_M
from ratslam_ros.core.driving.steering import Command
from ratslam_simulator.floor_plan import FloorPlan, parse_floor_plan
from ratslam_simulator.laser import LaserOptions
from ratslam_simulator.robot import Pose as Start
from ratslam_simulator.robot import RobotOptions
from ratslam_simulator.samples import ScanSample
from ratslam_simulator.simulation import SimulationOptions, Simulator

LASER = LaserOptions(noise_m=0.0)
IDEAL = SimulationOptions(
    camera=None, laser=LASER,
    robot=RobotOptions(wheel_radius_error=0.0, wheel_base_error=0.0, slip_m=0.0),
)
NEVER = 1e6
P = GoalFollowerParameters()
NEVER_BACK = LookBacks(every_m=NEVER)

ROOM = parse_floor_plan('\n'.join(['#' * 14, *['#............#'] * 10, '#' * 14]), 0.5)
"""6 x 5 m, from (0.5, 0.5)."""

DOOR = parse_floor_plan("""
######################
#........#...........#
#........#...........#
#....R...#...........#
#........#...........#
#........#...........#
######..##############
#....................#
#S...................#
#....................#
######################
""", 0.5)
"""A corridor 1.5 m wide in the south, and a room behind a door 1 m wide at x = 3 m."""

PILLAR = parse_floor_plan('\n'.join([
    '#' * 26, *['#' + '.' * 24 + '#'] * 10, *['#' + '.' * 11 + '##' + '.' * 11 + '#'] * 2,
    *['#' + '.' * 24 + '#'] * 10, '#' * 26,
]), 0.5)
"""A hall of 12 x 11 m with a pillar of 1 m side at (6.5, 6)."""

CORRIDOR = parse_floor_plan('\n'.join(['#' * 42, *['#' + '.' * 40 + '#'] * 3, '#' * 42]), 0.5)
"""20 x 1.5 m, from (0.5, 0.5)."""


@dataclass
class Run:
    """Poses and commands of an exploration at each scan."""

    poses: list[Pose]
    commands: list[Command]
    collisions: int

    def positions(self) -> np.ndarray:
        return np.array(self.poses)[:, :2]

    def passes_near(self, x_m: float, y_m: float, within_m: float) -> bool:
        return bool(np.hypot(*(self.positions() - (x_m, y_m)).T).min() < within_m)

    def behaviours(self) -> list[str]:
        """Return the sequence of behaviours without repetitions."""
        return [name for name, _ in itertools.groupby(c.behaviour for c in self.commands)]


def explore(
    plan: FloorPlan, start: Start, duration_s: float, looks: LookBacks = NEVER_BACK, seed: int = 0
) -> Run:
    exploration = Exploration(P, np.random.default_rng(seed), looks)
    simulator = Simulator(plan, start, 0, IDEAL)
    run = Run([], [], 0)
    while simulator.elapsed_s < duration_s:
        for sample in simulator.step():
            if isinstance(sample, ScanSample):
                ranges_m = sample.ranges_m.astype(np.float64)
                scan = Scan(sample.stamp_ns, LASER.first_rad, LASER.step_rad, ranges_m)
                truth = sample.truth
                pose = Pose(truth.x_m, truth.y_m, truth.heading_rad)
                command = exploration.command(scan, pose)
                simulator.command(command.speed_mps, command.turn_rate_radps)
                run.poses.append(pose)
                run.commands.append(command)
    run.collisions = simulator.collisions
    return run


def test_left_wall_is_followed_round_room() -> None:
    run = explore(ROOM, Start(3.5, 3.0, 0.0), 70.0)
    assert run.collisions == 0
    for corner in ((0.5, 0.5), (6.5, 0.5), (6.5, 5.5), (0.5, 5.5)):
        assert run.passes_near(*corner, 1.9)
    x, y = run.positions()[250:].T
    wall_m = np.minimum(np.minimum(x - 0.5, 6.5 - x), np.minimum(y - 0.5, 5.5 - y))
    assert np.median(wall_m) == pytest.approx(WALL_DISTANCE_MOST_M, abs=0.15)
    assert wall_m.max() < 1.5
    headings = np.unwrap([pose.heading_rad for pose in run.poses[250:]])
    assert headings[-1] - headings[0] < -math.tau  # clockwise


def test_door_on_left_is_entered_and_left() -> None:
    run = explore(DOOR, Start(*DOOR.places['S'], 0.0), 70.0)
    assert run.collisions == 0
    inside = run.positions()[:, 1] > 2.7
    assert inside.any()
    assert run.passes_near(*DOOR.places['R'], 1.9)
    assert run.positions()[~inside & (np.arange(len(inside)) > inside.argmax()), 0].max() > 8.0


def turns(run: Run) -> list[tuple[Pose, Pose, float]]:
    """Return the poses before and after each turn on the spot, and its angle in rad."""
    found = []
    at = 0
    for name, group in itertools.groupby(command.behaviour for command in run.commands):
        count = len(list(group))
        if name == 'turn':
            headings = np.unwrap([pose.heading_rad for pose in run.poses[at : at + count + 1]])
            end = min(at + count, len(run.poses) - 1)
            found.append((run.poses[at], run.poses[end], float(headings[-1] - headings[0])))
        at += count
    return found


def test_look_back_turns_returns_and_continues() -> None:
    looks = LookBacks(every_m=3.0, turn_deg=NEVER, back_m=0.6)
    run = explore(CORRIDOR, Start(1.5, 1.25, 0.0), 60.0, looks)
    assert run.collisions == 0
    assert run.behaviours()[:9] == [
        'left_wall', 'turn', 'right_wall', 'turn', 'left_wall', 'turn', 'right_wall', 'turn',
        'left_wall',
    ]
    first_back, first_again, second_back, second_again = turns(run)[:4]
    for before, _, turned_rad in (first_back, second_back):
        assert turned_rad == pytest.approx(-math.pi, abs=0.4)  # away from the wall
        assert abs(before.heading_rad) < 0.2
    for before, after, turned_rad in (first_again, second_again):
        assert turned_rad == pytest.approx(math.pi, abs=0.4)  # back towards the wall
        assert abs(math.remainder(before.heading_rad - math.pi, math.tau)) < 0.4
        assert abs(after.heading_rad) < 0.4
    back_m = math.dist(first_back[1][:2], first_again[0][:2])
    assert back_m == pytest.approx(looks.back_m, abs=0.15)
    advance_m = second_back[0].x_m - first_back[0].x_m
    assert advance_m == pytest.approx(looks.every_m, abs=0.5)


def test_look_back_after_large_turn_is_earlier() -> None:
    looks = LookBacks(every_m=8.0, turn_deg=60.0, back_m=0.6)
    corner = explore(ROOM, Start(4.0, 4.9, 0.0), 14.0, looks)
    along = explore(CORRIDOR, Start(1.5, 1.25, 0.0), 14.0, looks)
    assert 'right_wall' in corner.behaviours()
    assert along.behaviours() == ['left_wall']


def test_wall_change_crosses_first_and_then_reverses() -> None:
    looks = LookBacks(every_m=4.0, turn_deg=NEVER, back_m=0.6, change_wall_every_s=1.0)
    run = explore(CORRIDOR, Start(8.0, 1.25, 0.0), 28.0, looks)
    assert run.collisions == 0
    assert run.behaviours() == ['left_wall', 'turn', 'left_wall', 'turn', 'right_wall']
    (first, _, _), (second, _, _) = turns(run)
    assert first.x_m == pytest.approx(12.0, abs=0.5)
    assert second.x_m == pytest.approx(first.x_m - looks.every_m, abs=0.8)
    last = run.poses[-1]
    assert abs(last.heading_rad) < 0.3
    for pose in (first, second, last):  # in the middle for either wall
        assert pose.y_m == pytest.approx(1.25, abs=0.15)


def test_island_is_left_after_one_round() -> None:
    run = explore(PILLAR, Start(6.5, 4.9, 0.0), 110.0)
    assert run.collisions == 0
    away_m = np.hypot(*(run.positions() - (6.5, 6.0)).T)
    headings = np.unwrap([pose.heading_rad for pose in run.poses])
    left = int(np.argmax(away_m > 2.5))
    assert left > 0
    assert headings[:left].max() - headings[0] > math.tau  # one to two rounds
    assert headings[:left].max() - headings[0] < 2 * math.tau
    x, y = run.positions()[-1]
    assert min(x - 0.5, 12.5 - x, y - 0.5, 11.5 - y) < 1.4  # at the wall of the hall


@pytest.mark.parametrize('width', [2, 3])
def test_dead_end_is_left(width: int) -> None:
    rows = ['#' + '.' * 12 + '#' * 9] * (5 - width) + ['#' + '.' * 20 + '#'] * width
    plan = parse_floor_plan('\n'.join(['#' * 22, *rows, '#' * 22]), 0.5)
    run = explore(plan, Start(9.9, 0.5 + width / 4, 0.0), 40.0)
    assert run.collisions == 0
    assert run.positions()[:, 0].min() < 5.0


def test_robot_without_near_wall_drives_to_one() -> None:
    run = explore(PILLAR, Start(3.5, 3.5, 0.3), 60.0)
    assert run.collisions == 0
    x, y = run.positions()[-1]
    to_hall_m = min(x - 0.5, 12.5 - x, y - 0.5, 11.5 - y)
    assert min(to_hall_m, math.hypot(x - 6.5, y - 6.0) - 0.5) < 1.4


def test_equal_seeds_give_equal_commands() -> None:
    looks = LookBacks(every_m=0.5, back_m=0.1, change_wall_every_s=5.0)
    first, again, other = (
        explore(ROOM, Start(3.5, 3.0, 0.0), 40.0, looks, seed) for seed in (1, 1, 2)
    )
    assert first.commands == again.commands
    assert first.commands != other.commands


def test_restart_resets_driven_distance() -> None:
    scan = Scan(0, LASER.first_rad, LASER.step_rad, np.full(181, np.inf))
    exploration = Exploration(P, np.random.default_rng(0), LookBacks(every_m=3.0))
    for x_m in (0.0, 2.9):
        assert exploration.command(scan, Pose(x_m, 0.0, 0.0)).behaviour != 'turn'
    exploration.restart()
    for x_m in (50.0, 52.9):  # moved by other commands
        assert exploration.command(scan, Pose(x_m, 0.0, 0.0)).behaviour != 'turn'
    assert exploration.command(scan, Pose(53.1, 0.0, 0.0)).behaviour == 'turn'
