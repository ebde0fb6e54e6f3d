# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exploration by the exits of known places."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.driving.steering import Command
from ratslam_ros.core.driving.untried_exits import EXIT_M, MAX_TRY_COUNT, UntriedExits
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.files.config import load_config
from ratslam_simulator.closed_loop import ClosedLoop
from ratslam_simulator.floor_plan import parse_floor_plan
from ratslam_simulator.simulation import Simulator

NOWHERE, AHEAD_DEG, RIGHT_DEG = Place(0.0, 0.0, 0.0), 0, -90
AT_PLACE = Pose(0.0, 0.0, 0.0)
LENGTH_M, DOORS_M = 14, (3, 5)

ROOM_INSIDE = parse_floor_plan("""
########################
#......................#
#S.....................#
#......................#
#...###############....#
#...#.............#....#
#...#.............#....#
#...#.............#....#
#...#.............#....#
#...#.............#....#
#...########..#####....#
#......................#
#......................#
#......................#
########################
""", 0.5)
"""A robot with the outer wall on its left never enters the room."""


class Corridor:
    """A robot that looks along x, has driven 14 m, and backs up; an experience at each metre.

    Doors on its right are at x = 3 m and x = 5 m, and the far end is closed.
    """

    def __init__(self) -> None:
        self.map = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
        planner = RoutePlanner(GoalRecallParameters(), self.map)
        self.exits = UntriedExits(GoalFollowerParameters(), planner)
        self.stamp_ns = 0
        for x_m in range(LENGTH_M + 1):
            assert self.arrive(x_m, 1.0 if x_m else 0.0) is None  # on new ground

    def arrive(self, x_m: int, way_m: float) -> Command | None:
        self.map.integrate(Motion(2.0 * abs(way_m), way_m, 0.0))
        kind = 'create' if x_m == len(self.map) else 'link'
        self.map.apply(MapAction(kind, self.map.current_id, x_m, x_m, 0.0, NOWHERE))
        return self.steer(
            *[AHEAD_DEG] * (x_m < LENGTH_M - 2), *[RIGHT_DEG] * (x_m in DOORS_M)
        )

    def steer(self, *open_deg: int) -> Command | None:
        """Return the command for a scan with a free sector in each of these directions."""
        self.stamp_ns += 2_000_000_000
        beams_deg = np.arange(-90, 91)
        is_open = [np.abs(beams_deg - deg) <= 30 for deg in open_deg]
        ranges_m = np.where(np.any(is_open, axis=0), 8.0, 1.0) * np.ones(len(beams_deg))
        scan = Scan(self.stamp_ns, -math.pi / 2, math.radians(1.0), ranges_m)
        return self.exits.command(scan, self.map.pose, AT_PLACE)

    def back_to(self, last_m: int) -> None:
        for x_m in range(round(self.map.pose.x_m) - 1, last_m - 1, -1):
            self.arrive(x_m, -1.0)


def test_nearest_exit_without_a_link_is_driven_to() -> None:
    made = Corridor()
    made.back_to(9)
    assert made.exits.goal is None  # these places are not old enough
    made.back_to(6)
    assert made.exits.goal == pytest.approx((5.0, -EXIT_M, -math.pi / 2))
    command = made.steer(AHEAD_DEG)
    assert command is not None and abs(command.ahead_rad) > math.pi / 2  # the door is behind


def test_exit_is_given_up_after_failed_tries() -> None:
    made = Corridor()
    made.back_to(6)
    made.exits._follower.command = (  # type: ignore[method-assign]
        lambda *_: Command(0.0, 0.0, 'straight', failed=True)
    )
    for _ in range(MAX_TRY_COUNT - 1):
        assert made.steer() is not None
    assert made.steer() is None and made.exits.goal is None
    made.back_to(4)
    assert made.exits.goal == pytest.approx((3.0, -EXIT_M, -math.pi / 2))


def test_exits_without_a_way_to_them_are_searched_for_every_ten_seconds() -> None:
    made = Corridor()
    asked = []
    made.exits._planner.temporal_map = (  # type: ignore[method-assign]
        lambda: asked.append(0) or SimpleNamespace(arrival_s=np.full(LENGTH_M + 1, np.inf))
    )
    made.back_to(6)
    for _ in range(10):
        assert made.steer(AHEAD_DEG) is None  # 2 s each
    assert len(asked) == 3


def test_exits_of_pruned_experience_are_forgotten() -> None:
    made = Corridor()
    made.exits.remove_pruned(5, 4, Pose(1.0, 0.0, 0.0))
    made.back_to(6)
    assert made.exits.goal == pytest.approx((3.0, -EXIT_M, -math.pi / 2))


def test_exits_of_an_experience_with_a_pruned_id_are_recorded() -> None:
    made = Corridor()
    last = made.map.current_id
    made.exits.remove_pruned(last, last - 1, Pose(1.0, 0.0, 0.0))
    made.steer(RIGHT_DEG)  # the id was given again
    assert made.exits._exits[-1].experience_id == last


def test_unknown_pose_follows_walls() -> None:
    made = Corridor()
    made.back_to(6)
    made.map.lose('for a test')
    assert made.steer(AHEAD_DEG) is None and made.exits.goal is None


def test_room_off_the_followed_wall_is_entered_by_exits() -> None:
    config = load_config('navigation')[0].with_values({'goal_follower.explore_by': 'exits'})
    start = Pose(*ROOM_INSIDE.places['S'], 0.0)
    loop = ClosedLoop(Simulator(ROOM_INSIDE, start, 1), config, exploring_seed=1)

    def is_inside() -> bool:
        return 2.5 < loop.simulator.truth.x_m < 9.0 and 2.8 < loop.simulator.truth.y_m < 5.0

    loop.run(loop.exploring, lambda: is_inside() or loop.now_s > 200.0)
    assert is_inside()
    assert loop.simulator.collisions == 0
