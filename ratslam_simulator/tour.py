# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A tour of a floor plan: the robot explores it, and then drives to goals on its map."""

from __future__ import annotations

import csv
import math
import operator
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ratslam_ros.errors import UnreachableGoal
from ratslam_ros.results.goal_plots import draw_temporal_map
from ratslam_simulator.closed_loop import ClosedLoop
from ratslam_simulator.floor_plan import FloorPlan
from ratslam_simulator.picture import draw_plan
from ratslam_simulator.trials import Trial, attempt, choose_goals

NAMING_DISTANCE_M = 1.0
"""Distance within which a place of the plan is named on the map."""

NAMING_SPEED_MPS = 0.3
"""Minimum commanded speed for naming: not while the robot turns on the spot."""

RANDOM_PLACE_PERIOD_S = 20.0
"""Time between the places that are candidates for random goals."""

LINE_OF_SIGHT_STEP_M = 0.1

DRAWN_GOAL_COUNT = 5
"""Number of goals whose paths are drawn on the floor; more cannot be distinguished."""

COLUMNS = (
    'goal', 'outcome', 'succeeded', 'error_m', 'driven_m', 'shortest_m', 'ratio', 'floor_ratio',
    'took_s', 'limit_s', 'tries_failed', 'links_unlearned', 'collisions',
)
"""Columns of trials.csv: attributes of a trial."""


class Tour:
    """Exploration, during which places are named, and the trials afterwards."""

    def __init__(
        self, loop: ClosedLoop, names: Sequence[str] | None, random_goals: int, progress: bool
    ) -> None:
        """Begin without a named place.

        Args:
            loop: the robot.
            names: places of the plan to drive to, in order; None for all that are named.
            random_goals: number of random goals among the visited places, in place of ``names``;
                0 for none.
            progress: show a progress bar.
        """
        self.loop = loop
        self._names, self._random_goals, self._progress = names, random_goals, progress
        self._plan = loop.simulator.plan
        self._named: dict[str, tuple[float, float]] = {}
        self._distance_m: dict[str, float] = {}
        self.explored_rows = 0
        """Number of rows of the log that belong to the exploration."""
        self.plots: list[Path] = []

    def explore(self, end_s: float) -> str:
        """Explore until a time and name places; return a report."""
        loop = self.loop
        name_place = self._name_periodically if self._random_goals else self._name_passed
        with self._progress_bar(end_s, 'exploring') as bar:

            def is_over() -> bool:
                bar.update(loop.now_s - bar.n)
                is_moving = loop.command.speed_mps >= NAMING_SPEED_MPS
                if is_moving and loop.experience_map.current_id >= 0:
                    name_place()
                return loop.now_s >= end_s

            loop.run(loop.exploring, is_over)
        self.explored_rows = len(loop.log.truth)
        return (
            f'explored for {end_s / 60.0:g} minutes: {loop.simulator.odometer_m:.0f} m, '
            f'{len(loop.experience_map)} experiences, {loop.experience_map.link_count} links, '
            f'{loop.simulator.collisions} collisions; '
            f'{len(self._named)} places are named'
        )

    def _name_passed(self) -> None:
        """Name the places of the plan that are nearer than ever before and in sight."""
        robot = self.loop.simulator.truth
        for name, (x_m, y_m) in self._plan.places.items():
            distance_m = math.hypot(x_m - robot.x_m, y_m - robot.y_m)
            is_nearer = distance_m < self._distance_m.get(name, NAMING_DISTANCE_M)
            if is_nearer and _in_sight(self._plan, (robot.x_m, robot.y_m), (x_m, y_m)):
                self._distance_m[name] = distance_m
                self._name(name)

    def _name_periodically(self) -> None:
        if self.loop.now_s >= RANDOM_PLACE_PERIOD_S * (len(self._named) + 1):
            self._name(f'place_{len(self._named) + 1}')

    def _name(self, name: str) -> None:
        robot = self.loop.simulator.truth
        self.loop.name_place(name)
        self._named[name] = robot.x_m, robot.y_m

    def goals(self, seed: int) -> list[str]:
        """Return the names of the goals, in order."""
        if self._random_goals:
            rng = np.random.Generator(np.random.PCG64(seed))
            robot = self.loop.simulator.truth
            return choose_goals(self._named, robot, self._random_goals, rng)
        return list(self._named if self._names is None else self._names)

    def attempt(self, name: str, folder: Path) -> Trial:
        """Drive to a goal, after drawing the travel times; an unnamed place is refused."""
        self._draw_times(name, folder)
        goal_m = self._named.get(name) or self._plan.places[name]
        with self._progress_bar(None, f'to {name}'):
            return attempt(self.loop, name, goal_m)

    def _draw_times(self, name: str, folder: Path) -> None:
        graph, navigator = self.loop.experience_map, self.loop.navigator
        try:
            goal = navigator.goals.find(name, navigator.planner, 0.0)
            times = navigator.planner.temporal_map()
            ids = times.route_to(goal.experience_id).experience_ids
        except UnreachableGoal:
            return
        file = folder / f'times_{len(self.plots) + 1}_{name}.png'
        self.plots.append(
            draw_temporal_map(graph, times, file, graph.poses[list(ids), :2], [goal])
        )

    def draw_floor(self, trials: Sequence[Trial], path: Path) -> Path:
        """Draw the true paths on the floor plan."""
        paths = {'exploring': self.loop.log.truths()[: self.explored_rows]}
        paths |= {f'to {trial.goal}': trial.path for trial in trials[:DRAWN_GOAL_COUNT]}
        title = f'{self._plan.name}: true paths of the robot'
        return draw_plan(self._plan, path, paths, title=title)

    def _progress_bar(
        self, total_s: float | None, label: str
    ) -> tqdm:  # type: ignore[type-arg]
        disable = None if self._progress else True  # None: only without a terminal
        layout = '{desc}: {percentage:3.0f}% |{bar}| {elapsed}' if total_s else '{desc} {elapsed}'
        return tqdm(total=total_s, desc=label, bar_format=layout, disable=disable, leave=False)


def _in_sight(plan: FloorPlan, from_m: tuple[float, float], to_m: tuple[float, float]) -> bool:
    count = max(math.ceil(math.dist(from_m, to_m) / LINE_OF_SIGHT_STEP_M), 1)
    points = np.linspace(from_m, to_m, count + 1).tolist()
    return not any(plan.is_solid(x_m, y_m) for x_m, y_m in points)


def write_table(trials: Sequence[Trial], path: Path) -> None:
    """Write the trials as a CSV file."""
    with path.open('w', encoding='utf-8', newline='') as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows(map(operator.attrgetter(*COLUMNS), trials))


def table(trials: Sequence[Trial]) -> list[str]:
    """Return the lines of a table of the trials, and how many succeeded."""
    if not trials:
        return ['no goals: no place was named during the exploration']
    lines = [
        f'{"goal":12} {"outcome":10} {"":3} {"error":>7} {"driven":>8} {"shortest":>9} '
        f'{"ratio":>6} {"floor":>6} {"time":>6} {"limit":>6}'
    ]
    for trial in trials:
        lines.append(
            f'{trial.goal:12} {trial.outcome:10} {"ok" if trial.succeeded else "-":3} '
            f'{trial.error_m:5.2f} m {trial.driven_m:6.1f} m {trial.shortest_m:7.1f} m '
            f'{trial.ratio:6.2f} {trial.floor_ratio:6.2f} {trial.took_s:4.0f} s '
            f'{trial.limit_s:4.0f} s'
        )
    done = [trial for trial in trials if trial.succeeded]
    ratios = [trial.ratio for trial in done if trial.shortest]
    mean = f'; ratio {np.mean(ratios):.2f} on average, {max(ratios):.2f} at most' if ratios else ''
    lines.append(f'{len(done)} of {len(trials)} goals reached{mean}')
    return lines
