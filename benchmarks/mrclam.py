# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stochastic mapping and relocalisation of five real robots among landmarks (UTIAS MRCLAM).

    python benchmarks/mrclam.py [--data ../shared/data/mrclam_6] [--mapping]

Leung, Halpern, Barfoot and Liu: the UTIAS multi-robot cooperative localization and mapping
dataset, International Journal of Robotics Research 30(8), 2011. Each robot maps the landmarks by
their barcodes. The errors are those after rigid alignment of the landmarks with their true
positions; the robot's are those of the pose at the time, not smoothed afterwards.

Then the drive is cut: 60 s of odometry and observations are left out. The robot is relocalised
on its map of the time of the cut by observations without barcodes (`--mapping` omits this). It
may drive for another 60 s until a place is found whose position has a standard deviation of at
most a third of a metre. A place more than 1 m or 30 degrees off is wrong.

One setting of the noise serves for all robots. The ratios of its standard deviations are round
values for a wheeled robot whose odometry is the commanded speed, and for a camera (`UNIT`). Their
common factor makes the innovations consistent (`FACTOR`): the robot with the largest ones has no
more beyond the 99 % quantile of the chi-square distribution than expected. This needs no ground
truth. The table lists the factor that the other four robots require.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.landmarks.features import Features, Observations
from ratslam_ros.core.landmarks.local_map import LocalMap
from ratslam_ros.core.landmarks.models import MapModel
from ratslam_ros.core.landmarks.place_search import RelocalisationParameters
from ratslam_ros.core.landmarks.relocalisation import relocalise
from ratslam_ros.core.landmarks.stochastic_map import StochasticMap
from ratslam_ros.results.evaluation import Transform2D, fit

ROOT = Path(__file__).resolve().parents[1]
ROBOTS = 1, 2, 3, 4, 5

UNIT = MapModel(
    odom_position_sd_m=0.05, odom_drift_sd_rad=0.05, odom_turn_sd_rad=0.1,
    range_sd_m=0.1, bearing_sd_rad=0.01, repeat_m=0.3, local_m=3.0,
)
FACTOR = 2.5
"""Factor of all standard deviations in `UNIT`. The errors of odometry and camera have long tails,
which a Gaussian covers only if it is wider than their bulk."""

QUANTILE_99 = -2.0 * math.log(0.01)
"""99 % quantile of the chi-square distribution with two degrees of freedom."""

MOMENT_S = 0.02
"""Observations within this time come from one image; their stamps differ by a millisecond."""

CUT_S, CUT_EVERY_S, FIRST_CUT_S = 60.0, 40.0, 240.0
"""Length of a cut, and the time between the beginnings of the cuts."""

ATTEMPT_EVERY_M, PATIENCE_S = 1.0, 60.0
"""Travel between attempts to relocalise (1 rad counts as 1 m), and time for them."""

WRONG_M, WRONG_RAD = 1.0, math.radians(30.0)
"""A relocalisation with a larger error is wrong."""

LARGEST_SD_M = WRONG_M / 3.0
"""A place that is known less accurately is not accepted."""

Step = tuple[float, Motion | Observations]
"""Time in s, and a motion that ends then, or landmarks that are seen then."""


@dataclass(frozen=True)
class Log:
    """Recorded data of one robot; times in s since the first odometry.

    Attributes:
        odometry: (n, 3) time, forward speed in m/s, turn rate in rad/s.
        measurements: (m, 4) time, landmark, range in m, bearing in rad.
        truth: (k, 4) time, x, y in m, heading in rad without jumps.
    """

    odometry: NDArray[np.float64]
    measurements: NDArray[np.float64]
    truth: NDArray[np.float64]

    def true_poses(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (n, 3) true poses; NaN outside of the ground truth."""
        columns = [
            np.interp(times_s, self.truth[:, 0], column, np.nan, np.nan)
            for column in self.truth[:, 1:].T
        ]
        return np.stack(columns, axis=1)

    def steps(self, start_s: float = -math.inf, end_s: float = math.inf) -> Iterator[Step]:
        """Yield the motions and observations between two times, in their order.

        A speed holds until the next message. The motions are divided at the observations.
        """
        seen = self.measurements[:, 0]
        moments = np.flatnonzero(np.diff(seen, prepend=-np.inf) > MOMENT_S)
        ends = np.append(moments[1:], len(seen))
        now = max(start_s, float(self.odometry[0, 0]))
        following = int(np.searchsorted(seen[moments], now))
        until = np.append(self.odometry[1:, 0], self.odometry[-1, 0])
        for (_, speed, rate), end in zip(self.odometry, np.minimum(until, end_s), strict=True):
            while following < len(moments) and seen[moments[following]] < end:
                at = float(seen[moments[following]])
                if at > now:
                    yield at, Motion(at - now, speed * (at - now), rate * (at - now))
                    now = at
                yield at, self._observations(moments[following], ends[following])
                following += 1
            if end > now:
                yield float(end), Motion(end - now, speed * (end - now), rate * (end - now))
                now = float(end)

    def _observations(self, first: int, end: int) -> Observations:
        rows = self.measurements[first:end]
        _, unique = np.unique(rows[:, 1], return_index=True)
        rows = rows[np.sort(unique)]
        return Observations(rows[:, 2:4], rows[:, 1].astype(np.int64))


@dataclass(frozen=True)
class Drive:
    """Map of one robot after its drive, and its errors.

    Attributes:
        landmark_m, robot_m: root mean square errors after rigid alignment of the landmarks.
        squared: squared innovations, each with two degrees of freedom.
        outliers: share of rejected observations.
    """

    landmark_m: float
    robot_m: float
    squared: NDArray[np.float64]
    outliers: float


def scaled(factor: float) -> MapModel:
    """Return `UNIT` with all standard deviations multiplied."""
    names = [one.name for one in fields(UNIT) if '_sd_' in one.name]
    return replace(UNIT, **{name: factor * getattr(UNIT, name) for name in names})


def read_logs(
    folder: Path, robots: Iterable[int] = ROBOTS
) -> tuple[dict[int, Log], dict[int, NDArray[np.float64]]]:
    """Read the logs of robots, and the true positions of the landmarks by their number.

    Unknown barcodes, which were misread, and the other robots, which move, are dropped.
    """
    subjects = {int(code): int(subject) for subject, code in _table(folder / 'Barcodes.dat')}
    positions = {int(row[0]): row[1:3] for row in _table(folder / 'Landmark_Groundtruth.dat')}
    tables = {
        robot: [
            _table(folder / f'Robot{robot}_{name}.dat')
            for name in ('Odometry', 'Measurement', 'Groundtruth')
        ]
        for robot in robots
    }
    begin = min(odometry[0, 0] for odometry, _, _ in tables.values())
    logs = {}
    for robot, (odometry, measurements, truth) in tables.items():
        numbers = np.array([subjects.get(int(code), -1) for code in measurements[:, 1]])
        measurements[:, 1] = numbers
        truth = truth[np.unique(truth[:, 0], return_index=True)[1]]
        truth[:, 3] = np.unwrap(truth[:, 3])
        for table in (odometry, measurements, truth):
            table[:, 0] -= begin
        logs[robot] = Log(odometry, measurements[np.isin(numbers, list(positions))], truth)
    return logs, positions


def _table(path: Path) -> NDArray[np.float64]:
    return np.loadtxt(path, ndmin=2)


def move(target: StochasticMap | LocalMap, motion: Motion) -> None:
    """Predict by a motion on an arc."""
    end = moved(Pose(0.0, 0.0, 0.0), motion)
    target.predict(end.x_m, end.y_m, end.heading_rad)


def alignment(
    estimated: Features, positions: dict[int, NDArray[np.float64]]
) -> Transform2D:
    """Return the rigid alignment of the estimated landmarks with their true positions."""
    true = np.array([positions[name] for name in estimated.identifiers.tolist()])
    return fit(estimated.positions_m, true)


def rms(errors: NDArray[np.float64]) -> float:
    """Return the root of the mean squared length of (n, 2) errors; NaN rows are left out."""
    return float(np.sqrt(np.nanmean((errors**2).sum(axis=1))))


def drive(
    log: Log, positions: dict[int, NDArray[np.float64]], parameters: MapModel
) -> Drive:
    """Map the landmarks by their barcodes, and compare with the ground truth."""
    built, path, squared, count = StochasticMap(parameters), [], [], 0
    for time_s, step in log.steps():
        if isinstance(step, Motion):
            move(built, step)
            path.append((time_s, *built.pose))
        else:
            squared.append(built.observe(step).squared)
            count += len(step)
    innovations = np.concatenate(squared)
    features, poses = built.features(), np.array(path)
    frame = alignment(features, positions)
    true = np.array([positions[name] for name in features.identifiers.tolist()])
    return Drive(
        rms(frame.apply(features.positions_m) - true),
        rms(frame.apply(poses[:, 1:3]) - log.true_poses(poses[:, 0])[:, :2]),
        innovations[~np.isnan(innovations)],
        built.outlier_count / count,
    )


def required_factor(drives: list[Drive], factor: float) -> float:
    """Return the factor for which all these drives have no more large innovations than expected.

    Args:
        drives: drives with the standard deviations of `UNIT` times ``factor``.
        factor: see above.
    """
    worst = max(float(np.quantile(drive.squared, 0.99)) for drive in drives)
    return factor * math.sqrt(worst / QUANTILE_99)


@dataclass(frozen=True)
class Relocation:
    """Outcome of relocalisation after one cut: `correct`, `wrong`, `ambiguous` or `not here`."""

    outcome: str
    error_m: float
    after_s: float


def relocations(
    log: Log, positions: dict[int, NDArray[np.float64]], parameters: MapModel,
    search: RelocalisationParameters,
) -> Iterator[Relocation]:
    """Cut the drive again and again, and relocalise without barcodes after each cut."""
    built = StochasticMap(parameters)
    cuts = iter(np.arange(FIRST_CUT_S, log.odometry[-1, 0] - CUT_S - PATIENCE_S, CUT_EVERY_S))
    cut_s = next(cuts, math.inf)
    for time_s, step in log.steps():
        if time_s >= cut_s:
            yield relocation(
                log, built.features(), alignment(built.features(), positions),
                parameters, search, cut_s + CUT_S,
            )
            cut_s = next(cuts, math.inf)
        if isinstance(step, Motion):
            move(built, step)
        else:
            built.observe(step)


def relocation(
    log: Log, known: Features, frame: Transform2D, parameters: MapModel,
    search: RelocalisationParameters, start_s: float,
) -> Relocation:
    """Relocalise from a time on, until a place is found or the patience ends.

    Args:
        log: the drive.
        known: the map.
        frame: its alignment with the true frame.
        parameters: of the local map.
        search: of relocalisation.
        start_s: end of the cut.
    """
    local, outcome, since_m = LocalMap(parameters), 'not here', math.inf
    for time_s, step in log.steps(start_s, start_s + PATIENCE_S):
        if isinstance(step, Motion):
            move(local, step)
            since_m += abs(step.distance_m) + abs(step.turn_rad)
            continue
        local.observe(replace(step, identifiers=None))
        if since_m < ATTEMPT_EVERY_M:
            continue
        since_m = 0.0
        result = relocalise(local.features(), known, search, seed=1)
        outcome = result.outcome
        if outcome != 'found':
            continue
        (x, y, heading), covariance = result.places[0].pose, result.places[0].covariance
        if math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[-1])) > LARGEST_SD_M:
            outcome = 'ambiguous'
            continue
        true = log.true_poses(np.array([time_s]))[0]
        error = frame.apply(np.array([[x, y]]))[0] - true[:2]
        error_m = float(np.hypot(*error))
        turn = abs(wrap(heading + frame.heading_rad - float(true[2])))
        is_wrong = error_m > WRONG_M or turn > WRONG_RAD
        return Relocation('wrong' if is_wrong else 'correct', error_m, time_s - start_s)
    return Relocation(outcome, math.nan, PATIENCE_S)


def mapping_table(
    logs: dict[int, Log], positions: dict[int, NDArray[np.float64]]
) -> Iterator[str]:
    """Map with every robot; yield the lines of the table."""
    yield f'{"robot":8}{"landmarks":>11}{"robot":>9}{"outliers":>10}{"factor by others":>18}'
    yield f'{"":8}{"RMS m":>11}{"RMS m":>9}{"%":>10}'
    drives = {robot: drive(logs[robot], positions, scaled(FACTOR)) for robot in ROBOTS}
    for robot, result in drives.items():
        factor = required_factor([drives[other] for other in ROBOTS if other != robot], FACTOR)
        yield (
            f'{robot:<8}{result.landmark_m:11.3f}{result.robot_m:9.2f}'
            f'{100.0 * result.outliers:10.2f}{factor:18.2f}'
        )
    landmark_m = [result.landmark_m for result in drives.values()]
    robot_m = [result.robot_m for result in drives.values()]
    yield f'{"mean":8}{np.mean(landmark_m):11.3f}{np.mean(robot_m):9.2f}'
    yield f'{"largest":8}{max(landmark_m):11.3f}{max(robot_m):9.2f}'
    yield 'required: landmarks at most 0.12 on average and 0.20 at worst, robot 0.65 on average'


def relocation_table(
    logs: dict[int, Log], positions: dict[int, NDArray[np.float64]]
) -> Iterator[str]:
    """Relocalise after all cuts of every robot; yield the lines of the table."""
    outcomes = 'correct', 'wrong', 'ambiguous', 'not here'
    yield f'{"robot":8}{"cuts":>6}' + ''.join(f'{name:>11}' for name in outcomes) + (
        f'{"error m":>10}{"after s":>9}'
    )
    everything: list[Relocation] = []
    for robot in (*ROBOTS, 0):
        if robot:
            results = list(
                relocations(logs[robot], positions, scaled(FACTOR), RelocalisationParameters())
            )
            everything += results
        else:
            results = everything
        right = [result for result in results if result.outcome == 'correct']
        counts = (sum(result.outcome == name for result in results) for name in outcomes)
        yield (
            f'{robot or "all":<8}{len(results):6}' + ''.join(f'{count:11}' for count in counts)
            + (f'{np.median([result.error_m for result in right]):10.2f}' if right else '')
            + (f'{np.median([result.after_s for result in right]):9.0f}' if right else '')
        )
    yield 'required: wrong in at most 2 %; errors and times are medians of the correct ones'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared/data/mrclam_6')
    parser.add_argument('--mapping', action='store_true', help='without relocalisation')
    options = parser.parse_args()
    if not (options.data / 'Barcodes.dat').is_file():
        sys.exit(f'{options.data} has no Barcodes.dat; expected a folder of the MRCLAM series')
    logs, positions = read_logs(options.data)
    tables = [mapping_table] if options.mapping else [mapping_table, relocation_table]
    for table in tables:
        for line in table(logs, positions):
            print(line, flush=True)
        print()


if __name__ == '__main__':
    main()
