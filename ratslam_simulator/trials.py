# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trials: send a robot to a goal, and judge the result by its true pose."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnreachableGoal
from ratslam_simulator.closed_loop import ClosedLoop
from ratslam_simulator.shortest_paths import DrivenGraph, FloorGraph, FloorPath

SUCCESS_M = 0.5
"""Largest true distance from the goal at the end of a successful trial."""

TURNING_RADPS = 0.2
"""Turn rate from which on a command turns the robot, as opposed to steadying its direction."""

TIME_LIMIT_RATIO = 3.0
"""Time limit of a trial relative to the shortest time."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Result of a trial.

    goal, at_m: name and true position of the goal
    outcome: status of the goal task, 'refused' if the goal is unreachable on the map, or
        'given up' at the time limit
    error_m: true distance from the goal at the end
    driven_m, took_s: true path length and time of the trial
    shortest: the shortest path over places where the robot has been, or None
    floor: the shortest path over the floor, or None
    shortest_s: shortest time for `shortest`, or for `floor` if there is none; sets the limit
    floor_s: shortest time for `floor`, inf if there is none
    path: (n, 3) true poses
    tries_failed, links_unlearned, collisions: counts during the trial, see `ClosedLoop`
    reversals: number of changes of sign of the commanded turn rate, see `reversals_of`
    succeeded: whether the robot reported success within the time limit, near the goal
    """

    goal: str
    at_m: tuple[float, float]
    outcome: str
    error_m: float
    driven_m: float
    took_s: float
    shortest: FloorPath | None
    floor: FloorPath | None
    shortest_s: float
    floor_s: float
    path: NDArray[np.float64] = field(repr=False)
    tries_failed: int = 0
    links_unlearned: int = 0
    collisions: int = 0
    reversals: int = 0
    succeeded: bool = field(init=False)

    def __post_init__(self) -> None:
        in_time = self.is_claimed and self.took_s <= self.limit_s
        object.__setattr__(self, 'succeeded', in_time and self.error_m <= SUCCESS_M)

    @property
    def is_claimed(self) -> bool:
        """Whether the robot reported that it has arrived, near the goal or not."""
        return self.outcome == 'succeeded'

    @property
    def limit_s(self) -> float:
        """Time limit, in seconds."""
        return TIME_LIMIT_RATIO * self.shortest_s

    @property
    def shortest_m(self) -> float:
        """Length of `shortest`, NaN if there is none."""
        return self.shortest.length_m if self.shortest else math.nan

    @property
    def ratio(self) -> float:
        """Length driven relative to `shortest`, NaN if there is none."""
        return self.driven_m / self.shortest_m

    @property
    def floor_ratio(self) -> float:
        """Length driven relative to `floor`, NaN if there is none."""
        return self.driven_m / self.floor.length_m if self.floor else math.nan


def attempt(loop: ClosedLoop, goal: str, at_m: tuple[float, float]) -> Trial:
    """Send the robot to a named goal, and judge the result.

    The time limit follows from the shortest path over all places where the robot has been and
    which are not blocked now, or over the floor if there is none. Without any path, the trial
    ends at the navigator's own time limit.

    Args:
        loop: the robot.
        goal: name of the goal.
        at_m: true position of the goal.
    """
    simulator, p = loop.simulator, loop.config.goal_follower
    world, radius_m = simulator.world, simulator.options.robot.body_radius_m
    start = simulator.truth
    blocked = world.solid, simulator.plan.cell_m, radius_m
    floor = FloorGraph(*blocked).shortest_path(start, at_m)
    shortest = DrivenGraph(loop.log.truths()).without(*blocked).shortest_path(start, at_m)
    floor_s = math.inf if floor is None else floor.time_s(start.heading_rad, p)
    shortest_s = floor_s if shortest is None else shortest.time_s(start.heading_rad, p)
    began_s, odometer_m, first = loop.now_s, simulator.odometer_m, len(loop.log.truth)
    before = loop.tries_failed, loop.links_unlearned, simulator.collisions
    end_s = began_s + TIME_LIMIT_RATIO * shortest_s
    turn_rates_radps: list[float] = []

    def until() -> bool:
        turn_rates_radps.append(loop.command.turn_rate_radps)
        return loop.now_s > end_s

    try:
        [task] = loop.go_to(goal, until=until)
        # The loop cancels the task at the time limit.
        outcome = 'given up' if task.status == 'cancelled' else task.status
    except UnreachableGoal:
        outcome = 'refused'
    failed, unlearned, collisions = before
    truth = simulator.truth
    path = np.array([start, *loop.log.truth[first:]], np.float64)
    return Trial(
        goal, at_m, outcome, math.hypot(truth.x_m - at_m[0], truth.y_m - at_m[1]),
        simulator.odometer_m - odometer_m, loop.now_s - began_s, shortest, floor, shortest_s,
        floor_s, path, loop.tries_failed - failed, loop.links_unlearned - unlearned,
        simulator.collisions - collisions, reversals_of(turn_rates_radps),
    )


def reversals_of(turn_rates_radps: Sequence[float]) -> int:
    """Return how often turns to one side follow turns to the other: many if a robot oscillates."""
    turns = [rate > 0.0 for rate in turn_rates_radps if abs(rate) >= TURNING_RADPS]
    return sum(before != after for before, after in itertools.pairwise(turns))


def choose_goals(
    places: Mapping[str, tuple[float, float]], robot: Pose, count: int, rng: np.random.Generator
) -> list[str]:
    """Choose goals that are far from each other and from the robot, in random order.

    Args:
        places: name -> x_m, y_m of the candidates.
        robot: true pose of the robot.
        count: number of goals, at most that of the candidates.
        rng: generator of the order.

    Returns:
        The names of the goals: farthest-point sampling, starting from the robot.
    """
    names = list(places)
    positions_m = np.array([places[name] for name in names], np.float64).reshape(-1, 2)
    away_m = np.hypot(positions_m[:, 0] - robot.x_m, positions_m[:, 1] - robot.y_m)
    chosen: list[int] = []
    for _ in range(min(count, len(names))):
        at = int(np.argmax(away_m))
        chosen.append(at)
        away_m = np.minimum(away_m, np.hypot(*(positions_m - positions_m[at]).T))
    return [names[at] for at in rng.permutation(chosen).tolist()]
