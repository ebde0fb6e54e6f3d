# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Experiments of Kahn and Mazor (2002) in simulation: landmark mapping, memory and relocalisation.

    python benchmarks/landmarks.py mapping [--seeds 50] [--first 1] [--out results/landmarks]
    python benchmarks/landmarks.py memory | memory-relocalisation
    python benchmarks/landmarks.py relocalisation | as-published | unmapped | effort | laser

Each experiment prints a table beside the results of the paper and draws its plots into --out. They
are described in docs/landmarks.md. One seed runs per core.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from navigation import FLOORS, FOLDER, pooled
from numpy.typing import NDArray
from published_relocalisation import Bound, relocalise_as_published, search_jointly_compatible
from scipy.spatial import cKDTree

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import MotionFromOdometry, Odometry, Twist, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config import GoalFollowerParameters, MemoryParameters
from ratslam_ros.core.driving.exploration import Exploration
from ratslam_ros.core.landmarks.features import BAR_SIZE, MAX_OBSERVATION_COUNT, Features
from ratslam_ros.core.landmarks.landmark_memory import LandmarkMemory
from ratslam_ros.core.landmarks.laser_map import LaserMap
from ratslam_ros.core.landmarks.local_map import LocalMap
from ratslam_ros.core.landmarks.models import MapModel
from ratslam_ros.core.landmarks.place_search import RelocalisationParameters
from ratslam_ros.core.landmarks.relocalisation import KnownFeatures, relocalise
from ratslam_ros.results.evaluation import Transform2D, fit
from ratslam_ros.results.plots import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    PALE_GREY,
    VERMILLION,
    add_legend_below,
    equal_axes,
    new_figure,
    save_figure,
)
from ratslam_simulator.config import SimulatorParameters, parse_start
from ratslam_simulator.floor_plan import FloorPlan, load_floor_plan
from ratslam_simulator.landmarks import (
    DISTINCT,
    NORMAL,
    BarOptions,
    LandmarkSensor,
    LandmarkWorld,
    Step,
    Vehicle,
    drive,
    floor_plan_landmarks,
    lap,
    observe,
    random_pose,
    scattered_bars,
)
from ratslam_simulator.samples import OdometrySample, ScanSample
from ratslam_simulator.simulation import Simulator

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SENSOR = LandmarkSensor()
"""Sensor with the noise at which relocalisation is required to succeed."""

SPEED_MPS = 1.0
"""Constant speed of the vehicle, by which freshness decays."""

MARGIN_M = 12.5
"""Distance of the vehicle's rectangular path from the edge of the world."""

OFFICE_TOUR = 'EBCFDAE'
"""Places of the office that the vehicle passes."""

OFFICE_VEHICLE = Vehicle(step_m=0.5, look_ahead_m=0.7)
"""Vehicle in the office, where corridors are 2.1 m wide."""

LIMITS = (20, 30, 40, 60, 80, 120, 160, 0)
"""Limits of the number of landmarks; 0: none."""

CROWDED = replace(NORMAL, count=200)
"""World of the memory experiments, with many more landmarks than the limits."""

FEW = 10
"""Observations per step in the memory experiments."""

MEMORY = MemoryParameters(forget_after_s=15.0)
"""Decay time of the freshness: an eighth of a lap, in which the vehicle passes a region."""


KIDNAP_WORLDS = (100, 150, 200)
"""Numbers of landmarks in the worlds of memory-relocalisation."""

KIDNAP_LIMITS = (80, 0)
"""Limits of memory-relocalisation, as in figure 4 of the paper; 0: none."""

KIDNAPS_COUNT = 10
"""Kidnappings per seed."""

SPARSE_SEARCH = RelocalisationParameters(share=0.15, draws=5000)
"""Search of a map that may have forgotten most of the landmarks in view."""

RIGHT_M, RIGHT_RAD = 1.0, math.radians(10.0)
"""Largest errors of a relocalisation that counts as right."""


ALL = MAX_OBSERVATION_COUNT
"""Number of observations that does not limit them."""

RELOCALISATION_CASES: dict[str, tuple[BarOptions, float, int]] = {
    'distinct': (DISTINCT, 1.0, ALL),
    'distinct, twice the noise': (DISTINCT, 2.0, ALL),
    'normal': (NORMAL, 1.0, ALL),
    'normal, twice the noise': (NORMAL, 2.0, ALL),
    'normal, only 5 seen': (NORMAL, 1.0, 5),
    'twice the noise, 5 seen': (NORMAL, 2.0, 5),
    'normal, only 4 seen': (NORMAL, 1.0, 4),
    'twice the noise, 4 seen': (NORMAL, 2.0, 4),
}
"""Worlds of table 1, the factor of the sensor's noise, and the limit of the observations."""

AS_PUBLISHED_CASES: dict[str, tuple[float, float, int]] = {
    'as all others': (2.0, 0.1, ALL),
    'angle 10 degrees': (10.0, 0.1, ALL),
    'angle 20 degrees': (20.0, 0.1, ALL),
    'angle 40 degrees': (40.0, 0.1, ALL),
    'angle 80 degrees': (80.0, 0.1, ALL),
    'length 1 m': (2.0, 1.0, ALL),
    'length 3 m': (2.0, 3.0, ALL),
    '5 seen': (2.0, 0.1, 5),
    '5 seen, angle 80 degrees': (80.0, 0.1, 5),
    '3 seen': (2.0, 0.1, 3),
    '3 seen, angle 80 degrees': (80.0, 0.1, 3),
}
"""Standard deviations of the measured angles in degrees and lengths in m, and observations."""

UNMAPPED_CASES: dict[str, tuple[BarOptions, float]] = {
    case: (options, noise)
    for case, (options, noise, count) in RELOCALISATION_CASES.items() if count == ALL
}
"""Worlds of which another one is mapped, with the factor of the noise."""

UNMAPPED_PLANS = ('house', 'school', 'hall')
"""Floor plans of which the western half is mapped; the robot is in the eastern half."""

ENTRY_M = 6.0
"""Distance from the mapped half beyond which the robot is in a region never mapped."""

PLAN_SD = np.array([0.05, 0.05, 0.01, 0.05])
"""Standard deviations of x, y, direction and length of landmarks that are mapped without a drive,
in the experiments on floor plans and on the search effort."""

OBSERVATION_COUNTS, FEATURE_COUNTS = (4, 8, 12, 15, 20), (20, 50, 100, 200, 500)
"""Sizes of the searches."""

SEARCH = RelocalisationParameters()
"""Search with the default parameters."""

OUTCOME_HEADING = (
    f'{"right":>8}{"wrong":>7}{"ambiguous":>11}{"not here":>10}{"x [m]":>16}{"y [m]":>16}{"ms":>7}'
)
"""Names of the columns of ``outcomes``."""

MAX_NODES = 50_000
"""Joint tests after which a search without random sampling is aborted."""


@dataclass(frozen=True)
class Setting:
    """Options that all experiments share.

    Attributes:
        out: folder of the plots.
        seeds: seeds of worlds and drives.
    """

    out: Path
    seeds: Sequence[int]


@dataclass(frozen=True)
class Drive:
    """A vehicle's drive through a world, and what its sensors measure."""

    world: LandmarkWorld
    sensor: LandmarkSensor
    vehicle: Vehicle
    start: Pose
    steps: list[Step]


@dataclass(frozen=True)
class Mapped:
    """A drive with the map made from it.

    Attributes:
        drive: the drive.
        memory: the map.
        path: (steps, 3) estimated poses.
        ms: CPU time per step.
    """

    drive: Drive
    memory: LandmarkMemory
    path: NDArray[np.float64]
    ms: float


@dataclass(frozen=True)
class Accuracy:
    """Errors of the landmarks of a map.

    Attributes:
        count: number of landmarks.
        within: share of the coordinates (x, y, direction, length) within 2 standard deviations.
        nees: normalised estimation error squared of all coordinates together, per degree of
            freedom; 1 on average if the covariance is right.
        rms_m: root mean square of the position errors.
        sd_m: root mean square of the standard deviations of the positions.
        pose_rms_m: root mean square of the errors of the vehicle's position.
    """

    count: int
    within: float
    nees: float
    rms_m: float
    sd_m: float
    pose_rms_m: float


def generator(seed: int) -> np.random.Generator:
    """Return a generator of random numbers."""
    return np.random.Generator(np.random.PCG64(seed))


def scattered_drive(
    seed: int, options: BarOptions = NORMAL, sensor: LandmarkSensor = SENSOR,
    laps: float = 1.0,
) -> Drive:
    """Drive through scattered bars along a rectangle."""
    rng, vehicle = generator(seed), Vehicle()
    world = scattered_bars(rng, options)
    return Drive(
        world, sensor, vehicle, *drive(world, lap(world, MARGIN_M, laps), sensor, rng, vehicle)
    )


def office_drive(seed: int, sensor: LandmarkSensor = SENSOR) -> Drive:
    """Drive round both loops of the simulated office."""
    plan = load_floor_plan('office')
    world, vehicle = floor_plan_landmarks(plan), OFFICE_VEHICLE
    tour = [plan.places[name] for name in OFFICE_TOUR]
    return Drive(world, sensor, vehicle, *drive(world, tour, sensor, generator(seed), vehicle))


def map_model(driven: Drive) -> MapModel:
    """Return the model of a map with the true standard deviations of the noise."""
    sensor, vehicle = driven.sensor, driven.vehicle
    return MapModel(
        odom_position_sd_m=vehicle.position_sd_m,
        odom_drift_sd_rad=vehicle.drift_sd_rad,
        odom_turn_sd_rad=vehicle.turn_sd_rad,
        range_sd_m=sensor.range_sd_m,
        bearing_sd_rad=sensor.bearing_sd_rad,
        direction_sd_rad=sensor.direction_sd_rad,
        length_sd_m=sensor.length_sd_m,
    )


def mapped(driven: Drive, limit: int = 0, seed: int = 0) -> Mapped:
    """Map a drive, with identifiers, in the frame of the world.

    Args:
        driven: the drive.
        limit: limit of the number of landmarks; 0: none.
        seed: of the random choice of the landmarks that fade.
    """
    memory = LandmarkMemory(limit, map_model(driven), driven.start, seed, MEMORY)
    path = np.zeros((len(driven.steps), 3))
    step_ns = round(driven.vehicle.step_m / SPEED_MPS * 1e9)
    began = time.process_time()
    for index, step in enumerate(driven.steps):
        memory.map.predict(*step.motion)
        memory.observe(step.observations, index * step_ns)
        path[index] = memory.map.pose
    ms = 1e3 * (time.process_time() - began) / len(driven.steps)
    return Mapped(driven, memory, path, ms)


def errors(world: LandmarkWorld, features: Features) -> NDArray[np.float64]:
    """Return the (n, 4) errors of x, y, direction and length."""
    found = features.values.reshape(-1, BAR_SIZE) - world.bars[features.identifiers]
    found[:, 2] = [wrap(angle) for angle in found[:, 2].tolist()]
    return found


def accuracy(result: Mapped) -> Accuracy:
    """Compare a map with the world."""
    features = result.memory.map.features()
    error = errors(result.drive.world, features)
    variance = np.diag(features.covariance).reshape(-1, BAR_SIZE)
    flat = error.ravel()
    true = np.array([step.pose for step in result.drive.steps])
    return Accuracy(
        count=len(features),
        within=float(np.mean(error**2 <= 4.0 * variance)),
        nees=float(flat @ np.linalg.solve(features.covariance, flat)) / len(flat),
        rms_m=rms(error[:, :2]),
        sd_m=math.sqrt(float(variance[:, :2].sum(axis=1).mean())),
        pose_rms_m=rms(result.path[:, :2] - true[:, :2]),
    )


def rms(offsets_m: NDArray[np.float64]) -> float:
    """Return the root of the mean squared length of (n, 2) offsets."""
    return math.sqrt(float((offsets_m**2).sum(axis=1).mean()))


MAPPING_CASES: dict[str, Callable[[int], Drive]] = {
    'normal': scattered_drive,
    'normal, 3 observations': partial(
        scattered_drive, sensor=replace(SENSOR, max_count=3)
    ),
    'normal, twice the noise': partial(
        scattered_drive, sensor=SENSOR.with_noise(2.0)
    ),
    'distinct': partial(scattered_drive, options=DISTINCT),
    'office, 2 loops': office_drive,
}
"""Worlds and sensors of the mapping experiment."""


def mapping_run(case: str, seed: int) -> Accuracy:
    """Map one world."""
    return accuracy(mapped(MAPPING_CASES[case](seed)))


def mapping(setting: Setting) -> None:
    """Print the table of the mapping experiment, and draw figure 1."""
    print('paper: the first-pass map is within 2 standard deviations of the correct map')
    print(f'{"world":24}{"landmarks":>10}{"within 2 SD":>13}{"NEES/dof":>10}{"least":>7}'
          f'{"most":>7}{"RMS [m]":>9}{"SD [m]":>8}{"vehicle [m]":>13}')
    for case in MAPPING_CASES:
        found = pooled(partial(mapping_run, case), setting.seeds)
        nees = [row.nees for row in found]
        print(
            f'{case:24}{mean(row.count for row in found):10.1f}'
            f'{mean(row.within for row in found):13.1%}{mean(nees):10.2f}{min(nees):7.2f}'
            f'{max(nees):7.2f}{mean(row.rms_m for row in found):9.2f}'
            f'{mean(row.sd_m for row in found):8.2f}{mean(row.pose_rms_m for row in found):13.2f}'
        )
    print('required: at least 93 % within 2 SD; mean NEES per degree of freedom 0.8 to 1.3')
    figure = new_figure(8.6, 5.6)
    axes = figure.subplots(1, 2)
    for panel, case in zip(axes, ('normal', 'normal, 3 observations'), strict=True):
        draw_mapped(panel, mapped(MAPPING_CASES[case](setting.seeds[0])))
        panel.set_title(case)
    add_legend_below(figure, axes[0])
    save_figure(figure, setting.out / 'landmarks_mapping.png')


def memory_run(seed: int) -> list[tuple[Accuracy, float]]:
    """Map one crowded world at all limits; return the accuracies and ms per step."""
    driven = crowded_drive(seed)
    warm_up(driven)
    results = [mapped(driven, limit, seed) for limit in LIMITS]
    return [(accuracy(result), result.ms) for result in results]


def crowded_drive(seed: int, options: BarOptions = CROWDED) -> Drive:
    """Drive two laps through a world with many more landmarks than the limits."""
    sensor = replace(SENSOR, max_count=FEW)
    return scattered_drive(seed, options, sensor, laps=2.0)


def memory(setting: Setting) -> None:
    """Print time and error at all limits, and draw figures 2 and 3."""
    print('paper: with a limit the mapping is faster, with larger variances and errors')
    print(f'{"limit":>6}{"landmarks":>11}{"ms per step":>18}{"RMS error [m]":>18}'
          f'{"SD [m]":>18}{"vehicle [m]":>18}{"within 2 SD":>13}')
    found = pooled(memory_run, setting.seeds)
    columns: dict[str, list[list[float]]] = {
        'time': [], 'error of the landmarks': [], 'their estimated SD': [],
        'error of the vehicle': [],
    }
    for index, limit in enumerate(LIMITS):
        rows = [run[index][0] for run in found]
        values = (
            [run[index][1] for run in found], [row.rms_m for row in rows],
            [row.sd_m for row in rows], [row.pose_rms_m for row in rows],
        )
        for column, value in zip(columns.values(), values, strict=True):
            column.append(value)
        print(
            f'{limit or "none":>6}{mean(row.count for row in rows):11.1f}'
            + ''.join(f'{spread(value):>18}' for value in values)
            + f'{mean(row.within for row in rows):13.1%}'
        )
    sizes = [limit or round(mean(run[-1][0].count for run in found)) for limit in LIMITS]
    figure = new_figure(9.0, 3.6)
    panels = figure.subplots(1, 2)
    for (name, column), colour, beside in zip(
        columns.items(), (BLUE, VERMILLION, GREEN, BLACK), (0.0, -1.5, 0.0, 1.5), strict=True
    ):
        panel = panels[int(name != 'time')]
        panel.errorbar(
            [size + beside for size in sizes], [mean(value) for value in column],
            [statistics.pstdev(value) for value in column],
            color=colour, marker='o', markersize=4, capsize=3, label=name,
        )
    for panel, label in zip(panels, ('CPU time per step [ms]', 'position [m]'), strict=True):
        panel.set(xlabel='limit of the number of landmarks (last: none)', ylabel=label)
        panel.set_ylim(bottom=0.0)
        panel.grid(color=PALE_GREY, linewidth=0.5)
    panels[1].legend(fontsize=8)
    save_figure(figure, setting.out / 'landmarks_memory.png')
    figure = new_figure(10.0, 4.4)
    driven = crowded_drive(setting.seeds[0])
    maps = figure.subplots(1, 3)
    for panel, limit in zip(maps, (40, 80, 0), strict=True):
        draw_mapped(panel, mapped(driven, limit, setting.seeds[0]))
        panel.set_title(f'limit of {limit} landmarks' if limit else 'no limit')
    add_legend_below(figure, maps[0])
    save_figure(figure, setting.out / 'landmarks_memory_maps.png')


@dataclass(frozen=True)
class Kidnapping:
    """Relocalisation of a robot that was carried to an unknown pose.

    Attributes:
        outcome: `right`, `wrong`, `ambiguous` or `not here`.
        error: x and y in m and heading in rad of the pose that was found, else NaN.
        pose: the pose that was found in the frame of the world, or None.
        true_pose: the pose to which it was carried.
        observed: number of observations.
        nodes: number of search nodes.
        ms: time of the search.
    """

    outcome: str
    error: tuple[float, float, float]
    pose: Pose | None
    true_pose: Pose
    observed: int
    nodes: int
    ms: float


def kidnapped(
    result: Mapped, known: KnownFeatures, world_from_map: Pose, pose: Pose,
    rng: np.random.Generator, search: RelocalisationParameters, sensor: LandmarkSensor = SENSOR,
    as_published: bool = False,
) -> Kidnapping:
    """Carry the robot to a pose, and relocalise it by the observations of one moment.

    Args:
        result: drive with its map.
        known: the map.
        world_from_map: pose of the map's frame in that of the world.
        pose: true pose.
        rng: generator for the noise of the sensor, and for the seed of the search.
        search: parameters of the search.
        sensor: sensor; its identifiers are not used.
        as_published: use ``relocalise_as_published``, which needs the true heading.
    """
    observations = observe(result.drive.world, pose, sensor, rng)
    local = LocalMap(map_model(replace(result.drive, sensor=sensor)))
    local.observe(replace(observations, identifiers=None))
    seed = int(rng.integers(2**31))
    began = time.process_time()
    nodes, error, found = 0, (math.nan,) * 3, None
    if as_published:
        features = result.memory.map.features()
        heading_rad = wrap(pose.heading_rad - world_from_map.heading_rad)
        place = relocalise_as_published(local.features(), features, heading_rad, seed)
        outcome, poses = ('not here', []) if place is None else ('found', [place.pose])
    else:
        answer = relocalise(local.features(), known, search, seed)
        outcome, nodes = answer.outcome, answer.search_nodes
        poses = [one.pose for one in answer.places]
    ms = 1e3 * (time.process_time() - began)
    if outcome == 'found':
        found = composed(world_from_map, poses[0])
        turn_rad = wrap(found.heading_rad - pose.heading_rad)
        error = found.x_m - pose.x_m, found.y_m - pose.y_m, turn_rad
        is_right = math.hypot(*error[:2]) <= RIGHT_M and abs(turn_rad) <= RIGHT_RAD
        outcome = 'right' if is_right else 'wrong'
    return Kidnapping(outcome, error, found, pose, len(observations), nodes, ms)


def map_frame(result: Mapped) -> Pose:
    """Return the pose of a map's frame in the world, by rigid alignment of the landmarks.

    The map drifts while it is made; relocalisation cannot correct this.
    """
    features = result.memory.map.features()
    frame = fit(features.positions_m, result.drive.world.bars[features.identifiers, :2])
    return Pose(frame.x_m, frame.y_m, frame.heading_rad)


def warm_up(driven: Drive) -> None:
    """Compile all loops, so that the compilation is not part of the times."""
    result = mapped(replace(driven, steps=driven.steps[:5]), LIMITS[0])
    known = KnownFeatures(result.memory.map.features())
    kidnapped(result, known, map_frame(result), driven.start, generator(0), SPARSE_SEARCH)


def memory_relocalisation_run(count: int, seed: int) -> dict[int, list[Kidnapping]]:
    """Kidnap the robot in one world, with maps of different limits.

    Args:
        count: number of landmarks in the world.
        seed: of the world, the drive and the kidnappings.
    """
    driven = crowded_drive(seed, replace(NORMAL, count=count))
    warm_up(driven)
    found = {}
    for limit in KIDNAP_LIMITS:
        result, rng = mapped(driven, limit, seed), generator(1000 + seed)
        known, frame = KnownFeatures(result.memory.map.features()), map_frame(result)
        found[limit] = [
            kidnapped(
                result, known, frame, random_pose(driven.world, rng, MARGIN_M / 2), rng,
                SPARSE_SEARCH,
            )
            for _ in range(KIDNAPS_COUNT)
        ]
    return found


def memory_relocalisation(setting: Setting) -> None:
    """Print the outcomes with and without a limit, and draw figure 4."""
    print('paper: the relocalisation succeeds with a limit of 80')
    print(f'{"world":>5}{"limit":>7}{"right":>8}{"wrong":>7}{"ambiguous":>11}{"not here":>10}'
          f'{"x [m]":>16}{"y [m]":>16}{"ms":>7}')
    for count in KIDNAP_WORLDS:
        runs = pooled(partial(memory_relocalisation_run, count), setting.seeds)
        for limit in KIDNAP_LIMITS:
            rows = [row for run in runs for row in run[limit]]
            print(f'{count:5}{limit or "none":>7}' + outcomes(rows))
    print('required: with a limit of 80, right within 5 percentage points of no limit')
    count, seed = KIDNAP_WORLDS[-1], setting.seeds[0]
    driven = crowded_drive(seed, replace(NORMAL, count=count))
    found = memory_relocalisation_run(count, seed)
    figure = new_figure(8.6, 5.6)
    panels = figure.subplots(1, 2)
    for panel, limit in zip(panels, KIDNAP_LIMITS, strict=True):
        draw_mapped(panel, mapped(driven, limit, seed))
        draw_kidnappings(panel, found[limit])
        panel.set_title(f'limit of {limit} landmarks' if limit else 'no limit')
    add_legend_below(figure, panels[1])
    save_figure(figure, setting.out / 'landmarks_memory_relocalisation.png')


def outcomes(rows: Sequence[Kidnapping]) -> str:
    """Return the shares of the outcomes, the errors and the time as columns of a table."""
    share = {
        name: sum(row.outcome == name for row in rows) / len(rows)
        for name in ('right', 'wrong', 'ambiguous', 'not here')
    }
    found = [row.error for row in rows if row.pose is not None]
    x_m, y_m = ([row[axis] for row in found] or [math.nan] for axis in (0, 1))
    return (
        f'{share["right"]:8.1%}{share["wrong"]:7.1%}{share["ambiguous"]:11.1%}'
        f'{share["not here"]:10.1%}{spread(x_m):>16}{spread(y_m):>16}'
        f'{mean(row.ms for row in rows):7.1f}'
    )


def draw_kidnappings(axes: Axes, rows: Sequence[Kidnapping]) -> None:
    """Draw true poses as crosses and found ones as discs, with their headings."""
    axes.plot([], [], 'o', color=GREEN, label='found, right')
    if any(row.outcome == 'wrong' for row in rows):
        axes.plot([], [], 'o', color=VERMILLION, label='found, wrong')
    true = np.array([row.true_pose[:2] for row in rows])
    axes.plot(*true.T, 'x', color=BLACK, markersize=7, zorder=7, label='carried to')
    for row in rows:
        is_right = row.outcome == 'right'
        if row.pose is not None:
            x_m, y_m, heading_rad = row.pose
            colour = GREEN if is_right else VERMILLION
            axes.plot(x_m, y_m, 'o', color=colour, markersize=7, zorder=6)
            axes.plot(
                [x_m, x_m + 2.5 * math.cos(heading_rad)], [y_m, y_m + 2.5 * math.sin(heading_rad)],
                color=colour, linewidth=2.0, zorder=6,
            )


def draw_mapped(axes: Axes, result: Mapped) -> None:
    """Draw a map as in figures 1 and 3 of the paper."""
    from matplotlib.collections import LineCollection, PatchCollection
    from matplotlib.patches import Circle

    world = result.drive.world
    x, y, direction, length = world.bars.T
    ends = np.stack((x + length * np.cos(direction), y + length * np.sin(direction)), axis=1)
    axes.add_collection(
        LineCollection(
            np.stack((world.bars[:, :2], ends), axis=1), colors=GREY, linewidths=0.8, zorder=2
        )
    )
    axes.plot(x, y, linestyle='', marker='*', color=BLACK, markersize=4, label='landmark')
    features = result.memory.map.features()
    radii_m = []
    for start in features.offsets[:-1]:
        block = features.covariance[start : start + 2, start : start + 2]
        radii_m.append(2.0 * math.sqrt(float(np.linalg.eigvalsh(block)[-1])))
    circles = [
        Circle((float(at[0]), float(at[1])), radius_m)
        for at, radius_m in zip(features.positions_m, radii_m, strict=True)
    ]
    axes.add_collection(
        PatchCollection(circles, facecolor='none', edgecolor=VERMILLION, linewidth=0.9, zorder=4)
    )
    axes.plot([], [], linestyle='', marker='o', markerfacecolor='none', color=VERMILLION,
              label='estimate, 2 SD')
    steps = result.drive.steps
    axes.plot(*np.array([step.planned[:2] for step in steps]).T, '--', color=GREY, linewidth=1.0,
              label='planned', zorder=5)
    axes.plot(*np.array([step.pose[:2] for step in steps]).T, color=GREEN, linewidth=1.2,
              label='driven', zorder=3)
    axes.plot(*result.path[:, :2].T, color=BLUE, linewidth=1.0, label='estimated', zorder=3)
    equal_axes(axes)


def mean(values: Sequence[float] | object) -> float:
    """Return the mean."""
    return statistics.fmean(values)  # type: ignore[arg-type]


def spread(values: Sequence[float]) -> str:
    """Return mean and standard deviation as a text."""
    return f'{mean(values):.2f} +- {float(np.std(values)):.2f}'


def relocalisation_run(case: str, seed: int) -> list[Kidnapping]:
    """Map one world, and carry the robot to random places of it."""
    options, noise, count = RELOCALISATION_CASES[case]
    result = mapped(scattered_drive(seed, options, SENSOR.with_noise(noise)))
    known, frame = KnownFeatures(result.memory.map.features()), map_frame(result)
    sensor = replace(result.drive.sensor, max_count=count)
    result = replace(result, drive=replace(result.drive, sensor=sensor))
    return kidnapped_often(result, known, frame, 1000 + seed)


def as_published_run(case: str, as_published: bool, seed: int) -> list[Kidnapping]:
    """Map a world of normal bars with other noise, and carry the robot to random places of it."""
    direction_sd_deg, length_sd_m, count = AS_PUBLISHED_CASES[case]
    sensor = replace(
        SENSOR, direction_sd_rad=math.radians(direction_sd_deg), length_sd_m=length_sd_m
    )
    result = mapped(scattered_drive(seed, NORMAL, sensor))
    known, frame = KnownFeatures(result.memory.map.features()), map_frame(result)
    result = replace(result, drive=replace(result.drive, sensor=replace(sensor, max_count=count)))
    return kidnapped_often(result, known, frame, 1000 + seed, as_published=as_published)


def unmapped_run(case: str, seed: int) -> list[Kidnapping]:
    """Map one world, and carry the robot to another one that looks like it."""
    options, noise = UNMAPPED_CASES[case]
    result = mapped(scattered_drive(seed, options, SENSOR.with_noise(noise)))
    known, frame = KnownFeatures(result.memory.map.features()), map_frame(result)
    other = scattered_bars(generator(2000 + seed), options)
    elsewhere = replace(result, drive=replace(result.drive, world=other))
    return kidnapped_often(elsewhere, known, frame, 1000 + seed)


def unmapped_plan_run(name: str, seed: int) -> list[Kidnapping]:
    """Map the western half of a floor plan, and carry the robot to the other half."""
    world = floor_plan_landmarks(load_floor_plan(FOLDER / f'{name}.txt'))
    middle_m = 0.5 * world.size_m[0]
    bars = world.bars[world.bars[:, 0] < middle_m]
    known = KnownFeatures(roughly_mapped(bars, generator(seed)))
    driven = Drive(world, replace(SENSOR, min_range_m=0.1), Vehicle(), Pose(0.0, 0.0, 0.0), [])
    memory = LandmarkMemory(0, map_model(driven), memory=MEMORY)
    result = Mapped(driven, memory, np.zeros((0, 3)), 0.0)
    return kidnapped_often(
        result, known, Pose(0.0, 0.0, 0.0), 1000 + seed, 0.0, middle_m + ENTRY_M
    )


def kidnapped_often(
    result: Mapped,
    known: KnownFeatures,
    frame: Pose,
    seed: int,
    margin_m: float = 0.5 * MARGIN_M,
    beyond_m: float = -math.inf,
    as_published: bool = False,
) -> list[Kidnapping]:
    """Carry the robot to random poses with an x of more than ``beyond_m``."""
    rng = generator(seed)
    warm_up_search(known)
    found: list[Kidnapping] = []
    while len(found) < KIDNAPS_COUNT:
        pose = random_pose(result.drive.world, rng, margin_m)
        if pose.x_m > beyond_m:
            found.append(kidnapped(
                result, known, frame, pose, rng, SEARCH, result.drive.sensor, as_published
            ))
    return found


def warm_up_search(known: KnownFeatures) -> None:
    """Load the compiled functions, so that they do not count."""
    few = Features(
        np.arange(4), BAR_SIZE * np.arange(5), known.geometry.values[:4].ravel(), 0.01 * np.eye(16)
    )
    relocalise(few, known, SEARCH, 0)


def roughly_mapped(bars: NDArray[np.float64], rng: np.random.Generator) -> Features:
    """Return a map of bars with independent errors."""
    n = len(bars)
    return Features(
        np.arange(n), BAR_SIZE * np.arange(n + 1),
        (bars + PLAN_SD * rng.standard_normal(bars.shape)).ravel(),
        np.diag(np.tile(PLAN_SD**2, n)),
    )


def relocalisation(setting: Setting) -> None:
    """Print table 1, and draw the errors."""
    print('paper: normal x -1.30 +- 20.73, y -0.58 +- 26.74; distinct x -0.12 +- 0.41, '
          'y 0.09 +- 0.39')
    print(f'{"world":26}{"seen":>6}{OUTCOME_HEADING}')
    figure = new_figure(8.0, 4.2)
    panels = figure.subplots(1, 2)
    for case in RELOCALISATION_CASES:
        runs = pooled(partial(relocalisation_run, case), setting.seeds)
        rows = [row for run in runs for row in run]
        print(f'{case:26}{mean(row.observed for row in rows):6.1f}{outcomes(rows)}')
        if RELOCALISATION_CASES[case][2] < FEW:
            continue
        errors_m = np.array([row.error[:2] for row in rows if row.pose is not None]).reshape(-1, 2)
        is_noisy = 'twice' in case
        panels[int(case.startswith('normal'))].plot(
            *errors_m.T, linestyle='', marker='x' if is_noisy else '.',
            color=VERMILLION if is_noisy else BLUE, markersize=4,
            label=f'{len(errors_m)} of {len(rows)} found' + ', twice the noise' * is_noisy,
        )
    print('required: distinct: right at least 98 %, SD at most 0.2 m, wrong 0; normal: right at '
          'least 60 %, wrong at most 1 %')
    for panel, name in zip(panels, ('distinct', 'normal'), strict=True):
        panel.set_title(name)
        panel.set_xlabel('error of x [m]')
        panel.set_ylabel('error of y [m]')
        panel.grid(color=PALE_GREY, linewidth=0.5)
        panel.legend(fontsize=8)
        panel.set_aspect('equal', 'datalim')
    save_figure(figure, setting.out / 'landmarks_relocalisation.png')


def as_published(setting: Setting) -> None:
    """Print table 1 by the relocalisation as published and by ours, with other noise."""
    print('paper: normal x -1.30 +- 20.73, y -0.58 +- 26.74; distinct x -0.12 +- 0.41, '
          'y 0.09 +- 0.39')
    print(f'{"noise":26}{"search":>12}{OUTCOME_HEADING}')
    for case in AS_PUBLISHED_CASES:
        for name, is_published in (('as published', True), ('ours', False)):
            runs = pooled(partial(as_published_run, case, is_published), setting.seeds)
            print(f'{case:26}{name:>12}{outcomes([row for run in runs for row in run])}')


def unmapped(setting: Setting) -> None:
    """Print the outcomes in regions that were never mapped, and draw them."""
    colours = {'wrong': VERMILLION, 'ambiguous': GREY, 'not here': GREEN}
    print(f'{"world":26}{"seen":>6}' + ''.join(f'{name:>11}' for name in colours) + f'{"ms":>7}')
    cases = [*UNMAPPED_CASES, *(f'{name}, other half' for name in UNMAPPED_PLANS)]
    shares = []
    for case in cases:
        run = (
            partial(unmapped_run, case) if case in UNMAPPED_CASES
            else partial(unmapped_plan_run, case.partition(',')[0])
        )
        rows = [row for rows in pooled(run, setting.seeds) for row in rows]
        share = [sum(row.outcome == name for row in rows) / len(rows) for name in colours]
        shares.append(share)
        print(f'{case:26}{mean(row.observed for row in rows):6.1f}'
              + ''.join(f'{value:11.1%}' for value in share)
              + f'{mean(row.ms for row in rows):7.1f}')
    print('required: not here in 99 %; the halves of a floor plan share rooms of equal shape')
    figure = new_figure(7.0, 3.2)
    panel = figure.subplots()
    left = np.zeros(len(cases))
    for (outcome, colour), share in zip(colours.items(), np.array(shares).T, strict=True):
        panel.barh(cases, share, left=left, color=colour, label=outcome)
        left += share
    panel.invert_yaxis()
    panel.set_xlabel('share of the kidnaps to a region never mapped')
    panel.legend(fontsize=8, loc='lower center', bbox_to_anchor=(0.5, 1.0), ncol=3)
    save_figure(figure, setting.out / 'landmarks_unmapped.png')


EFFORTS: tuple[Bound | None, ...] = ('exhaustive', 'printed', 'correct', None)
EFFORT_NAMES = 'exhaustive', 'JCBB as printed', 'JCBB', 'random sampling'


@dataclass(frozen=True)
class Effort:
    """Effort of one search.

    Attributes:
        nodes: pairs that were tested.
        ms: time without the preparation of the map.
        pairs: size of the largest set of pairs.
    """

    nodes: int
    ms: float
    pairs: int


def effort_run(job: tuple[int, int, int]) -> list[Effort]:
    """Search one map in all ways; return the efforts in the order of ``EFFORTS``."""
    seed, observation_count, feature_count = job
    rng = generator(seed)
    scale = math.sqrt(feature_count / NORMAL.count)
    size_m = NORMAL.size_m[0] * scale, NORMAL.size_m[1] * scale
    world = scattered_bars(rng, replace(NORMAL, count=feature_count, size_m=size_m))
    pose = Pose(0.5 * size_m[0], 0.5 * size_m[1], 1.0)
    distances_m = np.hypot(world.bars[:, 0] - pose.x_m, world.bars[:, 1] - pose.y_m)
    near = LandmarkWorld(world.bars[np.argsort(distances_m)[:observation_count]], size_m)
    sensor = LandmarkSensor(min_range_m=0.0, max_range_m=math.hypot(*size_m))
    driven = Drive(world, sensor, Vehicle(), pose, [])
    local = LocalMap(map_model(driven))
    local.observe(replace(observe(near, pose, sensor, rng), identifiers=None))
    seen = local.features()
    features = roughly_mapped(world.bars, rng)
    known = KnownFeatures(features)
    efforts = []
    for bound in EFFORTS:
        began = time.process_time()
        if bound is None:
            found = relocalise(seen, known, SEARCH, seed)
            nodes = found.search_nodes
            pairs = max((len(place.pairs) for place in found.places), default=0)
        else:
            searched = search_jointly_compatible(seen, features, bound=bound, max_nodes=MAX_NODES)
            nodes, pairs = searched.nodes, len(searched.pairs)
        efforts.append(Effort(nodes, 1e3 * (time.process_time() - began), pairs))
    return efforts


def effort(setting: Setting) -> None:
    """Print nodes and time of all searches, and draw them."""
    print('paper: claims that JCBB is faster than exhaustive search and random sampling faster '
          'than JCBB; no figures')
    print(f'median of {len(setting.seeds)} worlds; ">": aborted after {MAX_NODES} joint tests; '
          'pairs: mean size of the set')
    print(f'{"seen":>4}{"map":>5}' + ''.join(f'{name:>28}' for name in EFFORT_NAMES))
    print(' ' * 9 + f'{"nodes":>12}{"ms":>9}{"pairs":>7}' * len(EFFORTS))
    table: dict[tuple[int, int], list[tuple[float, float]]] = {}
    for feature_count in FEATURE_COUNTS:
        for observation_count in OBSERVATION_COUNTS:
            jobs = [(seed, observation_count, feature_count) for seed in setting.seeds]
            effort_run(jobs[0])  # compiles
            found = [effort_run(job) for job in jobs]
            line, row = f'{observation_count:4}{feature_count:5}', []
            for way in range(len(EFFORTS)):
                nodes = statistics.median(run[way].nodes for run in found)
                ms = statistics.median(run[way].ms for run in found)
                is_aborted = EFFORTS[way] is not None and nodes >= MAX_NODES
                line += f'{">" * is_aborted + format(nodes, ".0f"):>12}{ms:9.2f}'
                line += f'{mean(run[way].pairs for run in found):7.1f}'
                row.append((nodes, ms))
            table[observation_count, feature_count] = row
            print(line, flush=True)
    print('required: random sampling under 20 ms at 15 observations and 200 features')
    figure = new_figure(9.0, 3.6)
    panels = figure.subplots(1, 2)
    middle_count, middle_features = 15, 200
    for way, (name, colour) in enumerate(
        zip(EFFORT_NAMES, (GREY, VERMILLION, BLUE, GREEN), strict=True)
    ):
        panels[0].plot(
            OBSERVATION_COUNTS,
            [table[count, middle_features][way][0] for count in OBSERVATION_COUNTS],
            marker='o', markersize=4, color=colour, label=name,
        )
        panels[1].plot(
            FEATURE_COUNTS, [table[middle_count, count][way][1] for count in FEATURE_COUNTS],
            marker='o', markersize=4, color=colour, label=name,
        )
    panels[0].set_xlabel(f'observations ({middle_features} features)')
    panels[0].set_ylabel(f'nodes (aborted at {MAX_NODES})')
    panels[1].set_xlabel(f'features ({middle_count} observations)')
    panels[1].set_ylabel('CPU time [ms]')
    for panel in panels:
        panel.set_yscale('log')
        panel.grid(color=PALE_GREY, linewidth=0.5)
    panels[0].legend(fontsize=8)
    save_figure(figure, setting.out / 'landmarks_effort.png')


LASER_S = 300.0
"""Simulated time that the robot explores in the experiment laser."""


@dataclass(frozen=True)
class LaserRun:
    """Result of mapping one floor with a laser.

    Attributes:
        driven_m: way of the robot.
        landmarks: landmarks on the map.
        false: landmarks that were no corner of the plan when they were added.
        landmark_m: root mean square error of the others, after rigid alignment.
        robot_m, dead_m: root mean square error of the pose and of dead reckoning, not aligned.
        nees: mean normalised squared error of the pose per degree of freedom.
        scan_ms: mean time of a used scan.
    """

    driven_m: float
    landmarks: int
    false: int
    landmark_m: float
    robot_m: float
    dead_m: float
    nees: float
    scan_ms: float


def laser_run(job: tuple[str, int, int]) -> LaserRun:
    """Explore a floor with people and map it from odometry and scans."""
    floor, people, seed = job
    given = SimulatorParameters(plan=floor, seed=seed, people=people)
    plan = load_floor_plan(floor)
    start = parse_start('any', plan)
    simulator = Simulator(plan, start, seed, replace(given.options(), camera=None), (), people)
    exploration = Exploration(GoalFollowerParameters(), np.random.Generator(np.random.PCG64(seed)))
    laser_map = LaserMap()
    motions = MotionFromOdometry('twist')
    dead_reckoning = odometry_pose = Pose(0.0, 0.0, 0.0)
    options = simulator.options.laser
    assert options is not None  # by default
    corners = plan_corners(plan, start)
    tree = cKDTree(corners)
    corner_of: dict[int, int] = {}  # -1: none
    squared: list[tuple[float, float]] = []
    nees, times_s = [], []
    while simulator.elapsed_s < LASER_S:
        truth = composed(inverse(start), simulator.truth)
        for sample in simulator.step():
            if isinstance(sample, OdometrySample):
                reading = sample.odometry
                odometry_pose = reading.pose
                twist = Twist(reading.speed_mps, reading.turn_rate_radps)
                motion = motions.update(Odometry(sample.stamp_ns, twist, reading.pose))
                if motion is not None:
                    laser_map.integrate(motion)
                    dead_reckoning = moved(dead_reckoning, motion)
            elif isinstance(sample, ScanSample):
                ranges_m = sample.ranges_m.astype(np.float64)
                scan = Scan(sample.stamp_ns, options.first_rad, options.step_rad, ranges_m)
                began = time.perf_counter()
                is_used = laser_map.scan(scan)
                took_s = time.perf_counter() - began
                command = exploration.command(scan, odometry_pose)
                simulator.command(command.speed_mps, command.turn_rate_radps)
                squared.append(tuple(
                    (pose.x_m - truth.x_m) ** 2 + (pose.y_m - truth.y_m) ** 2
                    for pose in (laser_map.pose, dead_reckoning)
                ))
                if not is_used:
                    continue
                features = laser_map.memory.map.features()
                names = features.identifiers.tolist()
                new = [i for i, name in enumerate(names) if name not in corner_of]
                true_frame = composed(truth, inverse(laser_map.pose))
                true_m = Transform2D(*true_frame).apply(features.positions_m[new])
                distances_m, nearest = tree.query(true_m)
                for i, distance_m, corner in zip(new, distances_m, nearest, strict=True):
                    corner_of[names[i]] = int(corner) if distance_m <= FALSE_M else -1
                if laser_map.scan_count > 50:  # later than compiling
                    times_s.append(took_s)
                    error = np.subtract(laser_map.pose, truth)
                    error[2] = wrap(float(error[2]))
                    covariance = laser_map.memory.map.pose_covariance
                    nees.append(float(error @ np.linalg.solve(covariance, error)) / 3.0)
    features = laser_map.memory.map.features()
    matched = np.array([corner_of[name] for name in features.identifiers.tolist()])
    is_real = matched >= 0
    robot_m, dead_m = np.sqrt(np.mean(squared, axis=0)).tolist()
    found, true = features.positions_m[is_real], corners[matched[is_real]]
    return LaserRun(
        simulator.odometer_m, len(laser_map), int((~is_real).sum()),
        rms(fit(found, true).apply(found) - true), robot_m, dead_m, mean(nees),
        1e3 * mean(times_s),
    )


FALSE_M = 0.5
"""Distance from every corner of the plan beyond which a landmark is false when it is added."""


def plan_corners(plan: FloorPlan, start: Pose) -> NDArray[np.float64]:
    """Return the (n, 2) positions of all corners of a plan, in the frame of the start."""
    solid = plan.solid.astype(np.int64)
    around = solid[1:, 1:] + solid[1:, :-1] + solid[:-1, 1:] + solid[:-1, :-1]
    corners = (np.argwhere(around % 2 == 1)[:, ::-1] + 1) * plan.cell_m
    return Transform2D(*inverse(start)).apply(corners)


def laser(setting: Setting) -> None:
    """Print the drift of the landmark map from a simulated laser on three floors."""
    print(f'{LASER_S / 60:g} min of exploration; RMS errors in m, mean of {len(setting.seeds)} '
          'seeds (worst)')
    print(f'{"floor":8}{"people":>7}{"way m":>7}{"landmarks":>10}{"false":>7}{"landmark":>15}'
          f'{"robot":>15}{"odometry":>15}{"NEES":>6}{"ms/scan":>8}')
    for floor in FLOORS:
        for people in (0, 6):
            found = pooled(laser_run, [(floor, people, seed) for seed in setting.seeds])
            line = f'{Path(floor).stem:8}{people:7}{mean(run.driven_m for run in found):7.0f}'
            line += f'{mean(run.landmarks for run in found):10.0f}'
            line += f'{sum(run.false for run in found):7}'
            for key in ('landmark_m', 'robot_m', 'dead_m'):
                values = [getattr(run, key) for run in found]
                line += f'{mean(values):8.2f} ({max(values):.2f})'
            line += f'{mean(run.nees for run in found):6.1f}'
            print(f'{line}{mean(run.scan_ms for run in found):8.1f}', flush=True)


EXPERIMENTS: dict[str, tuple[Callable[[Setting], None], int]] = {
    'mapping': (mapping, 50),
    'memory': (memory, 20),
    'memory-relocalisation': (memory_relocalisation, 20),
    'relocalisation': (relocalisation, 20),
    'as-published': (as_published, 20),
    'unmapped': (unmapped, 20),
    'effort': (effort, 5),
    'laser': (laser, 4),
}
"""Experiments with their number of seeds."""


def main() -> None:
    """Run one experiment."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').partition('\n')[0])
    parser.add_argument('experiment', choices=EXPERIMENTS)
    parser.add_argument('--seeds', type=int, help="number of seeds (default: the experiment's)")
    parser.add_argument('--first', type=int, default=1, help='first seed (default: 1)')
    parser.add_argument('--out', type=Path, default=Path('results/landmarks'))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    experiment, count = EXPERIMENTS[options.experiment]
    began = time.perf_counter()
    first, count = options.first, options.seeds or count
    experiment(Setting(options.out, range(first, first + count)))
    print(f'{time.perf_counter() - began:.0f} s')


if __name__ == '__main__':
    main()
