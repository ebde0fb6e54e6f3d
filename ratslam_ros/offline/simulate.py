# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ratslam simulate: a robot explores a floor plan by itself, and goes to goals on its map."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ratslam_ros.core.config import Config
from ratslam_ros.core.ratslam import Step
from ratslam_ros.errors import UnreachableGoal, UnusableInput
from ratslam_ros.results.goal_plots import draw_temporal_map
from ratslam_ros.results.plots import draw_all
from ratslam_ros.results.writer import Results, tum_line
from ratslam_ros.simulator.closed_loop import ClosedLoop
from ratslam_ros.simulator.config import SimulatorParameters, make_simulator
from ratslam_ros.simulator.floor_plan import FloorPlan
from ratslam_ros.simulator.picture import draw_plan
from ratslam_ros.simulator.recording import TRUTH_FILE, RecordingWriter
from ratslam_ros.simulator.simulation import Simulator
from ratslam_ros.simulator.trials import Trial, attempt, choose_goals

BY_M = 1.0
"""A place of the plan is named where the robot passes it no further away than this."""

MOVING_MPS = 0.3
"""And only while it drives on: not on the spot, where it turns to look."""

CANDIDATES_S = 20.0
"""Places for random goals are named so often."""

SIGHT_M = 0.1

SHOWN = 5
"""The picture of the floor shows the ways to so many goals; more cannot be told apart."""

COLUMNS = (
    'goal', 'outcome', 'succeeded', 'error_m', 'driven_m', 'shortest_m', 'ratio', 'floor_ratio',
    'took_s', 'limit_s', 'tries_failed', 'links_unlearned', 'collisions',
)  # fmt: skip


@dataclass(frozen=True)
class SimulateOptions:
    """What the robot does: explore, and then go to goals.

    ``goals``: names of places of the plan, in order; None: all that it has passed.
    ``random_goals``: so many others instead, drawn by lot from where it has been.
    ``record``: a folder for a recording of all that it senses.
    """

    explore_s: float = 1800.0
    goals: Sequence[str] | None = None
    random_goals: int = 0
    record: Path | None = None
    progress: bool = True


def simulate(
    parameters: SimulatorParameters, config: Config, folder: Path, options: SimulateOptions
) -> str:
    """Run it, write results, pictures and `trials.csv`; return what to tell.

    Raises:
        UnusableInput: there is no such plan, start, obstacle or goal, or no place to write to.
        UnusableParameter: a value is out of range.
    """
    simulator = make_simulator(parameters)
    places = simulator.plan.places
    unknown = [name for name in options.goals or () if name not in places]
    if unknown:
        known = ', '.join(places) or 'none: give --random-goals'
        raise UnusableInput(
            f'there is no place {", ".join(unknown)} in the plan; its places are {known}'
        )
    with ExitStack() as stack:
        if options.record is not None:
            writer = stack.enter_context(RecordingWriter(options.record, simulator.options))
            simulator.watchers.append(writer.write)
        results = Results(folder)
        try:
            loop = _WrittenLoop(simulator, config, parameters.seed, results)
            run = _Run(loop, options)
            explored = run.explore()
            trials = [run.attempt(name, folder) for name in run.goals(parameters.seed)]
            loop.finish()
        except BaseException:
            results.discard()
            raise
    summary = {
        'frames': results.frames, 'odometry': results.odometry, 'templates': results.templates,
        'experiences': len(loop.experience_map), 'links': loop.experience_map.link_count,
        'loop_closures': results.loop_closures, 'duration_s': loop.now_s,
        'driven_m': simulator.odometer_m, 'collisions': simulator.collisions,
        'goals': len(trials), 'succeeded': sum(trial.succeeded for trial in trials),
        'simulator': {item.name: getattr(parameters, item.name) for item in fields(parameters)},
    }  # fmt: skip
    results.finish(loop.experience_map, config, summary)
    truth = folder / TRUTH_FILE
    truth.write_text(''.join(map(tum_line, loop.log.stamp_ns, loop.log.truth)), encoding='ascii')
    _write_table(trials, folder / 'trials.csv')
    pictures = [
        *run.pictures, _draw_floor(loop, run.explored_rows, trials, folder),
        *draw_all(folder, truth),
    ]  # fmt: skip
    return '\n'.join([explored, *_table(trials), *map(str, pictures)])


class _WrittenLoop(ClosedLoop):
    """A closed loop whose every step is written."""

    def __init__(self, simulator: Simulator, config: Config, seed: int, results: Results) -> None:
        super().__init__(simulator, config, seed)
        self._results = results

    def _note(self, steps: Iterable[Step]) -> None:
        steps = list(steps)
        for step in steps:
            self._results.add(step)
        super()._note(steps)

    def finish(self) -> None:
        """Process what still waits for the other stream."""
        self._note(self.ratslam.finish())


class _Run:
    """Explores, names places, and goes to them."""

    def __init__(self, loop: ClosedLoop, options: SimulateOptions) -> None:
        self.loop = loop
        self._options = options
        self._plan = loop.simulator.plan
        self._named: dict[str, tuple[float, float]] = {}
        self._by_m: dict[str, float] = {}
        self.explored_rows = 0
        self.pictures: list[Path] = []

    def explore(self) -> str:
        """Explore, and name what is passed; return what to tell."""
        loop, end_s = self.loop, self._options.explore_s
        name = self._name_now_and_then if self._options.random_goals else self._name_passed
        with self._bar(end_s, 'exploring') as bar:

            def over() -> bool:
                bar.update(loop.now_s - bar.n)
                if loop.command.speed_mps >= MOVING_MPS and loop.experience_map.current_id >= 0:
                    name()
                return loop.now_s >= end_s

            loop.run(loop.exploring, over)
        self.explored_rows = len(loop.log.truth)
        return (
            f'explored for {end_s / 60.0:g} minutes: {loop.simulator.odometer_m:.0f} m, '
            f'{len(loop.experience_map)} experiences, {loop.experience_map.link_count} links, '
            f'{loop.simulator.collisions} collisions; '
            f'{len(self._named)} places have names'
        )

    def _name_passed(self) -> None:
        """Give a place of the plan its name where the robot has come nearer to it than before."""
        at = self.loop.simulator.truth
        for name, (x_m, y_m) in self._plan.places.items():
            away_m = math.hypot(x_m - at.x_m, y_m - at.y_m)
            nearer = away_m < self._by_m.get(name, BY_M)
            if nearer and _in_sight(self._plan, (at.x_m, at.y_m), (x_m, y_m)):
                self._by_m[name] = away_m
                self._name(name)

    def _name_now_and_then(self) -> None:
        if self.loop.now_s >= CANDIDATES_S * (len(self._named) + 1):
            self._name(f'place_{len(self._named) + 1}')

    def _name(self, name: str) -> None:
        at = self.loop.simulator.truth
        self.loop.name_place(name)
        self._named[name] = at.x_m, at.y_m

    def goals(self, seed: int) -> list[str]:
        """Return where to go, in order."""
        options = self._options
        if options.random_goals:
            rng = np.random.Generator(np.random.PCG64(seed))
            robot = self.loop.simulator.truth
            return choose_goals(self._named, robot, options.random_goals, rng)
        return list(self._named if options.goals is None else options.goals)

    def attempt(self, name: str, folder: Path) -> Trial:
        """Go to a place, and draw what the map said before; it is refused if it has no name."""
        self._draw_times(name, folder)
        at_m = self._named.get(name) or self._plan.places[name]
        with self._bar(None, f'to {name}'):
            return attempt(self.loop, name, at_m)

    def _draw_times(self, name: str, folder: Path) -> None:
        graph, navigator = self.loop.experience_map, self.loop.navigator
        try:
            goal = navigator.goals.find(name, navigator.planner, 0.0)
            times = navigator.planner.temporal_map()
            ids = times.route_to(goal.experience_id).experience_ids
        except UnreachableGoal:
            return
        file = folder / f'times_{len(self.pictures) + 1}_{name}.png'
        self.pictures.append(
            draw_temporal_map(graph, times, file, graph.poses[list(ids), :2], [goal])
        )

    def _bar(self, total_s: float | None, what: str) -> tqdm:  # type: ignore[type-arg]
        shown = None if self._options.progress else True
        layout = '{desc}: {percentage:3.0f}% |{bar}| {elapsed}' if total_s else '{desc} {elapsed}'
        return tqdm(total=total_s, desc=what, bar_format=layout, disable=shown, leave=False)


def _in_sight(plan: FloorPlan, here_m: tuple[float, float], there_m: tuple[float, float]) -> bool:
    count = max(math.ceil(math.dist(here_m, there_m) / SIGHT_M), 1)
    points = np.linspace(here_m, there_m, count + 1).tolist()
    return not any(plan.is_solid(x_m, y_m) for x_m, y_m in points)


def _row(trial: Trial) -> tuple[object, ...]:
    shortest_m = trial.shortest.length_m if trial.shortest else math.nan
    return (
        trial.goal, trial.outcome, trial.succeeded, trial.error_m, trial.driven_m, shortest_m,
        trial.ratio, trial.floor_ratio, trial.took_s, trial.limit_s, trial.tries_failed,
        trial.links_unlearned, trial.collisions,
    )  # fmt: skip


def _write_table(trials: Sequence[Trial], path: Path) -> None:
    with path.open('w', encoding='utf-8', newline='') as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows(map(_row, trials))


def _table(trials: Sequence[Trial]) -> list[str]:
    if not trials:
        return ['no goals: none of the places that have names was passed']
    lines = [
        f'{"goal":12} {"outcome":10} {"":3} {"error":>7} {"driven":>8} {"shortest":>9} '
        f'{"ratio":>6} {"floor":>6} {"time":>6} {"limit":>6}'
    ]
    for trial in trials:
        shortest_m = trial.shortest.length_m if trial.shortest else math.nan
        lines.append(
            f'{trial.goal:12} {trial.outcome:10} {"ok" if trial.succeeded else "-":3} '
            f'{trial.error_m:5.2f} m {trial.driven_m:6.1f} m {shortest_m:7.1f} m '
            f'{trial.ratio:6.2f} {trial.floor_ratio:6.2f} {trial.took_s:4.0f} s '
            f'{trial.limit_s:4.0f} s'
        )
    done = [trial for trial in trials if trial.succeeded]
    ratios = [trial.ratio for trial in done if trial.shortest]
    mean = f'; ratio {np.mean(ratios):.2f} on average, {max(ratios):.2f} at most' if ratios else ''
    lines.append(f'{len(done)} of {len(trials)} goals reached{mean}')
    return lines


def _draw_floor(loop: ClosedLoop, explored: int, trials: Sequence[Trial], folder: Path) -> Path:
    ways = {'exploring': loop.log.truths()[:explored]}
    ways |= {f'to {trial.goal}': trial.path for trial in trials[:SHOWN]}
    plan = loop.simulator.plan
    title = f'{plan.name}: where the robot truly was'
    return draw_plan(plan, folder / 'floor.png', ways, title=title)
