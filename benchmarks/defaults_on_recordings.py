# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Maps with no configuration: what a first replay of a recording reaches, against targets.

    python benchmarks/defaults_on_recordings.py [--data ../shared/data] [--only ROW ...]
    python benchmarks/defaults_on_recordings.py --recording FOLDER [--tolerance FRAMES]

Nothing is set by hand: every row is what `ratslam replay RECORDING` does without a configuration,
the inspection of the recording included. --config NAME evaluates a preset or a file instead, which
is not followed by an inspection; --no-inspect leaves it out for the defaults as well.

Laps (rc_car_loops, donkeycar_track, lab_car, and any recording given by --recording). The folder
holds a recording and `lap_phase.csv`, with the lap and the place on the lap, `ref_frame`, of each
frame; two frames show the same place if their `ref_frame` is equal. The number of different values
is the length of a lap in frames. `presets_on_recordings.py` defines precision, recall and the
spread of the map. Three more measures use the complete laps, from one first frame of a lap to the
next:
- lap rotation: heading change over a lap in dead_reckoning.tum, unwrapped, in degrees. It is a
  whole turn if the field of view of the camera, or the gain of the gyro, is right.
- laps: rotation over all complete laps in whole turns; compared with their number.
- heading one lap later: median over all frames of the absolute heading difference on
  trajectory_final.tum between the frame and that of the same place in the next lap, in degrees.

lecture_hall: errors of trajectory_final as in `lecture_hall.py`, with nothing set, and over the 12
combinations of four injection energies and three cell sizes.

corridors: top-1 as in `place_recognition.py`, with the same parameters for both.

demo: errors of the final map over the simulated recordings of `ratslam demo`, and those of the
preset openratslam on the same recordings.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import math
import statistics
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import lecture_hall
import numpy as np
from numpy.typing import NDArray
from place_recognition import circuit_top_1, lap_recognition, vpr_top_1
from presets_on_recordings import ROOT, map_spread, read_frames

from ratslam_ros.core.config import Config
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.errors import RatslamError
from ratslam_ros.files.config import ORIGINAL, load_config, parse_setting
from ratslam_ros.offline.inspection import inspect
from ratslam_ros.offline.replay import ReplayOptions
from ratslam_ros.offline.replay import replay as replay_recording
from ratslam_ros.recordings import open_recording
from ratslam_ros.results.evaluation import evaluate
from ratslam_ros.results.trajectory import read_tum
from ratslam_simulator.recording import write_recording

TOLERANCE_FRAMES = 8
"""Largest distance between frames of the same place, unless a recording states another."""

MEAN_LAP_DEG, EACH_LAP_DEG = 5.0, 30.0
"""Largest deviation from 360 degrees, of the mean lap and of every lap."""

HEADING_DEG = 10.0
"""Largest median heading difference at the same place one lap later."""

ENERGIES, CELLS_M = (0.03, 0.07, 0.15, 0.24), (0.5, 1.0, 2.0)
"""Injection energies and cell sizes that are set on top for lecture_hall."""


@dataclass(frozen=True)
class Row:
    """One line of the table: a measure, and the bounds that it must keep."""

    recording: str
    measure: str
    value: float
    low: float = -math.inf
    high: float = math.inf
    digits: int = 3

    @property
    def passed(self) -> bool:
        """Whether the value is within the bounds."""
        return self.low <= self.value <= self.high

    def format(self) -> str:
        """Format the row; it has no verdict if it has no bounds."""
        bounds = []
        if self.low > -math.inf:
            bounds.append(f'>= {self.low:g}')
        if self.high < math.inf:
            bounds.append(f'<= {self.high:g}')
        verdict = ('pass' if self.passed else 'FAIL') if bounds else ''
        return (
            f'{self.recording:16} {self.measure:34} {self.value:9.{self.digits}f}   '
            f'{", ".join(bounds):18} {verdict}'
        ).rstrip()


@dataclass(frozen=True)
class LapRecording:
    """A recording of laps, and its targets.

    tolerance: largest distance between frames of the same place, in frames. turns: whether the
    rotation of the laps has targets, which requires odometry without a nominal part.
    """

    folder: Path
    tolerance: int = TOLERANCE_FRAMES
    precision: float = 0.96
    recall: float = 0.82
    spread: float = 0.025
    turns: bool = False


def lap_recordings(data: Path) -> list[LapRecording]:
    """Return the recordings of laps in the data folder, with their targets."""
    return [
        LapRecording(data / 'rc_car_loops', 8, 0.97, 0.88, 0.025),
        LapRecording(data / 'donkeycar_track', 5, 0.96, 0.82, 0.008),
        LapRecording(data / 'lab_car', 8, 0.97, 0.90, 0.015, turns=True),
    ]


@dataclass(frozen=True)
class LapPhase:
    """Columns of lap_phase.csv, (n,) each: number of the lap, and place on it."""

    lap: NDArray[np.int64]
    place: NDArray[np.int64]

    @property
    def lap_length(self) -> int:
        """Length of a lap in frames."""
        return len(np.unique(self.place))

    @property
    def lap_starts(self) -> list[int]:
        """First frames of all laps but the first one, which may be incomplete."""
        return [int(i) for i in np.flatnonzero(np.diff(self.lap) > 0) + 1]


def read_lap_phase(path: Path) -> LapPhase:
    """Read laps and places."""
    with open(path, newline='') as file:
        rows = list(csv.DictReader(file))
    return LapPhase(
        np.array([int(row['lap']) for row in rows]),
        np.array([int(row['ref_frame']) for row in rows]),
    )


def headings_deg(folder: Path, trajectory: str) -> NDArray[np.float64]:
    """Return the unwrapped heading of a trajectory at each frame, in degrees."""
    path = read_tum(folder / f'{trajectory}.tum')
    stamp_ns = read_frames(folder / 'frames.csv').stamp_ns
    since = stamp_ns[0]
    unwrapped = np.unwrap(path.heading_rad)
    return np.degrees(np.interp(stamp_ns - since, path.stamp_ns - since, unwrapped))


def lap_rotations(folder: Path, phase: LapPhase) -> NDArray[np.float64]:
    """Return the rotation of each complete lap in dead reckoning, in degrees."""
    return np.diff(headings_deg(folder, 'dead_reckoning')[phase.lap_starts])


def heading_one_lap_later(folder: Path, phase: LapPhase) -> float:
    """Return the median heading difference at the same place one lap later, in degrees."""
    heading = headings_deg(folder, 'trajectory_final')
    mean = {
        (lap, place): _mean_deg(heading[(phase.lap == lap) & (phase.place == place)])
        for lap, place in set(zip(phase.lap.tolist(), phase.place.tolist(), strict=True))
    }
    apart = [
        abs((mean[lap + 1, place] - value + 180.0) % 360.0 - 180.0)
        for (lap, place), value in mean.items()
        if (lap + 1, place) in mean
    ]
    return float(np.median(apart))


def _mean_deg(angles_deg: NDArray[np.float64]) -> float:
    angles = np.radians(angles_deg)
    return math.degrees(math.atan2(np.sin(angles).sum(), np.cos(angles).sum()))


@dataclass(frozen=True)
class Setup:
    """Configuration of all rows, and whether each recording is inspected first."""

    config: Config
    look_ahead: bool
    fixed: tuple[str, ...] = ()
    """Parameters that the inspection keeps."""

    def replay(self, path: Path, out: Path, **values: float) -> dict[str, Any]:
        """Replay a recording as without a configuration; return the content of summary.json.

        Args:
            path: the recording.
            out: folder for the results.
            values: parameters of the pose cells that are set on top.
        """
        given = {f'pose_cells.{name}': value for name, value in values.items()}
        config = self.config.with_values(given)
        with open_recording(path) as recording:
            selection = recording.select()
            if self.look_ahead:
                inspection = inspect(recording, selection, config, (*self.fixed, *given))
                config = inspection.config
                for line in inspection.lines if not given else ():
                    print(f'{path.name:16} {line}')
            options = ReplayOptions(progress=False)
            return replay_recording(recording, selection, config, out, options).summary


def lap_rows(laps: LapRecording, setup: Setup) -> Iterator[Row]:
    """Replay a recording of laps; yield its results."""
    name = laps.folder.name
    lap_phase_csv = laps.folder / 'lap_phase.csv'
    phase = read_lap_phase(lap_phase_csv)
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary)
        summary = setup.replay(laps.folder, out)
        ids = read_frames(out / 'frames.csv').template_id
        precision, recall = lap_recognition(ids, lap_phase_csv, laps.tolerance, phase.lap_length)
        yield Row(name, 'precision', precision, low=laps.precision)
        yield Row(name, 'recall', recall, low=laps.recall)
        spread = map_spread(out, 'trajectory_final', lap_phase_csv)
        yield Row(name, 'spread of the map', spread, high=laps.spread, digits=4)
        rotations = lap_rotations(out, phase)
        heading_deg = heading_one_lap_later(out, phase)
    for row in rotation_rows(name, rotations, heading_deg):
        yield row if laps.turns else replace(row, low=-math.inf, high=math.inf)
    for measure in ('templates', 'experiences', 'loop_closures'):
        yield Row(name, measure.replace('_', ' '), summary[measure], digits=0)
    yield Row(name, 'times real time', summary['times_realtime'], digits=0)


def rotation_rows(
    name: str, rotations: NDArray[np.float64], heading_deg: float
) -> Iterator[Row]:
    """Yield the rows on rotation: of complete laps in dead reckoning, and on the map."""
    if len(rotations):
        count = len(rotations)
        rotations = rotations * math.copysign(1.0, rotations.sum())
        turns = rotations.sum() / 360.0
        yield Row(name, f'laps, {count} in truth', turns, count - 0.5, count + 0.5, 2)
        yield Row(name, 'lap rotation, mean [deg]', rotations.mean(),
                  360.0 - MEAN_LAP_DEG, 360.0 + MEAN_LAP_DEG, 1)
        yield Row(name, 'lap rotation, least [deg]', rotations.min(), 360.0 - EACH_LAP_DEG,
                  digits=1)
        yield Row(name, 'lap rotation, largest [deg]', rotations.max(),
                  high=360.0 + EACH_LAP_DEG, digits=1)
    yield Row(name, 'heading one lap later [deg]', heading_deg, high=HEADING_DEG, digits=1)


def lecture_hall_rows(data: Path, setup: Setup) -> Iterator[Row]:
    """Yield the errors on lecture_hall."""
    name = 'lecture_hall'
    with tempfile.TemporaryDirectory() as temporary:
        recording, truth_path = lecture_hall.convert(data, Path(temporary))
        truth, out = read_tum(truth_path), Path(temporary) / 'results'

        def error_m(**values: float) -> float:
            setup.replay(recording, out, **values)
            return evaluate(read_tum(out / 'trajectory_final.tum'), truth).ate.rmse

        yield Row(name, 'ATE [m]', error_m(), high=0.70)
        errors_m = []
        for energy, cell_m in itertools.product(ENERGIES, CELLS_M):
            error = error_m(pc_vt_inject_energy=energy, pc_cell_x_size=cell_m)
            errors_m.append(error)
            yield Row(name, f'ATE, energy {energy}, cells {cell_m} m', error)
        yield Row(name, 'ATE, median of 12 settings [m]', statistics.median(errors_m), high=0.90)
        yield Row(name, 'ATE, worst of 12 settings [m]', max(errors_m), high=1.5)


def corridor_rows(data: Path, setup: Setup) -> Iterator[Row]:
    """Yield the shares of right best matches on both corridors."""
    for name, top_1, target in (
        ('corridor_vpr', vpr_top_1, 0.70), ('corridor_circuit', circuit_top_1, 0.73),
    ):  # fmt: skip
        yield Row(name, 'top-1', top_1(data / name, setup.config.local_view), low=target)


def demo_rows(setup: Setup, seeds: int) -> Iterator[Row]:
    """Yield the errors of simulated runs, and those of the preset openratslam on the same ones."""
    found: dict[str, list[float]] = {'': [], ', openratslam': []}
    setups = setup, Setup(load_config(ORIGINAL)[0], look_ahead=False)
    for seed in range(1, seeds + 1):
        with tempfile.TemporaryDirectory() as temporary:
            run = write_recording(Path(temporary) / f'demo_{seed}', seed)
            truth, out = read_tum(run.truth), Path(temporary) / 'results'
            for errors_m, one in zip(found.values(), setups, strict=True):
                one.replay(run.recording, out)
                final = read_tum(out / 'trajectory_final.tum')
                errors_m.append(evaluate(final, truth).ate.rmse)
        yield Row('demo', f'ATE, seed {seed} [m]', found[''][-1])
    targets = {'': (0.29, 0.50)}
    for what, errors_m in found.items():
        mean, worst = targets.get(what, (math.inf, math.inf))
        yield Row('demo', f'mean ATE{what} [m]', statistics.fmean(errors_m), high=mean)
        yield Row('demo', f'worst ATE{what} [m]', max(errors_m), high=worst)
    mine, others = (statistics.fmean(errors_m) for errors_m in found.values())
    yield Row('demo', 'mean ATE / openratslam', mine / others, high=1.0)


def all_rows(
    options: argparse.Namespace, setup: Setup
) -> Iterator[tuple[str, Path | None, Callable[[], Iterator[Row]]]]:
    """Yield name, required folder, and computation of each part of the table."""
    data: Path = options.data
    own = [LapRecording(folder.resolve(), options.tolerance) for folder in options.recording]
    for laps in own or lap_recordings(data):
        yield laps.folder.name, laps.folder, partial(lap_rows, laps, setup)
    if not own:
        yield 'lecture_hall', data / 'lecture_hall', partial(lecture_hall_rows, data, setup)
        yield 'corridors', data / 'corridor_vpr', partial(corridor_rows, data, setup)
        yield 'demo', None, partial(demo_rows, setup, options.seeds)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    parser.add_argument('--only', action='append', metavar='ROW',
                        help='compute only this row; may be repeated')
    parser.add_argument('--seeds', type=int, default=20, help='runs of the demo (default: 20)')
    parser.add_argument('--config', metavar='FILE|PRESET', help='default: none, inspected')
    parser.add_argument('--set', action='append', default=[], metavar='section.name=value')
    parser.add_argument('--no-inspect', action='store_true')
    parser.add_argument('--recording', type=Path, action='append', default=[], metavar='FOLDER',
                        help='evaluate this recording of laps; it has a lap_phase.csv')
    parser.add_argument('--tolerance', type=int, default=TOLERANCE_FRAMES, metavar='FRAMES',
                        help='frames of --recording closer than this show the same place '
                             f'(default: {TOLERANCE_FRAMES})')
    options = parser.parse_args()
    config, _ = load_config(options.config)
    values = dict(map(parse_setting, options.set))
    look_ahead = options.config is None and not options.no_inspect
    setup = Setup(config.with_values(values), look_ahead, tuple(values))
    warm_up()
    shown: list[Row] = []
    for name, folder, compute in all_rows(options, setup):
        if options.only and name not in options.only:
            continue
        if folder is not None and not folder.is_dir():
            print(f'{name}: skipped, {folder} not found')
            continue
        try:
            for row in compute():
                print(row.format(), flush=True)
                shown.append(row)
        except RatslamError as error:
            print(f'{name}: {error}')
            shown.append(Row(name, 'no result', math.nan, low=0.0))
    judged = [row for row in shown if row.low > -math.inf or row.high < math.inf]
    print(f'{sum(row.passed for row in judged)} of {len(judged)} targets are met')


if __name__ == '__main__':
    main()
