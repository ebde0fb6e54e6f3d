# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two routes to a goal on the pose cells, of equal length: the faster one is planned.

Milford et al. (2005), section V.D and figure 9: at point B their robot has the choice of two
routes of similar length, and takes the one that it had driven faster. Here odometry alone drives a
square ring of pose cells, half of it at half the speed, and the goal is the opposite corner. Then
the robot drives some way on the planned route, which is reported as blocked there, as announced in
section VI, until the other one is planned.

    python benchmarks/two_routes.py [--config milford2005]
"""

from __future__ import annotations

import argparse
import math
from typing import NamedTuple

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.driving.goal_follower import TRY_TIMEOUT_S
from ratslam_ros.core.goal_memory.goal_memory import GoalMemory
from ratslam_ros.core.goal_memory.goal_routes import GoalRoutes
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.files.config import load_config

SIDE_M = 5.0
"""Side of the ring: half of it is 10 m long."""

FAST_MPS = 0.3
"""Speed on the fast half of the ring; on the other one it is half of that."""

DT_S = 0.1
"""Time between odometry messages: that of an iteration in the paper."""

TO_BARRIER_M = 2.0
"""Distance driven on the planned route before it is blocked."""

MAX_TRIES = 50
"""Failed tries after which the other route counts as never planned."""


class Routes(NamedTuple):
    """Result: the planned route, its time, and the failed tries until the other one is planned.

    ``tries_count`` is 0 if it never is.
    """

    takes_fast: bool
    fast_s: float
    tries_count: int


def two_routes_run(preset: str, is_first_slow: bool) -> Routes:
    """Drive round the ring, and plan a route to the opposite corner.

    Args:
        preset: name of the preset of pose cells and goal memory.
        is_first_slow: whether the half that is driven first is the slow one.
    """
    config = load_config(preset)[0].with_values({
        'pose_cells.pc_dim_x': 140, 'pose_cells.pc_dim_y': 80,
    })
    cells = PoseCells(config.pose_cells)
    is_published = config.goal_memory.goal_memory_update == 'iteration'
    memory = GoalMemory(config.pose_cells) if is_published else GoalRoutes(config.pose_cells)

    def move(distance_m: float, turn_rad: float) -> None:
        motion = Motion(DT_S, distance_m, turn_rad)
        cells.integrate(motion)
        memory.integrate(motion, cells)

    def ahead(distance_m: float, speed_mps: float) -> None:
        steps = round(distance_m / speed_mps / DT_S)
        for _ in range(steps):
            move(distance_m / steps, 0.0)

    def turn_left() -> None:
        for _ in range(10):
            move(0.0, math.pi / 20.0)

    corners = []
    for side in range(4):
        is_slow = (side < 2) == is_first_slow
        ahead(SIDE_M, FAST_MPS * (0.5 if is_slow else 1.0))
        corners.append(cells.peak)
        turn_left()
    first, goal, second, _ = corners
    slow, fast = (first, second) if is_first_slow else (second, first)
    times = memory.recall(goal)
    fast_s = memory.remaining_s(times, cells.peak)
    takes_fast = leads_by(memory, goal, cells.peak, fast, slow)
    if not isinstance(memory, GoalRoutes):
        return Routes(takes_fast, fast_s, 0)  # blocked ways are not described
    if takes_fast == is_first_slow:  # the planned route is the end of the ring, to the left
        turn_left()
    ahead(TO_BARRIER_M, FAST_MPS)
    tries = 0
    while tries < MAX_TRIES and takes_fast == leads_by(memory, goal, cells.peak, fast, slow):
        tries += 1
        bearing_rad = memory.bearing(memory.recall(goal), cells.peak)
        assert bearing_rad is not None
        memory.blocked(cells.peak, bearing_rad, tries * TRY_TIMEOUT_S)
    return Routes(takes_fast, fast_s, tries % MAX_TRIES)


def leads_by(memory: GoalMemory, goal: Place, peak: Place, a: Place, b: Place) -> bool:
    """Return whether the direction to the goal is closer to that of one place than of another."""
    towards = memory.direction(memory.recall(goal), peak)
    assert towards is not None

    def ahead(place: Place) -> float:
        return math.cos(math.atan2(place.y - peak.y, place.x - peak.x) - towards)

    return ahead(a) > ahead(b)


def main() -> None:
    """Print the planned routes."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').partition('\n')[0])
    parser.add_argument('--config', default='milford2005', help='preset or file of parameters')
    options = parser.parse_args()
    for is_first_slow in (False, True):
        routes = two_routes_run(options.config, is_first_slow)
        tries = routes.tries_count
        print(
            f'{"second" if is_first_slow else "first"} half fast: '
            f'{"fast" if routes.takes_fast else "slow"} route, {routes.fast_s:.0f} s'
            + (f'; the other one after {tries} failed tries' if tries else '')
        )


if __name__ == '__main__':
    main()
