# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Experiments of the memory paper in simulation: landmark mapping, memory and relocalisation.

    python benchmarks/landmarks.py mapping [--seeds 50] [--first 1] [--out results/landmarks]
    python benchmarks/landmarks.py memory | memory-relocalisation

Each experiment prints a table beside the results of the paper and draws its plots into --out. They
are described in docs/landmarks.md. One seed runs per core.
"""

from __future__ import annotations

import argparse
import math
import os
import statistics
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.config import LandmarkMapParameters
from ratslam_ros.core.config.relocalisation import RelocalisationParameters
from ratslam_ros.core.landmarks.features import BAR_SIZE, Features
from ratslam_ros.core.landmarks.landmark_memory import LandmarkMemory
from ratslam_ros.core.landmarks.local_map import LocalMap
from ratslam_ros.core.landmarks.relocalisation import KnownFeatures, relocalise
from ratslam_ros.results.plots import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    PALE_GREY,
    VERMILLION,
    equal_axes,
    new_figure,
    save_figure,
)
from ratslam_ros.simulator.floor_plan import load_floor_plan
from ratslam_ros.simulator.landmarks import (
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

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Job = TypeVar('Job')
Row = TypeVar('Row')

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

FORGET_AFTER_S = 15.0
"""Decay time of the freshness: an eighth of a lap, in which the vehicle passes a region."""


KIDNAP_WORLDS = (100, 150, 200)
"""Numbers of landmarks in the worlds of memory-relocalisation."""

KIDNAP_LIMITS = (80, 0)
"""Limits of memory-relocalisation, as in figure 4 of the paper; 0: none."""

KIDNAPS_COUNT = 10
"""Kidnappings per seed."""

SPARSE_SEARCH = RelocalisationParameters(reloc_share=0.15, reloc_draws=5000)
"""Search of a map that may have forgotten most of the landmarks in view."""

RIGHT_M, RIGHT_RAD = 1.0, math.radians(10.0)
"""Largest errors of a relocalisation that counts as right."""


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
) -> Drive:  # fmt: skip
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


def map_parameters(driven: Drive, limit: int = 0) -> LandmarkMapParameters:
    """Return parameters of a map with the true standard deviations of the noise."""
    sensor, vehicle = driven.sensor, driven.vehicle
    return LandmarkMapParameters(
        lm_odom_position_sd_m=vehicle.position_sd_m,
        lm_odom_drift_sd_rad=vehicle.drift_sd_rad,
        lm_odom_turn_sd_rad=vehicle.turn_sd_rad,
        lm_range_sd_m=sensor.range_sd_m,
        lm_bearing_sd_rad=sensor.bearing_sd_rad,
        lm_direction_sd_rad=sensor.direction_sd_rad,
        lm_length_sd_m=sensor.length_sd_m,
        lm_max=limit,
        forget_after_s=FORGET_AFTER_S,
    )


def mapped(driven: Drive, limit: int = 0, seed: int = 0) -> Mapped:
    """Map a drive, with identifiers, in the frame of the world.

    Args:
        driven: the drive.
        limit: limit of the number of landmarks; 0: none.
        seed: of the random choice of the landmarks that fade.
    """
    memory = LandmarkMemory(map_parameters(driven, limit), driven.start, seed)
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
}  # fmt: skip
"""Worlds and sensors of the mapping experiment."""


def mapping_run(case: str, seed: int) -> Accuracy:
    """Map one world."""
    return accuracy(mapped(MAPPING_CASES[case](seed)))


def mapping(setting: Setting) -> None:
    """Print the table of the mapping experiment, and draw figure 1."""
    print('paper: the first-pass map is within 2 standard deviations of the correct map')
    print(f'{"world":24}{"landmarks":>10}{"within 2 SD":>13}{"NEES/dof":>10}{"least":>7}'
          f'{"most":>7}{"RMS [m]":>9}{"SD [m]":>8}{"vehicle [m]":>13}')  # fmt: skip
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
    axes[0].legend(loc='upper right', fontsize=7)
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
          f'{"SD [m]":>18}{"vehicle [m]":>18}{"within 2 SD":>13}')  # fmt: skip
    found = pooled(memory_run, setting.seeds)
    columns: dict[str, list[list[float]]] = {
        'time': [], 'error of the landmarks': [], 'their estimated SD': [],
        'error of the vehicle': [],
    }  # fmt: skip
    for index, limit in enumerate(LIMITS):
        rows = [run[index][0] for run in found]
        values = (
            [run[index][1] for run in found], [row.rms_m for row in rows],
            [row.sd_m for row in rows], [row.pose_rms_m for row in rows],
        )  # fmt: skip
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
    for (name, column), colour in zip(
        columns.items(), (BLUE, VERMILLION, GREEN, BLACK), strict=True
    ):
        panel = panels[int(name != 'time')]
        panel.errorbar(
            sizes, [mean(value) for value in column],
            [statistics.pstdev(value) for value in column],
            color=colour, marker='o', markersize=4, capsize=3, label=name,
        )  # fmt: skip
    for panel, label in zip(panels, ('CPU time per step [ms]', 'position [m]'), strict=True):
        panel.set(xlabel='limit of the number of landmarks (last: none)', ylabel=label)
        panel.set_ylim(bottom=0.0)
        panel.grid(color=PALE_GREY, linewidth=0.5)
    panels[1].legend(fontsize=8)
    save_figure(figure, setting.out / 'landmarks_memory.png')
    figure = new_figure(10.0, 4.4)
    driven = crowded_drive(setting.seeds[0])
    for panel, limit in zip(figure.subplots(1, 3), (40, 80, 0), strict=True):
        draw_mapped(panel, mapped(driven, limit, setting.seeds[0]))
        panel.set_title(f'limit of {limit} landmarks' if limit else 'no limit')
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
) -> Kidnapping:  # fmt: skip
    """Carry the robot to a pose, and relocalise it by the observations of one moment.

    Args:
        result: drive with its map.
        known: the map.
        world_from_map: pose of the map's frame in that of the world.
        pose: true pose.
        rng: generator for the noise of the sensor, and for the seed of the search.
        search: parameters of the search.
        sensor: sensor; its identifiers are not used.
    """
    observations = observe(result.drive.world, pose, sensor, rng)
    local = LocalMap(map_parameters(replace(result.drive, sensor=sensor)))
    local.observe(replace(observations, identifiers=None))
    seed = int(rng.integers(2**31))
    began = time.process_time()
    answer = relocalise(local.features(), known, search, seed)
    ms = 1e3 * (time.process_time() - began)
    outcome, error, found = answer.outcome, (math.nan,) * 3, None
    if outcome == 'found':
        found = composed(world_from_map, answer.places[0].pose)
        turn_rad = wrap(found.heading_rad - pose.heading_rad)
        error = found.x_m - pose.x_m, found.y_m - pose.y_m, turn_rad
        is_right = math.hypot(*error[:2]) <= RIGHT_M and abs(turn_rad) <= RIGHT_RAD
        outcome = 'right' if is_right else 'wrong'
    return Kidnapping(outcome, error, found, pose, len(observations), answer.search_nodes, ms)


def map_frame(result: Mapped) -> Pose:
    """Return the pose of a map's frame in the world, by rigid alignment of the landmarks.

    The map drifts while it is made; relocalisation cannot correct this.
    """
    features = result.memory.map.features()
    found, true = features.positions_m, result.drive.world.bars[features.identifiers, :2]
    a, b = found - found.mean(axis=0), true - true.mean(axis=0)
    turn_rad = math.atan2(
        float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum())
    )
    centre = composed(Pose(0.0, 0.0, turn_rad), Pose(*found.mean(axis=0).tolist(), 0.0))
    x_m, y_m = true.mean(axis=0).tolist()
    return Pose(x_m - centre.x_m, y_m - centre.y_m, turn_rad)


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
        ]  # fmt: skip
    return found


def memory_relocalisation(setting: Setting) -> None:
    """Print the outcomes with and without a limit, and draw figure 4."""
    print('paper: the relocalisation succeeds with a limit of 80')
    print(f'{"world":>5}{"limit":>7}{"right":>8}{"wrong":>7}{"ambiguous":>11}{"not here":>10}'
          f'{"x [m]":>16}{"y [m]":>16}{"ms":>7}')  # fmt: skip
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
    for panel, limit in zip(figure.subplots(1, 2), KIDNAP_LIMITS, strict=True):
        draw_mapped(panel, mapped(driven, limit, seed))
        draw_kidnappings(panel, found[limit])
        panel.set_title(f'limit of {limit} landmarks' if limit else 'no limit')
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
    for row in rows:
        is_right = row.outcome == 'right'
        axes.plot(row.true_pose.x_m, row.true_pose.y_m, 'x', color=BLACK, markersize=7, zorder=7)
        if row.pose is not None:
            x_m, y_m, heading_rad = row.pose
            colour = GREEN if is_right else VERMILLION
            axes.plot(x_m, y_m, 'o', color=colour, markersize=7, zorder=6)
            axes.plot(
                [x_m, x_m + 2.5 * math.cos(heading_rad)], [y_m, y_m + 2.5 * math.sin(heading_rad)],
                color=colour, linewidth=2.0, zorder=6,
            )  # fmt: skip


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
              label='estimate, 2 SD')  # fmt: skip
    steps = result.drive.steps
    axes.plot(*np.array([step.planned[:2] for step in steps]).T, '--', color=GREY, linewidth=1.0,
              label='planned', zorder=5)  # fmt: skip
    axes.plot(*np.array([step.pose[:2] for step in steps]).T, color=GREEN, linewidth=1.2,
              label='driven', zorder=3)  # fmt: skip
    axes.plot(*result.path[:, :2].T, color=BLUE, linewidth=1.0, label='estimated', zorder=3)
    equal_axes(axes)


def mean(values: Sequence[float] | object) -> float:
    """Return the mean."""
    return statistics.fmean(values)  # type: ignore[arg-type]


def spread(values: Sequence[float]) -> str:
    """Return mean and standard deviation as a text."""
    return f'{mean(values):.2f} +- {statistics.pstdev(values):.2f}'


def pooled(run: Callable[[Job], Row], jobs: Sequence[Job]) -> list[Row]:
    """Run jobs in parallel on all cores; return their rows in order."""
    with ProcessPoolExecutor(min(os.cpu_count() or 1, len(jobs))) as pool:
        return list(pool.map(run, jobs))


EXPERIMENTS: dict[str, tuple[Callable[[Setting], None], int]] = {
    'mapping': (mapping, 50),
    'memory': (memory, 20),
    'memory-relocalisation': (memory_relocalisation, 20),
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
