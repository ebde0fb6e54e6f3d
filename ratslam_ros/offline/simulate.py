# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam simulate``: a robot explores a floor plan and then drives to goals on its map."""

from __future__ import annotations

import csv
import math
import operator
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ratslam_ros.core.config import AUTOMATIC, Config
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.errors import UnreachableGoal, UnusableInput
from ratslam_ros.files.config import to_yaml
from ratslam_ros.history.file import HISTORY_NAME, HistoryMeta
from ratslam_ros.history.recorder import Recorder
from ratslam_ros.history.writer import HistoryWriter
from ratslam_ros.images import Frame
from ratslam_ros.pipeline.items import Step
from ratslam_ros.results.goal_plots import draw_temporal_map
from ratslam_ros.results.plots import draw_all
from ratslam_ros.results.trajectory import tum_line
from ratslam_ros.results.writer import Results
from ratslam_ros.version import __version__
from ratslam_simulator.closed_loop import ClosedLoop, scan_from_sample
from ratslam_simulator.config import SimulatorParameters, make_simulator
from ratslam_simulator.floor_plan import FloorPlan
from ratslam_simulator.picture import draw_plan
from ratslam_simulator.recording import TRUTH_FILE, RecordingWriter
from ratslam_simulator.samples import ImageSample, Sample, ScanSample
from ratslam_simulator.simulation import Simulator
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


@dataclass(frozen=True)
class SimulateOptions:
    """Duration of the exploration, goals after it, and outputs.

    explore_s: duration of the exploration. goals: names of places of the plan, in order; None
    for all that were named. random_goals: number of random goals among the visited places, in
    place of `goals`; 0 for none. record: folder for a recording of all sensor data, None for
    none. progress: show a progress bar. history: write history.sqlite.
    """

    explore_s: float = 1800.0
    goals: Sequence[str] | None = None
    random_goals: int = 0
    record: Path | None = None
    progress: bool = True
    history: bool = False


def simulate(
    parameters: SimulatorParameters, config: Config, folder: Path, options: SimulateOptions
) -> str:
    """Simulate exploration and goals; write results, plots and `trials.csv`.

    Args:
        parameters: the simulated robot and its world.
        config: parameters of RatSLAM and of the navigation.
        folder: folder for the results.
        options: see `SimulateOptions`.

    Returns:
        A report of the exploration, a table of the goals, and the paths of the plots.

    Raises:
        UnusableInput: plan, start, obstacles or goals are invalid, or a file cannot be written.
        UnusableParameter: a value is out of range.
    """
    simulator = make_simulator(parameters)
    places = simulator.plan.places
    unknown = [name for name in options.goals or () if name not in places]
    if unknown:
        names = ', '.join(places) or 'none: give --random-goals'
        raise UnusableInput(
            f'the plan has no place {", ".join(unknown)}; its places are {names}'
        )
    with ExitStack() as stack:
        if options.record is not None:
            writer = stack.enter_context(RecordingWriter(options.record, simulator.options))
            simulator.watchers.append(writer.write)
        results = Results(
            folder, with_thresholds=config.local_view.vt_match_threshold == AUTOMATIC
        )
        loop = _RecordingLoop(simulator, config, parameters.seed, results)
        try:
            if options.history:
                loop.record(folder / HISTORY_NAME)
            run = _Run(loop, options)
            explored = run.explore()
            trials = [run.attempt(name, folder) for name in run.goals(parameters.seed)]
            loop.finish()
        except BaseException:
            results.discard()
            loop.discard()
            raise
    summary = {
        **results.summary(loop.experience_map), 'duration_s': loop.now_s,
        'driven_m': simulator.odometer_m, 'collisions': simulator.collisions,
        'goals': len(trials), 'succeeded': sum(trial.succeeded for trial in trials),
        'simulator': {item.name: getattr(parameters, item.name) for item in fields(parameters)},
    }
    results.finish(loop.experience_map, config, summary)
    truth = folder / TRUTH_FILE
    truth.write_text(''.join(map(tum_line, loop.log.stamp_ns, loop.log.truth)), encoding='ascii')
    _write_table(trials, folder / 'trials.csv')
    plots = [
        *run.plots, _draw_floor(loop, run.explored_rows, trials, folder),
        *draw_all(folder, truth),
    ]
    return '\n'.join([explored, *_table(trials), *map(str, plots)])


class _RecordingLoop(ClosedLoop):
    """Closed loop that writes the result of every step."""

    def __init__(self, simulator: Simulator, config: Config, seed: int, results: Results) -> None:
        super().__init__(simulator, config, seed)
        self._results = results
        self._recorder: Recorder | None = None

    def record(self, path: Path) -> None:
        """Write a history from now on."""
        meta = HistoryMeta(path.absolute().parent.name, __version__, to_yaml(self.config))
        self._recorder = Recorder(self.ratslam, lambda: HistoryWriter(path, meta))
        self.simulator.watchers.append(self._watch)

    def _watch(self, sample: Sample) -> None:
        assert self._recorder is not None
        if isinstance(sample, ImageSample):
            self._recorder.add_image(
                sample.stamp_ns, Frame(sample.image, 'mono8'), PreparedImage(sample.image)
            )
        elif isinstance(sample, ScanSample) and sample.laser == 0:  # one scan is shown
            self._recorder.add_scan(scan_from_sample(sample, self.simulator))

    def _note(self, steps: Iterable[Step]) -> None:
        steps = list(steps)
        for step in steps:
            self._results.add(step)
            if self._recorder is not None:
                self._recorder.add(step)
        super()._note(steps)

    def finish(self) -> None:
        """Process all held messages, and complete the history."""
        self._note(self.ratslam.finish())
        if self._recorder is not None:
            self._recorder.close()

    def discard(self) -> None:
        """Remove the history of a simulation that has failed."""
        if self._recorder is not None:
            self._recorder.discard()


class _Run:
    """Exploration, during which places are named, and the trials afterwards."""

    def __init__(self, loop: ClosedLoop, options: SimulateOptions) -> None:
        self.loop = loop
        self._options = options
        self._plan = loop.simulator.plan
        self._named: dict[str, tuple[float, float]] = {}
        self._distance_m: dict[str, float] = {}
        self.explored_rows = 0
        """Number of rows of the log that belong to the exploration."""
        self.plots: list[Path] = []

    def explore(self) -> str:
        """Explore and name places; return a report."""
        loop, end_s = self.loop, self._options.explore_s
        name_place = self._name_periodically if self._options.random_goals else self._name_passed
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
        options = self._options
        if options.random_goals:
            rng = np.random.Generator(np.random.PCG64(seed))
            robot = self.loop.simulator.truth
            return choose_goals(self._named, robot, options.random_goals, rng)
        return list(self._named if options.goals is None else options.goals)

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

    def _progress_bar(
        self, total_s: float | None, label: str
    ) -> tqdm:  # type: ignore[type-arg]
        disable = None if self._options.progress else True  # None: only without a terminal
        layout = '{desc}: {percentage:3.0f}% |{bar}| {elapsed}' if total_s else '{desc} {elapsed}'
        return tqdm(total=total_s, desc=label, bar_format=layout, disable=disable, leave=False)


def _in_sight(plan: FloorPlan, from_m: tuple[float, float], to_m: tuple[float, float]) -> bool:
    count = max(math.ceil(math.dist(from_m, to_m) / LINE_OF_SIGHT_STEP_M), 1)
    points = np.linspace(from_m, to_m, count + 1).tolist()
    return not any(plan.is_solid(x_m, y_m) for x_m, y_m in points)


def _write_table(trials: Sequence[Trial], path: Path) -> None:
    with path.open('w', encoding='utf-8', newline='') as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows(map(operator.attrgetter(*COLUMNS), trials))


def _table(trials: Sequence[Trial]) -> list[str]:
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


def _draw_floor(loop: ClosedLoop, explored: int, trials: Sequence[Trial], folder: Path) -> Path:
    paths = {'exploring': loop.log.truths()[:explored]}
    paths |= {f'to {trial.goal}': trial.path for trial in trials[:DRAWN_GOAL_COUNT]}
    plan = loop.simulator.plan
    title = f'{plan.name}: true paths of the robot'
    return draw_plan(plan, folder / 'floor.png', paths, title=title)
