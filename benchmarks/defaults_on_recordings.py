# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Maps with no configuration: what a first replay of a recording reaches, against targets.

    python benchmarks/defaults_on_recordings.py [--data ../shared/data] [--only ROW ...]
    python benchmarks/defaults_on_recordings.py --recording FOLDER [--tolerance FRAMES]

Nothing is set by hand: every row is what `ratslam replay RECORDING` does without a configuration,
the inspection of the recording included. --config NAME evaluates a preset or a file instead, which
is not followed by an inspection; --no-inspect leaves it out for the defaults as well.

Recordings of laps, and any given by --recording: precision, recall, spread and turns for each lap
as in `lap_measures.py`, which also defines the measures of false recognitions. lecture_hall and
tuc_corridor: error of trajectory_final as in `lecture_hall.py`. demo: errors of the final map over
the simulated recordings of `ratslam demo`; demo_by_camera: the same without their odometry, by a
camera of unknown field of view, scaled to the truth.
"""

from __future__ import annotations

import argparse
import math
import statistics
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from lap_measures import LAPS, Laps, Setup, run_laps
from lecture_hall import LECTURE_HALL, TUC_CORRIDOR, Source, convert
from recording_variants import CAMERA_ONLY, ORIGINAL, VARIANTS, ChangedRecording, Variant

from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.errors import RatslamError
from ratslam_ros.recordings import open_recording
from ratslam_ros.results.evaluation import Alignment, evaluate
from ratslam_ros.results.trajectory import read_tum
from ratslam_simulator.recording import write_recording

TARGETS = {
    'rc_car_loops': (0.97, 0.90, 0.030), 'rc_car_eight': (0.95, 0.90, 0.033),
    'rc_car_other_way': (0.92, 0.84, 0.030), 'lab_car': (0.97, 0.93, 0.013),
    'donkeycar_track': (0.90, 0.82, 0.009), 'home_robot': (0.98, 0.91, 0.027),
    'home_robot_640': (0.98, 0.91, 0.027), 'outdoor_car': (0.99, 0.93, 0.008),
    'hall_car': (0.99, 0.82, 0.015),
}
"""Least precision and recall, and largest spread, of recordings of laps."""

TURNS = 0.2
"""Largest deviation of the turns for each lap."""

ROUTES = {source.folder: (source, most_m)
          for source, most_m in ((LECTURE_HALL, 0.66), (TUC_CORRIDOR, 3.0))}
"""Recordings of odometry and loop candidates, and their largest error in m."""

DEMO_BY_CAMERA = 'demo_by_camera'
"""Name of the demo without its odometry, by a camera of unknown field of view."""

DEMO_M = (0.16, 0.25)
"""Largest mean error and largest error of the demo, in m."""


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
    def is_judged(self) -> bool:
        """Whether there are bounds."""
        return self.low > -math.inf or self.high < math.inf

    @property
    def passed(self) -> bool:
        """Whether the value is within the bounds."""
        return self.low <= self.value <= self.high

    def format(self) -> str:
        """Format the row; it has no verdict if it has no bounds."""
        bounds = [f'{sign} {bound:g}' for sign, bound in (('>=', self.low), ('<=', self.high))
                  if math.isfinite(bound)]
        verdict = ('pass' if self.passed else 'FAIL') if self.is_judged else ''
        return (
            f'{self.recording:16} {self.measure:23} {self.value:9.{self.digits}f}   '
            f'{", ".join(bounds):16} {verdict}'
        ).rstrip()


def lap_rows(data: Path, laps: Laps, setup: Setup) -> Iterator[Row]:
    """Replay a recording of laps; yield its results."""
    name = laps.name
    run = run_laps(data, laps, setup)
    for line in run.lines:
        print(f'{name:16} {line}')
    precision, recall, spread = TARGETS.get(name, (-math.inf, -math.inf, math.inf))
    yield Row(name, 'precision', run.measures.precision, low=precision)
    yield Row(name, 'recall', run.measures.recall, low=recall)
    yield Row(name, 'spread of the map', run.measures.spread, high=spread, digits=4)
    off = TURNS if name in TARGETS else math.inf
    yield Row(name, 'turns for each lap', run.measures.turns, laps.turns - off, laps.turns + off,
              digits=2)
    for measure, value in (() if run.errors is None else run.errors._asdict().items()):
        yield Row(name, measure.replace('_', ' '), value, digits=0 if measure == 'errors' else 3)
    for measure in ('templates', 'experiences', 'loop_closures', 'times_realtime'):
        yield Row(name, measure.replace('_', ' '), run.summary[measure], digits=0)


def route_rows(data: Path, name: str, setup: Setup) -> Iterator[Row]:
    """Yield the error on a recording of odometry and loop candidates."""
    source, target_m = ROUTES[name]
    yield Row(name, 'ATE [m]', route_error_m(data, source, setup), high=target_m)


def route_error_m(data: Path, source: Source, setup: Setup) -> float:
    """Return the ATE RMSE on a recording of odometry and loop candidates in m."""
    with tempfile.TemporaryDirectory() as temporary:
        return error_m(*convert(data, Path(temporary), source), setup)


def demo_rows(setup: Setup, seeds: int, variant: str) -> Iterator[Row]:
    """Yield the errors of simulated runs."""
    name = {ORIGINAL: 'demo'}.get(variant, DEMO_BY_CAMERA)
    errors_m = []
    for seed in range(1, seeds + 1):
        errors_m.append(demo_error_m(seed, setup, variant))
        yield Row(name, f'ATE, seed {seed} [m]', errors_m[-1])
    mean_m, worst_m = DEMO_M if variant == ORIGINAL else (math.inf, math.inf)
    yield Row(name, 'mean ATE [m]', statistics.fmean(errors_m), high=mean_m)
    yield Row(name, 'worst ATE [m]', max(errors_m), high=worst_m)


def demo_error_m(seed: int, setup: Setup, variant: str = ORIGINAL) -> float:
    """Return the ATE RMSE of a variant of a simulated run in m."""
    with tempfile.TemporaryDirectory() as temporary:
        run = write_recording(Path(temporary) / f'demo_{seed}', seed)
        return error_m(run.recording, run.truth, setup, VARIANTS[variant])


def error_m(
    path: Path, truth: Path, setup: Setup, variant: Variant = VARIANTS[ORIGINAL]
) -> float:
    """Replay a variant of a recording; return the ATE RMSE of its final map in m.

    Without odometry, the map has no scale, and is scaled to the truth.
    """
    with tempfile.TemporaryDirectory() as out, open_recording(path) as recording:
        setup.replay(ChangedRecording(recording, variant), Path(out))
        final = read_tum(Path(out) / 'trajectory_final.tum')
    align: Alignment = 'se2' if variant.has_odometry else 'sim2'
    return evaluate(final, read_tum(truth), align).ate.rmse


def all_rows(
    options: argparse.Namespace, setup: Setup
) -> Iterator[tuple[str, Path | None, Callable[[], Iterator[Row]]]]:
    """Yield name, required folder, and computation of each part of the table."""
    data: Path = options.data
    own = [
        Laps(folder.resolve().name, options.tolerance, folder=str(folder.resolve()))
        for folder in options.recording
    ]
    for laps in own or LAPS.values():
        yield laps.name, laps.path(data), partial(lap_rows, data, laps, setup)
    if not own:
        for name in ROUTES:
            yield name, data / name, partial(route_rows, data, name, setup)
        yield 'demo', None, partial(demo_rows, setup, options.seeds, ORIGINAL)
        yield DEMO_BY_CAMERA, None, partial(demo_rows, setup, options.seeds, CAMERA_ONLY)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    Setup.add_options(parser)
    parser.add_argument('--only', action='append', metavar='ROW',
                        help='compute only this row; may be repeated')
    parser.add_argument('--seeds', type=int, default=20, help='runs of the demo (default: 20)')
    parser.add_argument('--recording', type=Path, action='append', default=[], metavar='FOLDER',
                        help='evaluate this recording of laps; it has a lap_phase.csv')
    parser.add_argument('--tolerance', type=int, default=8, metavar='FRAMES',
                        help='frames of --recording closer than this show the same place '
                             '(default: 8)')
    options = parser.parse_args()
    warm_up()
    judged: list[Row] = []
    for name, folder, compute in all_rows(options, Setup.of(options)):
        if options.only and name not in options.only:
            continue
        if folder is not None and not folder.is_dir():
            print(f'{name}: skipped, {folder} not found')
            continue
        try:
            for row in compute():
                print(row.format(), flush=True)
                judged += [row] if row.is_judged else []
        except RatslamError as error:
            print(f'{name}: {error}')
            judged.append(Row(name, 'no result', math.nan, low=0.0))
    print(f'{sum(row.passed for row in judged)} of {len(judged)} targets are met')


if __name__ == '__main__':
    main()
