# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exploration on small floors, by a robot whose laser, wheels and odometry have no faults."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.exploration import Exploration
from ratslam_ros.core.driving.steering import Command
from ratslam_ros.simulator.floor_plan import FloorPlan, parse_floor_plan
from ratslam_ros.simulator.laser import LaserOptions
from ratslam_ros.simulator.robot import Pose as Start
from ratslam_ros.simulator.robot import RobotOptions
from ratslam_ros.simulator.samples import ScanSample
from ratslam_ros.simulator.simulation import SimulationOptions, Simulator

LASER = LaserOptions(noise_m=0.0)
FAULTLESS = SimulationOptions(
    camera=None, laser=LASER,
    robot=RobotOptions(wheel_radius_error=0.0, wheel_base_error=0.0, slip_m=0.0),
)  # fmt: skip
NEVER = 1e6
P = GoalFollowerParameters(look_back_every_m=NEVER)

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
""", 0.5)  # fmt: skip
"""A corridor of 1.5 m along the south, and a room behind a door of 1 m from x = 3 m."""

PILLAR = parse_floor_plan('\n'.join([
    '#' * 26, *['#' + '.' * 24 + '#'] * 10, *['#' + '.' * 11 + '##' + '.' * 11 + '#'] * 2,
    *['#' + '.' * 24 + '#'] * 10, '#' * 26,
]), 0.5)  # fmt: skip
"""A hall of 12 x 11 m with a pillar of 1 m in the middle, around (6.5, 6)."""

CORRIDOR = parse_floor_plan('\n'.join(['#' * 42, *['#' + '.' * 40 + '#'] * 3, '#' * 42]), 0.5)
"""20 x 1.5 m, from (0.5, 0.5)."""


@dataclass
class Run:
    """What became of a robot that explored: at each scan."""

    poses: list[Pose]
    commands: list[Command]
    collisions: int

    def positions(self) -> np.ndarray:
        return np.array(self.poses)[:, :2]

    def comes_to(self, x_m: float, y_m: float, within_m: float) -> bool:
        return bool(np.hypot(*(self.positions() - (x_m, y_m)).T).min() < within_m)

    def behaviours(self) -> list[str]:
        """The behaviours one after the other."""
        return [name for name, _ in itertools.groupby(c.behaviour for c in self.commands)]


def explore(
    plan: FloorPlan, start: Start, duration_s: float, p: GoalFollowerParameters = P, seed: int = 0
) -> Run:
    exploration = Exploration(p, np.random.default_rng(seed))
    simulator = Simulator(plan, start, 0, FAULTLESS)
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


def test_the_wall_to_the_left_is_followed_round_a_room() -> None:
    run = explore(ROOM, Start(3.5, 3.0, 0.0), 70.0)
    assert run.collisions == 0
    for corner in ((0.5, 0.5), (6.5, 0.5), (6.5, 5.5), (0.5, 5.5)):
        assert run.comes_to(*corner, 1.9)
    x, y = run.positions()[250:].T
    wall_m = np.minimum(np.minimum(x - 0.5, 6.5 - x), np.minimum(y - 0.5, 5.5 - y))
    assert np.median(wall_m) == pytest.approx(P.wall_distance_most_m, abs=0.15)
    assert wall_m.max() < 1.5
    headings = np.unwrap([pose.heading_rad for pose in run.poses[250:]])
    assert headings[-1] - headings[0] < -math.tau  # with it on the left: clockwise


def test_a_door_to_the_left_is_entered_and_left_again() -> None:
    run = explore(DOOR, Start(*DOOR.places['S'], 0.0), 70.0)
    assert run.collisions == 0
    inside = run.positions()[:, 1] > 2.7
    assert inside.any()
    assert run.comes_to(*DOOR.places['R'], 1.9)
    assert run.positions()[~inside & (np.arange(len(inside)) > inside.argmax()), 0].max() > 8.0


def turns(run: Run) -> list[tuple[Pose, Pose, float]]:
    """Return where the robot was before and after each turn on the spot, and by how much."""
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


def test_it_turns_back_looks_and_goes_on() -> None:
    p = GoalFollowerParameters(
        look_back_every_m=3.0, look_back_turn_deg=NEVER, look_back_m=0.6
    )
    run = explore(CORRIDOR, Start(1.5, 1.25, 0.0), 60.0, p)
    assert run.collisions == 0
    assert run.behaviours()[:9] == [
        'left_wall', 'turn', 'right_wall', 'turn', 'left_wall', 'turn', 'right_wall', 'turn',
        'left_wall',
    ]  # fmt: skip
    first_back, first_again, second_back, second_again = turns(run)[:4]
    for before, _, turned_rad in (first_back, second_back):
        assert turned_rad == pytest.approx(-math.pi, abs=0.4)  # away from the wall
        assert abs(before.heading_rad) < 0.2
    for before, after, turned_rad in (first_again, second_again):
        assert turned_rad == pytest.approx(math.pi, abs=0.4)  # and back the same way
        assert abs(math.remainder(before.heading_rad - math.pi, math.tau)) < 0.4
        assert abs(after.heading_rad) < 0.4
    back_m = math.dist(first_back[1][:2], first_again[0][:2])
    assert back_m == pytest.approx(p.look_back_m, abs=0.15)
    # It looks from where it went by, and has come on by then.
    gone_m = second_back[0].x_m - first_back[0].x_m
    assert gone_m == pytest.approx(p.look_back_every_m, abs=0.5)


def test_having_turned_it_looks_back_sooner() -> None:
    p = GoalFollowerParameters(
        look_back_every_m=8.0, look_back_turn_deg=60.0, look_back_m=0.6
    )
    round_the_corner = explore(ROOM, Start(4.0, 4.9, 0.0), 14.0, p)
    along = explore(CORRIDOR, Start(1.5, 1.25, 0.0), 14.0, p)
    assert 'right_wall' in round_the_corner.behaviours()
    assert along.behaviours() == ['left_wall']


def test_after_a_time_it_goes_on_along_the_wall_across_and_then_back_along_that() -> None:
    p = GoalFollowerParameters(
        look_back_every_m=4.0, look_back_turn_deg=NEVER, look_back_m=0.6, change_wall_every_s=1.0
    )
    run = explore(CORRIDOR, Start(8.0, 1.25, 0.0), 28.0, p)
    assert run.collisions == 0
    assert run.behaviours() == ['left_wall', 'turn', 'left_wall', 'turn', 'right_wall']
    (there, _, _), (back, _, _) = turns(run)
    assert there.x_m == pytest.approx(12.0, abs=0.5)
    assert back.x_m == pytest.approx(there.x_m - p.look_back_every_m, abs=0.8)
    last = run.poses[-1]
    assert abs(last.heading_rad) < 0.3
    for pose in (there, back, last):  # in the middle, whichever wall it follows
        assert pose.y_m == pytest.approx(1.25, abs=0.15)


def test_an_island_is_left() -> None:
    run = explore(PILLAR, Start(6.5, 4.9, 0.0), 110.0)
    assert run.collisions == 0
    away_m = np.hypot(*(run.positions() - (6.5, 6.0)).T)
    headings = np.unwrap([pose.heading_rad for pose in run.poses])
    left = int(np.argmax(away_m > 2.5))
    assert left > 0
    assert headings[:left].max() - headings[0] > math.tau  # once round it, and no more than twice
    assert headings[:left].max() - headings[0] < 2 * math.tau
    x, y = run.positions()[-1]
    assert min(x - 0.5, 12.5 - x, y - 0.5, 11.5 - y) < 1.4  # by the wall of the hall


TABLE = parse_floor_plan("""
##################
#..........#.....#
#..........#.....#
#..........#.....#
#...##...........#
#...##...........#
#...##...........#
#..........#.....#
#..........#.....#
#..........#.....#
##################
""", 0.5)  # fmt: skip
"""A room of 5 x 4.5 m with a table in it: between table and walls there is one lane."""


def test_a_room_with_a_table_in_it_is_left() -> None:
    run = explore(TABLE, Start(2.5, 1.6, 0.0), 90.0)  # with the table on its left
    assert run.collisions == 0
    assert run.positions()[:, 0].max() > 6.5


@pytest.mark.parametrize('width', [2, 3])
def test_it_gets_out_of_a_dead_end(width: int) -> None:
    rows = ['#' + '.' * 12 + '#' * 9] * (5 - width) + ['#' + '.' * 20 + '#'] * width
    plan = parse_floor_plan('\n'.join(['#' * 22, *rows, '#' * 22]), 0.5)
    run = explore(plan, Start(9.9, 0.5 + width / 4, 0.0), 40.0)
    assert run.collisions == 0
    assert run.positions()[:, 0].min() < 5.0


def test_where_no_wall_is_near_it_goes_on_to_one() -> None:
    run = explore(PILLAR, Start(3.5, 3.5, 0.3), 60.0)
    assert run.collisions == 0
    x, y = run.positions()[-1]
    to_hall_m = min(x - 0.5, 12.5 - x, y - 0.5, 11.5 - y)
    assert min(to_hall_m, math.hypot(x - 6.5, y - 6.0) - 0.5) < 1.4


def test_what_it_does_hangs_on_the_draws_alone() -> None:
    p = GoalFollowerParameters(look_back_every_m=0.5, look_back_m=0.1, change_wall_every_s=20.0)
    first, again, other = (
        explore(ROOM, Start(3.5, 3.0, 0.0), 60.0, p, seed) for seed in (1, 1, 2)
    )
    assert first.commands == again.commands
    assert first.commands != other.commands


def test_after_a_restart_nothing_before_counts() -> None:
    p = GoalFollowerParameters(look_back_every_m=3.0)
    scan = Scan(0, LASER.first_rad, LASER.step_rad, np.full(181, np.inf))
    exploration = Exploration(p, np.random.default_rng(0))
    for x_m in (0.0, 2.9):
        assert exploration.command(scan, Pose(x_m, 0.0, 0.0)).behaviour != 'turn'
    exploration.restart()
    for x_m in (50.0, 52.9):  # it has been moved: the way there is none that it drove
        assert exploration.command(scan, Pose(x_m, 0.0, 0.0)).behaviour != 'turn'
    assert exploration.command(scan, Pose(53.1, 0.0, 0.0)).behaviour == 'turn'
