# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Navigation experiments in simulation: goals, an obstacle, goal memory, loop closure and more.

    python benchmarks/navigation.py goals [--seeds 10] [--first 1] [--noise 1] [--plan NAME]
    python benchmarks/navigation.py obstacle | people_in_the_way | goal_memory | loop | pruning
    python benchmarks/navigation.py alignment | closures
    python benchmarks/navigation.py kidnapped | kidnapped_goals | undisturbed [--relocate both]
    python benchmarks/navigation.py goals --config milford2006 --camera-rate 7
    python benchmarks/navigation.py goals --sensors camera
    python benchmarks/navigation.py exploration [--seeds 4]

Each experiment prints a table with one row per seed, means and worst values, and draws its
pictures into --out. Controllers use image, scan and odometry only; trials are judged by the true
pose. One seed runs per core.
"""

from __future__ import annotations

import argparse
import itertools
import math
import os
import statistics
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import yaml
from goal_memory_plots import draw_occupancy, draw_temporal_array
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from tqdm import tqdm

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config.parameter import Value
from ratslam_ros.core.driving.exploration import LookBacks
from ratslam_ros.core.driving.goal_follower import TRY_TIMEOUT_S
from ratslam_ros.core.driving.goal_queue import route_towards
from ratslam_ros.core.driving.steering import Command
from ratslam_ros.core.goal_memory.goal_routes import GoalRoutes
from ratslam_ros.core.mapping.optimiser import EQUAL_WEIGHTS
from ratslam_ros.core.mapping.relaxation import relax
from ratslam_ros.core.mapping.sonar_grid import SonarGrid
from ratslam_ros.core.navigation.route_following import RECOVERY_M
from ratslam_ros.core.navigation.route_planner import RoutePlanner, TemporalMap
from ratslam_ros.core.pose_cells.torus import Torus
from ratslam_ros.errors import UnreachableGoal, UnusableInput
from ratslam_ros.files.config import load_config
from ratslam_ros.results.evaluation import figures, fit
from ratslam_ros.results.goal_plots import draw_temporal_map
from ratslam_ros.results.plots import new_figure, save_figure
from ratslam_simulator.closed_loop import ClosedLoop
from ratslam_simulator.config import SimulatorParameters, make_simulator
from ratslam_simulator.people import Walk
from ratslam_simulator.picture import draw_plan
from ratslam_simulator.samples import ImageSample, Sample, SonarSample
from ratslam_simulator.shortest_paths import DrivenGraph
from ratslam_simulator.trials import SUCCESS_M, Trial, attempt, choose_goals
from ratslam_simulator.world import PERSON_RADIUS_M

Job = TypeVar('Job')
Row = TypeVar('Row')

SIZES = ((100, 40), (40, 20))
"""Pose cells along x and y in the goals experiment."""

PRESETS = {'laser': 'navigation', 'camera': 'camera_navigation'}
"""Sensors that map and localise the robot, and the presets for them. Robots without a laser on
their map still avoid obstacles with it while they explore and drive."""

GOALS_COUNT = 6
"""Goals per run of the goals experiment."""

RING_LENGTH_M, ONWARD_M = 122.0, 50.0
"""Length of the ring of corridors, and distance that the robot drives beyond it."""

NAMING_INTERVAL_S = 20.0
"""Smallest time between two places that are named during exploration."""

CELLS: dict[str, dict[str, Value]] = {
    'large': {'pose_cells__pc_dim_x': 140, 'pose_cells__pc_dim_y': 80},
    'small': {'pose_cells__pc_dim_x': 40, 'pose_cells__pc_dim_y': 20},
}
"""Pose cells in the goal memory experiment."""


LOOK_BACKS_2006 = LookBacks(every_m=120.0, change_wall_every_s=1.0)
"""Milford et al. (2006) do not look back: "currently the robot cannot reactively turn around
mid-corridor" (section VI). They do not say how it explores. Here it follows walls, and turns round
after every 120 m, or 60 m with turns, to drive on in the other direction."""

RELOCATE = 'views', 'both'
"""Values of exp_relocate that the kidnapped experiment compares."""

FOLDER = Path(__file__).parent / 'floors'
FLOORS = tuple(str(FOLDER / f'{name}.txt') for name in ('hall', 'house', 'school'))
PLANS = 'university_floor', 'obstacle_loop', *FLOORS
"""Floor plans beside this file, and those that the robot explores in other experiments."""

CARRIES_COUNT, CARRY_OFFSET_M = 5, 0.5
"""Number of times that a robot is carried, and distance of the place from its path."""

RIGHT_M, MAX_LOST_S, SETTLING_S = 1.0, 180.0, 5.0
"""Distance within which a place is right, time after which a carried robot has failed to recover,
and time for which it explores after it has recovered."""


@dataclass(frozen=True)
class Setting:
    """Options that all experiments share."""

    plan: str
    noise: float
    people: int
    out: Path
    minutes: float
    values: tuple[str, ...] = ()
    relocate: tuple[str, ...] = RELOCATE
    config: str = PRESETS['laser']
    camera_rate_hz: int = SimulatorParameters.camera_rate_hz
    looks_back: bool = False
    has_sonars: bool = True

    def loop(
        self, seed: int, plan: str = '', look_backs: LookBacks = LookBacks(), **values: Value
    ) -> ClosedLoop:
        """Return a robot at its start.

        ``look_backs``: when it turns back, unless the preset is that of 2006, which does not look
        back. ``values``: parameters, written as section__name. The robot of 2005 steers by sonars,
        unless ``has_sonars`` is False.
        """
        if self.config.startswith('milford2006') and not self.looks_back:
            look_backs = LOOK_BACKS_2006
        changes = {name.replace('__', '.'): value for name, value in values.items()}
        for text in self.values:
            name, _, value = text.partition('=')
            changes[name] = yaml.safe_load(value)
        simulator = make_simulator(
            SimulatorParameters(
                plan=self.plan or plan, seed=seed, noise=self.noise, people=self.people,
                camera_rate_hz=self.camera_rate_hz,
                sonars=self.has_sonars and self.config == 'milford2005',
            )
        )
        config = load_config(self.config)[0].with_values(changes)
        return ClosedLoop(simulator, config, seed, look_backs)

    def explore_s(self, minutes: float) -> float:
        """Return the exploration time: that of the experiment unless --minutes overrides it."""
        return 60.0 * (self.minutes or minutes)


def explore_and_name(
    loop: ClosedLoop, duration_s: float, on_named: Callable[[str], None] = lambda _: None
) -> dict[str, tuple[float, float]]:
    """Explore, and name the robot's place at intervals; return the true positions of the places.

    A place is named while the robot drives straight on, like the operator of Milford et al.
    (2005), section IV, who presses a key. ``on_named`` is called with every new name.
    """
    places: dict[str, tuple[float, float]] = {}
    end_s, next_s = loop.now_s + duration_s, loop.now_s + NAMING_INTERVAL_S

    def until() -> bool:
        nonlocal next_s
        if loop.now_s >= next_s and drives(loop):
            next_s = loop.now_s + NAMING_INTERVAL_S
            name = f'p{len(places)}'
            loop.name_place(name)
            on_named(name)
            places[name] = loop.simulator.truth.x_m, loop.simulator.truth.y_m
        return loop.now_s >= end_s

    loop.exploration.restart()
    loop.run(loop.exploring, until)
    return places


def drives(loop: ClosedLoop) -> bool:
    """Return whether the robot moves forward, as opposed to turning or standing."""
    return loop.command.speed_mps > 0.5 * loop.config.goal_follower.speed_mps


def map_error_m(loop: ClosedLoop, poses: NDArray[np.float64] | None = None) -> float:
    """Return the RMSE of the experiences' positions after rigid alignment with the truth.

    ``poses``: (n, 3) poses of all experiences instead of those of the map.
    """
    ids = sorted(loop.log.truth_of)
    truth_m = np.array([loop.log.truth_of[i][:2] for i in ids])
    positions_m = (loop.experience_map.poses if poses is None else poses)[ids, :2]
    aligned_m = fit(positions_m, truth_m).apply(positions_m)
    return figures(np.linalg.norm(aligned_m - truth_m, axis=1)).rmse


# Goals: Milford, Wyeth and Prasser (2006), "RatSLAM on the Edge: Revealing a Coherent
# Representation from an Overloaded Rat Brain", IROS, section V.


@dataclass(frozen=True)
class GoalsRow:
    """Results of one run of the goals experiment."""

    seed: int
    size: tuple[int, int]
    trials: list[Trial]
    experiences: int
    error_m: float
    collisions: int
    temporal_map_ms: float
    wall_s: float


def goals_run(setting: Setting, job: tuple[int, tuple[int, int]]) -> GoalsRow:
    """Explore for an hour, then drive to six goals."""
    seed, (dim_x, dim_y) = job
    began = time.perf_counter()
    loop = setting.loop(
        seed, 'university_floor', pose_cells__pc_dim_x=dim_x, pose_cells__pc_dim_y=dim_y
    )
    places = explore_and_name(loop, setting.explore_s(60.0))
    explored = loop.log.truths()
    error_m, touched = map_error_m(loop), loop.simulator.collisions
    rng = np.random.Generator(np.random.PCG64(seed))
    names = choose_goals(places, loop.simulator.truth, GOALS_COUNT, rng)
    trials = [attempt(loop, name, places[name]) for name in names]
    graph = loop.experience_map
    times, temporal_map_ms = timed_temporal_map(loop)
    folder = setting.out / f'goals_{dim_x}x{dim_y}'
    if seed == 1:
        folder.mkdir(exist_ok=True)
        draw_plan(
            loop.simulator.plan, folder / f'floor_{seed}.png',
            {'explored': explored, **{f'to {x.goal}': x.path for x in trials}},
        )
        draw_packet(loop, folder / f'packet_{seed}.png', (dim_x, dim_y))
        goal = loop.navigator.goals.named(names[0])  # not the last goal, at which the robot is
        try:
            route = times.route_to(goal.experience_id)
            positions = graph.poses[list(route.experience_ids), :2]
        except UnreachableGoal:
            positions = None
        draw_temporal_map(
            graph, times, folder / f'temporal_map_{seed}.png', positions, [goal],
            title=f'{dim_x} x {dim_y} x 36 pose cells, seed {seed}',
        )
    return GoalsRow(
        seed, (dim_x, dim_y), trials, len(graph), error_m, touched, temporal_map_ms,
        time.perf_counter() - began,
    )


def timed_temporal_map(loop: ClosedLoop) -> tuple[TemporalMap, float]:
    """Return the temporal map from the present place, and the median of five times in ms."""
    durations_ms = []
    for _ in range(5):
        # A new planner, without cached results.
        planner = RoutePlanner(loop.config.goal_recall, loop.experience_map)
        start = time.perf_counter()
        times = planner.temporal_map()
        durations_ms.append(1e3 * (time.perf_counter() - start))
    return times, statistics.median(durations_ms)


def draw_packet(loop: ClosedLoop, path: Path, size: tuple[int, int]) -> None:
    """Draw the path of the activity packet, as in figures 8 and 9 of Milford et al. (2006)."""
    figure = new_figure(9.0, 5.0)
    axes = figure.add_subplot()
    at = np.array([(p.x, p.y) for p in loop.log.packet])
    jump = np.hypot(*np.diff(at, axis=0).T) > 1.0
    broken = np.insert(at, np.flatnonzero(jump) + 1, np.nan, axis=0)
    axes.plot(*broken.T, linewidth=0.4)
    cells = {(int(x), int(y)) for x, y in at}
    axes.set_title(f'path of the packet: {len(cells)} of {size[0] * size[1]} columns of cells')
    axes.set_xlabel("x' (cells)")
    axes.set_ylabel("y' (cells)")
    axes.set_xlim(0, size[0])
    axes.set_ylim(0, size[1])
    axes.set_aspect('equal')
    save_figure(figure, path)


def goals(setting: Setting, seeds: Sequence[int]) -> None:
    """Print the table of the goals experiment."""
    jobs = [(seed, size) for size in SIZES for seed in seeds]
    rows = pooled(partial(goals_run, setting), jobs)
    print('seed  cells        reached  ratio  (floor)  error [m]  experiences  map [m]  '
          'tries failed  unlearned  touched  reversals/m  temporal map [ms]  '
          'wall [s]')
    for row in rows:
        done = [x for x in row.trials if x.succeeded]
        print(
            f'{row.seed:4d}  {row.size[0]:3d} x {row.size[1]:2d} x 36 '
            f'{len(done):4d}/{len(row.trials)}  '
            f'{mean([x.ratio for x in done]):5.2f}  {mean([x.floor_ratio for x in done]):7.2f}  '
            f'{mean([x.error_m for x in done]):9.2f}  {row.experiences:11d}  {row.error_m:7.2f}  '
            f'{sum(x.tries_failed for x in row.trials):12d}  '
            f'{sum(x.links_unlearned for x in row.trials):9d}  {row.collisions:7d}  '
            f'{reversals_per_m(row.trials):11.2f}  {row.temporal_map_ms:17.1f}  {row.wall_s:8.0f}'
        )
    trials = [x for row in rows for x in row.trials]
    done = [x for x in trials if x.succeeded]
    ratios = [x.ratio for x in done if math.isfinite(x.ratio)]
    print(f'all   {len(done)} of {len(trials)} trials; ratio mean {mean(ratios):.2f}, '
          f'worst {max(ratios, default=math.nan):.2f}; error mean '
          f'{mean([x.error_m for x in done]):.2f} m, '
          f'worst {max((x.error_m for x in done), default=math.nan):.2f} m')
    claimed_m = [x.error_m for x in trials if x.is_claimed]
    print(f'      claimed arrivals: {len(claimed_m)}, mean distance {mean(claimed_m):.2f} m, '
          f'{sum(x > SUCCESS_M for x in claimed_m)} further than {SUCCESS_M:g} m; map error mean '
          f'{mean([row.error_m for row in rows]):.2f} m, worst '
          f'{max(row.error_m for row in rows):.2f} m; reversals per metre '
          f'{reversals_per_m(trials):.2f}, worst trial '
          f'{max(reversals_per_m([x]) for x in trials):.2f}')
    for row in rows:
        for x in row.trials:
            if not x.succeeded:
                print(f'failed: seed {row.seed}, {row.size[0]} x {row.size[1]}, {why(x)}')


def reversals_per_m(trials: Sequence[Trial]) -> float:
    """Return the changes of sign of the turn rate per metre driven."""
    return sum(x.reversals for x in trials) / max(sum(x.driven_m for x in trials), 1.0)


def why(x: Trial) -> str:
    """Return a summary of a failed trial."""
    return (
        f'{x.goal}: {x.outcome}, {x.error_m:.2f} m off, {x.driven_m:.0f} m in {x.took_s:.0f} of '
        f'{x.limit_s:.0f} s, {x.tries_failed} tries failed'
    )


# Obstacle: Milford, Wyeth and Prasser (2006), section VI.

BOX_M = (0.8, 2.2)
"""Extent of the obstacle along x and y."""

AT_START_M = 1.0
"""Largest distance from S at the start of a valid trial."""


def go_back(loop: ClosedLoop, at_m: tuple[float, float]) -> None:
    """Send the robot to S, in up to three attempts."""
    for _ in range(3):
        if attempt(loop, 'S', at_m).error_m < AT_START_M:
            return


def explore_and_name_ends(loop: ClosedLoop, duration_s: float) -> dict[str, tuple[float, float]]:
    """Explore, and name the places S and G of the plan; return the true positions of the names."""
    named: dict[str, float] = {}
    at: dict[str, tuple[float, float]] = {}
    end_s = loop.now_s + duration_s

    def until() -> bool:
        for name in 'SG':
            beside_m = away_m(loop, loop.simulator.plan.places[name])
            closer = beside_m < named.get(name, 1.2) - 0.1 and len(loop.experience_map) > 0
            if closer and drives(loop):
                named[name] = beside_m
                loop.name_place(name)
                at[name] = loop.simulator.truth.x_m, loop.simulator.truth.y_m
        return loop.now_s >= end_s

    loop.run(loop.exploring, until)
    return at


class ObstacleRow(NamedTuple):
    """Results of one run of the obstacle experiment.

    ``held``: whether all three goals were reached, by the expected routes.
    """

    held: bool
    line: str


def obstacle_run(setting: Setting, seed: int) -> ObstacleRow:
    """Run three trials: the short route is closed, still closed, and open again."""
    loop = setting.loop(seed, 'obstacle_loop', LookBacks(change_wall_every_s=240.0))
    plan, simulator = loop.simulator.plan, loop.simulator
    at = explore_and_name_ends(loop, setting.explore_s(20.0))
    if len(at) < 2:
        return ObstacleRow(False, f'{seed:4d}  a place was not passed')
    x_m, y_m = plan.places['X']
    trials, results, away, beside_m = [], [], [], []
    go_back(loop, at['S'])
    for number in (1, 2, 3):
        if number == 1:
            simulator.add_obstacle('box', x_m, y_m, *BOX_M)
        if number == 3:
            simulator.remove_obstacle('box')
        if number > 1:
            loop.explore(360.0)
            go_back(loop, at['S'])
        away.append(away_m(loop, at['S']))
        trial = attempt(loop, 'G', at['G'])
        beside_m.append(float(np.hypot(*(trial.path[:, :2] - (x_m, y_m)).T).min()))
        short = beside_m[-1] < (1.5 if number < 3 else 0.8)
        results.append(
            f'{"yes" if trial.succeeded else "NO":>3} {trial.driven_m:5.1f} m '
            f'{"by the box" if short and number < 3 else "short" if short else "long"}, '
            f'{trial.tries_failed} tries, {trial.links_unlearned} unlearned'
            f'{"" if away[-1] < AT_START_M else f", from {away[-1]:.0f} m beside S"}'
        )
        trials.append(trial)
        setting.out.mkdir(exist_ok=True)
        draw_plan(
            plan, setting.out / f'obstacle_{seed}_trial_{number}.png', {'driven': trial.path},
            [(x_m, y_m, *BOX_M)] if number < 3 else [], f'seed {seed}, trial {number}',
        )
    has_reached = max(away) < AT_START_M and all(x.succeeded for x in trials)
    held = has_reached and beside_m[1] > 2.0 and beside_m[2] < 1.0
    return ObstacleRow(
        held, f'{seed:4d}  {"held" if held else "NOT held":>8}  ' + ' | '.join(results)
    )


def obstacle(setting: Setting, seeds: Sequence[int]) -> None:
    """Print the table of the obstacle experiment."""
    rows = pooled(partial(obstacle_run, setting), list(seeds))
    print('seed            trial 1 | trial 2 | trial 3')
    print('\n'.join(row.line for row in rows))
    print(f'held in {sum(row.held for row in rows)} of {len(rows)} seeds')


# People in the way: the same section

PEOPLE_CASES = 'alone', '10 s', '30 s', '60 s', 'walking', 'alone'
"""Trials: for how long people stand in the way, of which the paper does not say anything, whether
they walk, or that there are none."""

ABREAST_M = 0.35
"""Distance of two people, who stand abreast, from the middle of the corridor, which they close."""

COMING_M, WALKING_S = 3.0, 120.0
"""Distance of the robot from X at which people come to stand there, and time for which people walk
between S and G from the beginning of a trial."""

SHORT_WAY_M = 20.0
"""Length below which a drive from S to G has taken the short way."""

PEOPLE_TRIAL_S, TO_START_S = 240.0, 600.0
"""Time limit of a trial, and longest time to pass S before it."""


class PeopleTrial(NamedTuple):
    """A drive from S to G past people.

    Attributes:
        case: one of ``PEOPLE_CASES``.
        began_m: distance from S at the beginning.
        met: whether the robot came within a metre of a person's body.
        reached: whether the robot reported its arrival, near G.
        took_s, driven_m: duration and length.
        lost: number of links that were unlearned on the way.
        lost_for_good: how many of these were not made again in six minutes of exploration.
    """

    case: str
    began_m: float
    met: bool
    reached: bool
    took_s: float
    driven_m: float
    lost: int
    lost_for_good: int


def people_run(setting: Setting, seed: int) -> list[PeopleTrial]:
    """Drive from S to G past people who stand in the way or walk along it, and without people."""
    loop = setting.loop(seed, 'obstacle_loop', LookBacks(change_wall_every_s=240.0))
    at = explore_and_name_ends(loop, setting.explore_s(20.0))
    if len(at) < 2:
        return []
    return [people_trial(loop, at, case, setting.explore_s(6.0)) for case in PEOPLE_CASES]


def links_of(loop: ClosedLoop) -> set[tuple[int, int]]:
    """Return source and target of all links."""
    return {(i, j) for i, j in loop.experience_map.link_ends.tolist()}


def people_trial(
    loop: ClosedLoop, at: dict[str, tuple[float, float]], case: str, explore_s: float
) -> PeopleTrial:
    """Explore until the robot passes S, drive to G, and explore for a while."""
    simulator, places = loop.simulator, loop.simulator.plan.places
    end_s = loop.now_s + TO_START_S
    loop.exploration.restart()
    loop.run(
        loop.exploring, lambda: away_m(loop, at['S']) < AT_START_M or loop.now_s > end_s
    )
    began_s, began_m, driven_m = loop.now_s, away_m(loop, at['S']), simulator.odometer_m
    before, met, comes = links_of(loop), False, case not in ('alone', 'walking')
    if case == 'walking':
        for points in ([places['G'], places['S']], [places['X'], places['S'], places['G']]):
            simulator.add_person(Walk(points, began_s, began_s + WALKING_S))

    def until() -> bool:
        nonlocal met, comes
        if comes and away_m(loop, places['X']) < COMING_M:
            comes = False
            x_m, y_m = places['X']
            for aside_m in (-ABREAST_M, ABREAST_M):
                to_s = loop.now_s + float(case.removesuffix(' s'))
                simulator.add_person(Walk([(x_m, y_m + aside_m)], loop.now_s, to_s))
        truth = simulator.truth
        beside_m = np.hypot(*(simulator.world.people[:, :2] - (truth.x_m, truth.y_m)).T)
        met |= bool((beside_m < PERSON_RADIUS_M + RIGHT_M).any())
        return loop.now_s > began_s + PEOPLE_TRIAL_S

    try:
        [task] = loop.go_to('G', until=until)
        reached = task.status == 'succeeded' and away_m(loop, at['G']) <= SUCCESS_M
    except UnreachableGoal:
        reached = False
    took_s, driven_m = loop.now_s - began_s, simulator.odometer_m - driven_m
    lost = before - links_of(loop)
    loop.explore(explore_s)
    return PeopleTrial(
        case, began_m, met, reached, took_s, driven_m, len(lost), len(lost - links_of(loop))
    )


def people_in_the_way(setting: Setting, seeds: Sequence[int]) -> None:
    """Print the table of drives past people."""
    print('seed  people   from S [m]  met  reached  time [s]  driven [m]  lost links  for good')
    for seed, row in zip(seeds, pooled(partial(people_run, setting), list(seeds)), strict=True):
        for x in row:
            print(f'{seed:4d}  {x.case:7}  {x.began_m:10.1f}  {"yes" if x.met else "no":>3}  '
                  f'{yes_or_no(x.reached):>7}  {x.took_s:8.0f}  {x.driven_m:10.1f}  {x.lost:10d}  '
                  f'{x.lost_for_good:8d}')


# Goal memory: Milford, Wyeth and Prasser (2005), "Efficient Goal Directed Navigation using
# RatSLAM", ICRA, and figure 4 of Milford, Wyeth and Prasser (2006).

LOOK_BACKS_2005 = LookBacks(every_m=3.0, turn_deg=30.0, back_m=2.0, change_wall_every_s=400.0)
"""Their robot turns back every 3 m or 30 degrees. Way back and change of the wall are ours."""

AS_PUBLISHED_2005 = replace(LOOK_BACKS_2005, change_wall_every_s=1e9)
"""With a preset whose goal memory is as published: the robot follows the left wall."""

REACHED_CELLS = 0.5
"""Distance at which a goal is reached on routes along links: the robot must not stop a cell before
it. As published, it is one cell."""

AS_MILFORD_2005: dict[str, Value] = {
    # Their robot drives 166 m in 17 minutes.
    'goal_follower__speed_mps': 0.25,
    # Scan alignment does not act on the pose cells: views must match only from nearby.
    'local_view__vt_match_threshold': 0.05,
    'goal_memory__goal_memory': True,
}
STRAY_AFTER_COUNT = 2
"""Failed tries after which the robot explores for a while, as with the experience map. As
published, it does not."""


class GoalMemoryTrial(NamedTuple):
    """Results for one goal, by goal memory and by the experience map."""

    seed: int
    size: str
    reached: bool
    error_m: float
    way_m: float
    """Length of the shortest path over places where the robot has been."""
    took_s: float
    reached_by_map: bool
    error_by_map_m: float
    collisions: int
    """Collisions of the whole run."""
    views: int
    """Views that the robot has learned when it has explored."""
    driven_m: float
    """Distance driven until the last goal by goal memory."""
    minutes: float
    """Duration until then."""


def goal_memory_run(
    setting: Setting, job: tuple[int, str], prepare: Callable[[ClosedLoop], None] = lambda _: None
) -> list[GoalMemoryTrial]:
    """Explore for 13 minutes; drive to two goals by goal memory, then by the experience map.

    Draws figures 6 to 10 of Milford et al. (2005): the occupancy only if the robot has sonars.
    ``prepare`` is called with the robot before it explores.
    """
    seed, size = job
    pictures = setting.out / f'goal_memory_{size}_{seed}'
    pictures.mkdir(parents=True, exist_ok=True)
    values = AS_MILFORD_2005
    if setting.config != Setting.config:
        values = {'goal_memory__goal_memory': True}  # the other values are those of the preset
    is_published = load_config(setting.config)[0].goal_memory.goal_memory_update == 'iteration'
    look_backs = AS_PUBLISHED_2005 if is_published else LOOK_BACKS_2005
    loop = setting.loop(seed, 'obstacle_loop', look_backs, **values, **CELLS[size])
    prepare(loop)
    grid = watched_by_sonar(loop)
    memory = loop.ratslam.goal_memory
    assert memory is not None
    places = explore_and_name(
        loop, setting.explore_s(13.0),
        lambda name: memory.mark(name, loop.ratslam.pose_cells.peak),
    )
    names = choose_goals(
        places, loop.simulator.truth, 2, np.random.Generator(np.random.PCG64(seed))
    )
    by_memory, views = [], loop.ratslam.pose_cells.next_template_id
    draw_driven(loop, grid, 0, pictures / 'figure_6.png')
    for number, name in enumerate(names):
        times, peak = memory.recall(memory.goal(name)), loop.ratslam.pose_cells.peak
        began = len(loop.log.packet)
        by_memory.append(by_goal_memory(loop, name, places[name]))
        driven = np.array([(at.x, at.y) for at in loop.log.packet[began:]])
        draw_temporal_array(times, peak, pictures / f'figure_{7 + 2 * number}.png', driven)
        draw_driven(loop, grid, began, pictures / f'figure_{8 + 2 * number}.png')
    drive = views, loop.simulator.odometer_m, loop.now_s / 60.0
    by_map = [attempt(loop, name, places[name]) for name in names[::-1]]
    return [
        GoalMemoryTrial(
            seed, size, *trial, x.succeeded, x.error_m, loop.simulator.collisions, *drive
        )
        for trial, x in zip(by_memory, by_map[::-1], strict=True)
    ]


class ExplorationRow(NamedTuple):
    """Results of an exploration, by sonars or by a laser."""

    seed: int
    sensor: str
    driven_m: float
    speed_mps: float
    squares: int
    """Squares of 1 m in which the robot has been."""
    collisions: int


def exploration_run(setting: Setting, job: tuple[int, bool]) -> ExplorationRow:
    """Explore for 13 minutes as in 2005, by sonars or by a laser."""
    seed, has_sonars = job
    # Images do not steer: few suffice.
    found = replace(setting, config='milford2005', has_sonars=has_sonars, camera_rate_hz=1)
    loop = found.loop(seed, 'obstacle_loop', AS_PUBLISHED_2005)
    duration_s = setting.explore_s(13.0)
    loop.explore(duration_s)
    squares = np.unique(np.floor(loop.log.truths()[:, :2]), axis=0)
    return ExplorationRow(
        seed, 'sonars' if has_sonars else 'laser', loop.simulator.odometer_m,
        loop.simulator.odometer_m / duration_s, len(squares), loop.simulator.collisions,
    )


def exploration(setting: Setting, seeds: Sequence[int]) -> None:
    """Print the table of explorations by sonars and by a laser."""
    jobs = [(seed, has_sonars) for has_sonars in (True, False) for seed in seeds]
    print('seed  sensor  driven [m]  speed [m/s]  squares of 1 m  collisions')
    for x in pooled(partial(exploration_run, setting), jobs):
        print(f'{x.seed:4d}  {x.sensor:6s}  {x.driven_m:10.0f}  {x.speed_mps:11.3f}  '
              f'{x.squares:14d}  {x.collisions:10d}')


def watched_by_sonar(loop: ClosedLoop) -> SonarGrid:
    """Return a grid to which the robot will add every range of its sonars, if it has any."""
    cells, sonars = loop.ratslam.pose_cells, loop.simulator.options.sonars
    grid = SonarGrid(Torus(*cells.dims))

    def watch(sample: Sample) -> None:
        if isinstance(sample, SonarSample) and sonars is not None:
            for mount, range_m in zip(sonars.mounts, sample.ranges_m.tolist(), strict=True):
                cone_rad = math.radians(sonars.cone_deg)
                grid.add(cells.peak, cells.lengths.cell_m, mount, cone_rad, range_m)

    loop.simulator.watchers.append(watch)
    return grid


def draw_driven(loop: ClosedLoop, grid: SonarGrid, began: int, path: Path) -> None:
    """Draw the occupancy by sonar and the path of the packet since a sample, with sonars."""
    if loop.simulator.options.sonars is not None:
        driven = np.array([(at.x, at.y) for at in loop.log.packet[began:]])
        draw_occupancy(grid, driven, path)


def by_goal_memory(
    loop: ClosedLoop, name: str, at_m: tuple[float, float]
) -> tuple[bool, float, float, float]:
    """Drive to a goal by its temporal map: along its links, or as published, by its gradient.

    Returns:
        Whether the goal was reached, the true distance from it, the length of the shortest path in
        metres, and the time taken in seconds.
    """
    memory, cells = loop.ratslam.goal_memory, loop.ratslam.pose_cells
    assert memory is not None
    goal = memory.goal(name)
    simulator = loop.simulator
    path = DrivenGraph(loop.log.truths()).shortest_path(simulator.truth, at_m)
    length_m = path.length_m if path else 50.0
    began_s = loop.now_s
    end_s = began_s + 3.0 * length_m / loop.config.goal_follower.speed_mps + 10.0
    tries = 0
    stray_until_m = 0.0

    def stray(scan: Scan) -> Command:
        nonlocal stray_until_m
        stray_until_m = simulator.odometer_m + RECOVERY_M
        loop.exploration.restart()
        return loop.exploring(scan)

    def steer(scan: Scan) -> Command:
        nonlocal tries
        if simulator.odometer_m < stray_until_m:
            return loop.exploring(scan)
        assert isinstance(memory, GoalRoutes)
        route = memory.route_ahead(memory.recall(goal), cells.peak, 3.0)
        if len(route) < 2 or not np.diff(route, axis=0).any():
            return stray(scan)
        command = loop.follower.command(scan, route)
        if command.failed:
            tries += 1
            memory.blocked(cells.peak, command.ahead_rad, tries * TRY_TIMEOUT_S)
            if tries % STRAY_AFTER_COUNT == 0:
                return stray(scan)
        return command

    def by_gradient(scan: Scan) -> Command:
        bearing_rad = memory.bearing(memory.recall(goal), cells.peak)
        if bearing_rad is None:
            return loop.exploring(scan)
        return loop.follower.command(scan, route_towards(bearing_rad))

    def arrived() -> bool:
        return memory.reached(goal, cells.peak, REACHED_CELLS if has_routes else 1.0)

    has_routes = isinstance(memory, GoalRoutes)
    loop.run(steer if has_routes else by_gradient, lambda: arrived() or loop.now_s >= end_s)
    error_m = away_m(loop, at_m)
    return arrived() and error_m <= 0.5, error_m, length_m, loop.now_s - began_s


def goal_memory(setting: Setting, seeds: Sequence[int]) -> None:
    """Print the table of the goal memory experiment, for both sizes of the pose cells."""
    jobs = [(seed, size) for size in CELLS for seed in seeds]
    trials = [x for found in pooled(partial(goal_memory_run, setting), jobs) for x in found]
    print('seed  cells  goal memory  off by [m]  way [m]  time [s]  experience map  off by [m]')
    for x in trials:
        print(
            f'{x.seed:4d}  {x.size:5s}  {yes_or_no(x.reached):>11}  {x.error_m:10.2f}  '
            f'{x.way_m:7.1f}  {x.took_s:8.0f}  {yes_or_no(x.reached_by_map):>14}  '
            f'{x.error_by_map_m:10.2f}'
        )
    for size in CELLS:
        some = [x for x in trials if x.size == size]
        print(f' all  {size:5s}  {sum(x.reached for x in some):5d} of {len(some):2d}  '
              f'{mean([x.error_m for x in some if x.reached]):10.2f}  '
              f'{mean([x.way_m for x in some]):7.1f}  {mean([x.took_s for x in some]):8.0f}  '
              f'{sum(x.reached_by_map for x in some):8d} of {len(some):2d}  '
              f'{mean([x.error_by_map_m for x in some if x.reached_by_map]):10.2f}')
    print(f'collisions: {sum(x.collisions for x in trials[::2])}')  # two trials of each run


SLOW_S = 10.0
"""Duration of the stretches with every image, and of those between them with every second one."""


def make_irregular(loop: ClosedLoop) -> None:
    """Leave out every second image in alternate stretches of time."""
    step, images = loop.simulator.step, itertools.count()

    def sparse_step() -> list[Sample]:
        is_slow = loop.now_s % (2.0 * SLOW_S) >= SLOW_S
        return [
            sample for sample in step()
            if not (is_slow and isinstance(sample, ImageSample) and next(images) % 2)
        ]

    loop.simulator.step = sparse_step  # type: ignore[method-assign]


def yes_or_no(reached: bool) -> str:
    """Return the entry of a table."""
    return 'yes' if reached else 'NO'


# Loop closure on a ring of 122 m


class LoopRow(NamedTuple):
    """Results of one drive round the ring; columns as in docs/experiments.md."""

    closed: bool
    after_m: float
    drift_m: float
    map_before_m: float
    map_after_m: float
    wrong: int


def loop_run(setting: Setting, seed: int) -> LoopRow:
    """Follow the left wall round the ring and a little further; report when the loop is closed."""
    # looks_back: with the preset of 2006 as well, the exploration is that of the arguments.
    plan, look_backs = str(FOLDER / 'ring.txt'), LookBacks(every_m=math.inf)
    loop = replace(setting, looks_back=True).loop(seed, plan, look_backs)
    log, simulator = loop.log, loop.simulator

    def is_closed() -> bool:
        return any(
            jump_m <= RIGHT_M and stamp_ns > log.stamp_ns[0] + 60e9
            for stamp_ns, jump_m in zip(log.closures_ns, log.jump_m, strict=True)
        )

    def is_over() -> bool:
        return simulator.odometer_m > RING_LENGTH_M + ONWARD_M

    loop.run(loop.exploring, lambda: is_closed() or is_over())
    closed, at_m = is_closed(), simulator.odometer_m
    drift_m = closing_error_m(log.truths(), np.array(log.dead_reckoning))
    before_m = map_error_m(loop)
    loop.run(loop.exploring, is_over)
    loop.experience_map.settle()
    wrong = sum(jump_m > RIGHT_M for jump_m in log.jump_m)
    return LoopRow(closed, at_m, drift_m, before_m, map_error_m(loop), wrong)


def closing_error_m(truth: NDArray[np.float64], reckoned: NDArray[np.float64]) -> float:
    """Return the error of dead reckoning at the end, aligned with the truth at the start."""
    turn = truth[0, 2] - reckoned[0, 2]
    c, s = math.cos(turn), math.sin(turn)
    moved = (reckoned[-1, :2] - reckoned[0, :2]) @ np.array([[c, s], [-s, c]])
    return float(np.hypot(*(moved - (truth[-1, :2] - truth[0, :2]))))


def loop(setting: Setting, seeds: Sequence[int]) -> None:
    """Print the table of the loop experiment."""
    print('seed  closed  after [m]  drift [m]  before [m]  after [m]  wrong closures')
    rows = pooled(partial(loop_run, setting), list(seeds))
    for seed, (closed, after_m, drift_m, before_m, map_m, wrong) in zip(seeds, rows, strict=True):
        print(f'{seed:4d}  {"yes" if closed else "NO":>6}  {after_m:9.1f}  {drift_m:9.2f}  '
              f'{before_m:10.2f}  {map_m:9.2f}  {wrong:5d}')


# Loop closures

SOLVER_COUNT = 30
"""Solutions of the linearised problem, after which the map does not change any more."""


WRONG_LINK_M = 1.5
"""Distance between the ends of a link, by its shape and by the truth, at which it is wrong."""


def closures_run(setting: Setting, seed: int) -> str:
    """Explore; count loop closures and those elsewhere, and find what the map's error is due to.

    The map is also solved for the fixed point of its links, without wrong links, and with the true
    shapes of all links but those between successive experiences.
    """
    loop = setting.loop(seed, 'university_floor')
    loop.explore(setting.explore_s(20.0))
    graph, jumps_m = loop.experience_map, np.array(loop.log.jump_m)
    truth = np.array([loop.log.truth_of[i] for i in range(len(graph))])
    ends, shapes = graph.link_ends, graph.link_table.shapes
    true_m = seen_from_each(truth, *ends.T)
    length_m, heading_rad, _ = shapes.T
    links_m = np.stack([length_m * np.cos(heading_rad), length_m * np.sin(heading_rad)], axis=1)
    is_wrong = np.hypot(*(links_m - true_m).T) > WRONG_LINK_M
    true_shapes = np.stack([
        np.hypot(*true_m.T), np.arctan2(*true_m.T[::-1]), np.diff(truth[ends, 2], axis=1)[:, 0]
    ], axis=1)
    is_chain = np.diff(ends, axis=1) == 1
    solved_m = [
        map_error_m(loop, solved(graph.poses, *links)) for links in (
            (ends, shapes), (ends[~is_wrong], shapes[~is_wrong]),
            (ends, np.where(is_chain, shapes, true_shapes)),
        )
    ]
    return (f'{seed:4d}  {loop.ratslam.pose_cells.next_template_id:9d}  '
            f'{len(graph):11d}  {len(jumps_m):8d}  {np.mean(jumps_m > 1.0):10.1%}  '
            f'{np.mean(jumps_m > 3.0):4.1%}  {is_wrong.sum():11d}  {map_error_m(loop):7.2f}  '
            + '  '.join(f'{error_m:11.2f}' for error_m in solved_m))


def solved(
    poses: NDArray[np.float64], ends: NDArray[np.int64], shapes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the poses at the fixed point of some links."""
    poses = poses.copy()
    for _ in range(SOLVER_COUNT):
        relax(poses, ends, shapes, np.tile(EQUAL_WEIGHTS, (len(ends), 1)))
    return poses


def closures(setting: Setting, seeds: Sequence[int]) -> None:
    """Print how many loop closures are wrong."""
    print('seed  templates  experiences  closures  wrong: 1 m  3 m   wrong links  map [m]  '
          'solved [m]  right links  true closures')
    print('\n'.join(pooled(partial(closures_run, setting), list(seeds))))


# Scan alignment


def alignment_run(setting: Setting, job: tuple[int, bool]) -> str:
    """Explore with or without scan alignment; return the errors of links and map."""
    seed, aligned = job
    loop = setting.loop(seed, 'university_floor', experience_map__exp_align_scans=aligned)
    loop.explore(setting.explore_s(30.0))
    graph = loop.experience_map
    truth = np.array([loop.log.truth_of[i] for i in range(len(graph))])
    ends, (length_m, heading_rad, _) = graph.link_ends, graph.link_table.shapes.T
    links_m = np.stack([length_m * np.cos(heading_rad), length_m * np.sin(heading_rad)], axis=1)
    closing = np.abs(ends[:, 0] - ends[:, 1]) > 1
    link_m = np.hypot(*(links_m - seen_from_each(truth, *ends.T)).T)[closing]
    # Neighbouring experiences that were created at different times.
    pairs = cKDTree(truth[:, :2]).query_pairs(0.7, output_type='ndarray')
    pairs = pairs[np.abs(pairs[:, 0] - pairs[:, 1]) > 50]
    beside = seen_from_each(graph.poses, *pairs.T) - seen_from_each(truth, *pairs.T)
    beside_m = np.hypot(*beside.T)
    return (f'{seed:4d}  {"yes" if aligned else "no":>7}  {np.median(link_m):8.3f}  '
            f'{np.quantile(link_m, 0.9):8.3f}  {np.median(beside_m):10.3f}  '
            f'{np.quantile(beside_m, 0.9):8.3f}  {map_error_m(loop):7.2f}')


def seen_from_each(
    poses: NDArray[np.float64], source: NDArray[np.int64], target: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the positions of the targets in the frames of the sources, (n, 2)."""
    x, y = (poses[target, :2] - poses[source, :2]).T
    c, s = np.cos(poses[source, 2]), np.sin(poses[source, 2])
    return np.stack([c * x + s * y, c * y - s * x], axis=1)


def alignment(setting: Setting, seeds: Sequence[int]) -> None:
    """Print the table of the alignment experiment."""
    print('seed  aligned  link [m]: median  90 %  beside [m]: median  90 %  map [m]')
    jobs = [(seed, aligned) for seed in seeds for aligned in (False, True)]
    print('\n'.join(pooled(partial(alignment_run, setting), jobs)))


# Kidnapped robot


class Carry(NamedTuple):
    """One carried robot: whether it recovered, after what time and way, and wrong places.

    ``wrong``: number of times that a place more than ``RIGHT_M`` away became current.
    """

    recovered: bool
    time_s: float
    way_m: float
    wrong: int


def kidnapped_run(setting: Setting, job: tuple[int, str]) -> list[Carry]:
    """Carry the robot to places near its path, and measure the time to relocalisation."""
    seed, relocate = job
    loop = setting.loop(seed, 'university_floor', experience_map__exp_relocate=relocate)
    loop.explore(setting.explore_s(30.0))
    rng = np.random.Generator(np.random.PCG64(seed))
    driven = loop.log.truths()
    found = []
    for _ in range(CARRIES_COUNT):
        carry_away(loop, driven, rng)
        began_s, began_m = loop.now_s, loop.simulator.odometer_m
        before, count = len(loop.log.jump_m), len(loop.experience_map)

        def located(before: int = before, count: int = count, began_s: float = began_s) -> bool:
            recent = loop.log.jump_m[before:]
            right = loop.experience_map.current_id < count and recent and recent[-1] < RIGHT_M
            return bool(right) or loop.now_s > began_s + MAX_LOST_S

        loop.exploration.restart()
        loop.run(loop.exploring, located)
        took_s, way_m = loop.now_s - began_s, loop.simulator.odometer_m - began_m
        loop.explore(SETTLING_S)  # a place that is left again at once was wrong
        wrong = sum(jump_m > RIGHT_M for jump_m in loop.log.jump_m[before:])
        found.append(Carry(took_s < MAX_LOST_S, took_s, way_m, wrong))
    return found


def carry_away(
    loop: ClosedLoop, driven: NDArray[np.float64], rng: np.random.Generator
) -> None:
    """Carry the robot at least 8 m away, 0.5 m off a pose where it was, to a random heading."""
    truth = loop.simulator.truth
    away = np.hypot(driven[:, 0] - truth.x_m, driven[:, 1] - truth.y_m) > 8.0
    while True:
        x_m, y_m, _ = driven[rng.choice(np.flatnonzero(away))].tolist()
        towards_rad, heading_rad = rng.uniform(-math.pi, math.pi, 2).tolist()
        x_m += CARRY_OFFSET_M * math.cos(towards_rad)
        y_m += CARRY_OFFSET_M * math.sin(towards_rad)
        try:
            loop.simulator.carry(Pose(x_m, y_m, heading_rad))
        except UnusableInput:
            continue  # too close to a wall
        return


def kidnapped(setting: Setting, seeds: Sequence[int]) -> None:
    """Print the times and distances to relocalisation."""
    print('exp_relocate  seed  recovered  wrong  time [s]: mean   95 %  worst  '
          'way [m]: mean  worst')
    for relocate in setting.relocate:
        jobs = [(seed, relocate) for seed in seeds]
        rows = pooled(partial(kidnapped_run, setting), jobs)
        for seed, row in zip(seeds, rows, strict=True):
            print(kidnapped_line(f'{relocate:>12}  {seed:4d}', row))
        print(kidnapped_line(f'{relocate:>12}   all', [one for row in rows for one in row]))


def kidnapped_line(name: str, row: Sequence[Carry]) -> str:
    """Return a row of the table."""
    times = [one.time_s for one in row if one.recovered]
    ways = [one.way_m for one in row if one.recovered]
    most = float(np.quantile(times, 0.95)) if times else math.nan
    return (f'{name}  {len(times):3d} of {len(row):2d}  {sum(one.wrong for one in row):5d}  '
            f'{mean(times):14.1f}  {most:5.1f}  {max(times, default=math.nan):5.1f}  '
            f'{mean(ways):13.1f}  {max(ways, default=math.nan):5.1f}')


# Kidnapped on the way to a goal: announced by Milford et al. (2005), section VI

FAR_M, UNDER_WAY_S, FOUND_S = 5.0, 5.0, 300.0
"""Least distance of the goal, time after which the robot is carried on its way, and time within
which it must reach the goal from there."""


class CarriedTrial(NamedTuple):
    """A goal on the way to which the robot was carried: whether it was claimed, and the end."""

    claimed: bool
    error_m: float
    time_s: float

    @property
    def reached(self) -> bool:
        """Whether the robot rightly claimed to have arrived."""
        return self.claimed and self.error_m <= SUCCESS_M


def kidnapped_goals_run(setting: Setting, job: tuple[int, str]) -> list[CarriedTrial]:
    """Carry the robot away on its way to named places, as in ``kidnapped_run``."""
    seed, relocate = job
    loop = setting.loop(seed, 'university_floor', experience_map__exp_relocate=relocate)
    places = explore_and_name(loop, setting.explore_s(30.0))
    rng = np.random.Generator(np.random.PCG64(seed))
    driven = loop.log.truths()
    trials: list[CarriedTrial] = []
    while len(trials) < CARRIES_COUNT:
        name = str(rng.choice(sorted(places)))
        if away_m(loop, places[name]) < FAR_M:
            continue
        carry_s, carried_s = loop.now_s + UNDER_WAY_S, math.inf

        def until(carry_s: float = carry_s) -> bool:
            nonlocal carried_s
            if carried_s == math.inf and loop.now_s >= carry_s:
                carry_away(loop, driven, rng)
                carried_s = loop.now_s
            return loop.now_s > carried_s + FOUND_S

        try:
            [task] = loop.go_to(name, until=until)
            claimed = task.status == 'succeeded'
        except UnreachableGoal:
            claimed, carried_s = False, loop.now_s
        trials.append(CarriedTrial(
            claimed, away_m(loop, places[name]), loop.now_s - carried_s
        ))
    return trials


def away_m(loop: ClosedLoop, at_m: tuple[float, float]) -> float:
    """Return the true distance of the robot from a position."""
    return math.hypot(loop.simulator.truth.x_m - at_m[0], loop.simulator.truth.y_m - at_m[1])


def kidnapped_goals(setting: Setting, seeds: Sequence[int]) -> None:
    """Print how many goals are reached by a robot that is carried on its way."""
    print('exp_relocate  seed    reached  claimed too far away  time [s]: mean  worst')
    for relocate in setting.relocate:
        jobs = [(seed, relocate) for seed in seeds]
        rows = pooled(partial(kidnapped_goals_run, setting), jobs)
        parts = [*zip(map(str, seeds), rows, strict=True), ('all', [*itertools.chain(*rows)])]
        for name, row in parts:
            reached = [one for one in row if one.reached]
            times = [one.time_s for one in reached]
            far = sum(one.claimed and not one.reached for one in row)
            print(f'{relocate:>12}  {name:>4}  {len(reached):3d} of {len(row):2d}  {far:20d}  '
                  f'{mean(times):14.1f}  {max(times, default=math.nan):5.1f}')


# Relocation of a robot that is not carried


def undisturbed_run(setting: Setting, job: tuple[str, int, str]) -> str:
    """Explore a floor for an hour; return the relocations and the map's error."""
    plan, seed, relocate = job
    loop = setting.loop(seed, plan, experience_map__exp_relocate=relocate)
    loop.explore(setting.explore_s(60.0))
    log, relocator = loop.log, loop.ratslam.relocator
    by_scans = set(log.relocations_ns)
    jumps_m = [
        jump_m for stamp_ns, jump_m in zip(log.closures_ns, log.jump_m, strict=True)
        if stamp_ns in by_scans
    ]
    searches = 0 if relocator is None else relocator.counts['requested']
    return (f'{Path(plan).stem:>16}  {seed:4d}  {relocate:>12}  {searches:8d}  '
            f'{len(jumps_m):5d}  {sum(jump_m > RIGHT_M for jump_m in jumps_m):5d}  '
            f'{map_error_m(loop):7.2f}')


def undisturbed(setting: Setting, seeds: Sequence[int]) -> None:
    """Print the relocations of robots that are not carried."""
    print('           floor  seed  exp_relocate  searches  found  wrong  map [m]')
    jobs = [
        (plan, seed, relocate) for plan in ('university_floor', *FLOORS) for seed in seeds
        for relocate in setting.relocate
    ]
    print('\n'.join(pooled(partial(undisturbed_run, setting), jobs)))


# Pruning


class PruningRow(NamedTuple):
    """Results of one run of the pruning experiment.

    Numbers of experiences without the limit and with it, RMSE of both maps in m, and the trials
    with it.
    """

    free: int
    limited: int
    free_m: float
    limited_m: float
    trials: list[Trial]


def pruning_run(setting: Setting, seed: int) -> PruningRow:
    """Explore for two hours, without and with a limit of experiences; drive to three goals."""
    free = setting.loop(seed, 'university_floor')
    free.explore(setting.explore_s(120.0))
    limit = len(free.experience_map) // 3
    loop = setting.loop(seed, 'university_floor', pose_cells__exp_max=limit)
    places = explore_and_name(loop, setting.explore_s(120.0))
    names = choose_goals(
        places, loop.simulator.truth, 3, np.random.Generator(np.random.PCG64(seed))
    )
    trials = [attempt(loop, name, places[name]) for name in names]
    return PruningRow(
        len(free.experience_map), len(loop.experience_map), map_error_m(free), map_error_m(loop),
        trials,
    )


def pruning(setting: Setting, seeds: Sequence[int]) -> None:
    """Print the table of the pruning experiment."""
    print('seed  without   limit    made  map [m]: without    with  goals reached')
    rows = pooled(partial(pruning_run, setting), list(seeds))
    for seed, row in zip(seeds, rows, strict=True):
        done = sum(x.succeeded for x in row.trials)
        print(f'{seed:4d}  {row.free:7d}  {row.free // 3:6d}  {row.limited:6d}  '
              f'{row.free_m:16.2f}  {row.limited_m:7.2f}  {done}/{len(row.trials)}')
        for x in row.trials:
            if not x.succeeded:
                print(f'failed: seed {seed}, {why(x)}')


def mean(values: Sequence[float]) -> float:
    """Return the mean of the finite values, NaN if there are none."""
    finite = [value for value in values if math.isfinite(value)]
    return statistics.fmean(finite) if finite else math.nan


def pooled(run: Callable[[Job], Row], jobs: Sequence[Job]) -> list[Row]:
    """Run jobs in parallel on all cores; return their rows in order."""
    with ProcessPoolExecutor(min(os.cpu_count() or 1, len(jobs))) as pool:
        return list(tqdm(pool.map(run, jobs), total=len(jobs), unit='run', disable=None))


EXPERIMENTS = {
    'goals': goals, 'obstacle': obstacle, 'people_in_the_way': people_in_the_way,
    'exploration': exploration, 'goal_memory': goal_memory, 'loop': loop, 'kidnapped': kidnapped,
    'kidnapped_goals': kidnapped_goals, 'undisturbed': undisturbed, 'pruning': pruning,
    'alignment': alignment, 'closures': closures,
}


def main() -> None:
    """Run one experiment."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').partition('\n')[0])
    parser.add_argument('experiment', choices=EXPERIMENTS)
    parser.add_argument('--seeds', type=int, default=10, help='number of seeds (default: 10)')
    parser.add_argument('--first', type=int, default=1, help='first seed (default: 1)')
    parser.add_argument(
        '--config', help='preset or file of parameters (default: the preset for the sensors)'
    )
    parser.add_argument(
        '--camera-rate', type=int, default=Setting.camera_rate_hz, help='images per second'
    )
    parser.add_argument('--plan', default='', help="floor plan instead of the experiment's")
    parser.add_argument('--noise', type=float, default=1.0, help='noise relative to a Pioneer')
    parser.add_argument('--people', type=int, default=0, help='number of people who walk about')
    parser.add_argument(
        '--minutes', type=float, default=0.0, help="exploration time instead of the experiment's"
    )
    parser.add_argument(
        '--sensors', default='laser', choices=PRESETS,
        help='sensors of the map: a laser besides the camera, or the camera and wheels alone; '
             'they select the preset, unless --config does',
    )
    parser.add_argument(
        '--no-sonars', action='store_true', help='steer by a laser with the preset of 2005 as well'
    )
    parser.add_argument('--set', action='append', default=[], metavar='SECTION.NAME=VALUE')
    parser.add_argument(
        '--relocate', nargs='+', choices=('views', 'landmarks', 'both'),
        help='values of exp_relocate in kidnapped, kidnapped_goals and undisturbed (default: '
        'views, and both with a laser)',
    )
    parser.add_argument(
        '--look-back', action='store_true', help='look back with the preset of 2006 as well'
    )
    parser.add_argument('--out', type=Path, default=Path('results/navigation'))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    config = options.config or PRESETS[options.sensors]
    relocate = tuple(options.relocate or RELOCATE[: 2 if options.sensors == 'laser' else 1])
    setting = Setting(
        options.plan, options.noise, options.people, options.out, options.minutes,
        tuple(options.set), relocate, config, options.camera_rate, options.look_back,
        not options.no_sonars,
    )
    began = time.perf_counter()
    EXPERIMENTS[options.experiment](
        setting, range(options.first, options.first + options.seeds)
    )
    print(f'{time.perf_counter() - began:.0f} s')


if __name__ == '__main__':
    main()
