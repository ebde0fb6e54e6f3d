# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ablation: what each mechanism contributes that the papers do not have.

    python benchmarks/ablation.py [--data ../shared/data] [--demos 10] [--floors SEEDS]
                                  [--minutes M] [--mechanism NAME ...] [--only RECORDING ...]
                                  [--jobs N]

Each mechanism is switched off alone, by parameters, and everything is compared with the result of
all mechanisms ("baseline"): with nothing configured, an inspection included.

- Recordings of laps: the variants 'original', 'start 10 s later' and 'every second frame' of
  `stability.py`. The table shows how many maps are right, and the mean differences of precision,
  recall and spread.
- lecture_hall and tuc_corridor: difference of the error, in m. They have no images, so that their
  variants are 'original' and 'start 10 s later'.
- demo: difference of the error over simulated recordings, in m, and the largest error.
- floors: goals reached in `navigation.py goals`, with both sizes of the pose cells, on five floor
  plans, with as many seeds as --floors says (default 0: none). The baseline is the preset
  navigation, which has some of the mechanisms off.

Differences are paired, by variant for recordings and by seed for the demo. The noise of a mean
difference is its standard error over variants or seeds. It does not contain the variation between
recordings, which are not a sample. Bold: more than twice the noise.
"""

from __future__ import annotations

import argparse
import math
import statistics
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import navigation
from defaults_on_recordings import ROUTES, error_m
from lap_measures import LAPS, Setup, in_processes, run_laps
from lecture_hall import convert
from recording_variants import ORIGINAL, VARIANTS

from ratslam_ros.core.config import Value
from ratslam_ros.core.vision.match_threshold import RELATED_RATIO
from ratslam_ros.errors import RatslamError
from ratslam_simulator.recording import write_recording

BASELINE, INSPECTION = 'baseline', 'inspection'

MECHANISMS: dict[str, dict[str, Value]] = {
    BASELINE: {},
    'vt_shift_match_y': {'local_view.vt_shift_match_y': 0},
    'vrot_subpixel': {'visual_odometry.vrot_subpixel': False},
    'vrot_height_share': {'visual_odometry.vrot_height_share': 1.0},
    'agreement of views': {'pose_cells.pc_vt_agree_views': 0.0},
    'vt_min_structure': {'local_view.vt_min_structure': 0.0},
    'exp_view_links': {'pose_cells.exp_view_links': False},
    'vt_recent_templates': {'local_view.vt_recent_templates': 0},
    'look-alikes': {'local_view.vt_match_ratio': RELATED_RATIO},
    'max_odom_gap_s': {'inputs.max_odom_gap_s': 60.0},
    'odom_calibration': {'pose_cells.odom_calibration': False},
    INSPECTION: {},
}  # fmt: skip
"""Values that switch each mechanism off. The inspection is left out instead."""

LAP_VARIANTS = ORIGINAL, 'start 10 s later', 'every second frame'
ROUTE_VARIANTS = LAP_VARIANTS[:2]

FLOORS = (
    'university_floor', 'obstacle_loop',
    *(str(Path(__file__).parent / 'floors' / f'{name}.txt') for name in navigation.FLOORS),
)  # fmt: skip
"""Names or files of floor plans."""

DEMO = 'demo'


@dataclass(frozen=True)
class Case:
    """A replay: a recording, or 'demo', and a variant, or the seed of the demo.

    path, truth: the recording and its true trajectory, None for recordings of laps.
    """

    mechanism: str
    recording: str
    variant: str
    path: Path | None = None
    truth: Path | None = None


Measures = Mapping[str, float]
"""Values by the name of the measure."""


def run(data: Path, setup: Setup, case: Case) -> Measures:
    """Replay a case with its mechanism switched off, and measure the map."""
    values = MECHANISMS[case.mechanism]
    setup = Setup(
        setup.config.with_values(values), setup.look_ahead and case.mechanism != INSPECTION,
        (*setup.fixed, *values),
    )  # fmt: skip
    if case.path is None or case.truth is None:
        laps = LAPS[case.recording]
        measures = run_laps(data, laps, setup, case.variant).measures
        return {**measures._asdict(), 'right': measures.is_right(laps.turns)}
    change = VARIANTS.get(case.variant, VARIANTS[ORIGINAL])
    return {'error_m': error_m(case.path, case.truth, setup, change)}


@dataclass
class Table:
    """Measures of all cases."""

    found: dict[tuple[str, str, str], Measures] = field(default_factory=dict)
    """By mechanism, recording and variant."""

    def values(self, mechanism: str, recordings: Iterable[str], measure: str) -> list[float]:
        """Return a measure of all variants of some recordings."""
        return [
            measures[measure] for (one, recording, _), measures in self.found.items()
            if one == mechanism and recording in recordings
        ]  # fmt: skip

    def difference(
        self, mechanism: str, recordings: Iterable[str], measure: str
    ) -> tuple[float, float]:
        """Return the mean difference from the baseline, and its standard error.

        Every recording has the same weight, and the noise of its own variants.
        """
        means, errors = [], []
        for recording in recordings:
            apart = [
                measures[measure] - self.found[BASELINE, recording, variant][measure]
                for (one, name, variant), measures in self.found.items()
                if (one, name) == (mechanism, recording)
                and (BASELINE, name, variant) in self.found
            ]  # fmt: skip
            if apart:
                means.append(statistics.fmean(apart))
                spread = statistics.stdev(apart) if len(apart) > 1 else math.nan
                errors.append(spread / math.sqrt(len(apart)))
        if not means:
            return math.nan, math.nan
        return statistics.fmean(means), math.hypot(*errors) / len(means)

    def row(self, mechanism: str, laps: Iterable[str], routes: Iterable[str]) -> str:
        """Return a row of the final table in Markdown."""
        right = self.values(mechanism, laps, 'right')
        errors_m = self.values(mechanism, (DEMO,), 'error_m')
        cells = [mechanism, f'{sum(right):.0f} of {len(right)}']
        for recordings, measure, digits in (
            (laps, 'precision', 3), (laps, 'recall', 3), (laps, 'spread', 4),
            *(((route,), 'error_m', 2) for route in routes), ((DEMO,), 'error_m', 3),
        ):  # fmt: skip
            values = self.values(mechanism, recordings, measure)
            if not values:
                cells.append('')
            elif mechanism == BASELINE:
                cells.append(f'{statistics.fmean(values):.{digits}f}')
            else:
                cells.append(signed(*self.difference(mechanism, recordings, measure), digits))
        return '| ' + ' | '.join([*cells, f'{max(errors_m):.2f}' if errors_m else '']) + ' |'


def signed(mean: float, noise: float, digits: int) -> str:
    """Return a difference and its noise, bold if it exceeds twice the noise."""
    text = f'{mean:+.{digits}f} +- {noise:.{digits}f}'
    return f'**{text}**' if abs(mean) > 2.0 * noise else text


def cases(
    options: argparse.Namespace, mechanisms: Iterable[str], folder: Path
) -> Iterator[Case]:
    """Yield all cases; recordings that do not exist yet are written to a folder."""
    data: Path = options.data
    inputs = []
    for name, laps in LAPS.items():
        if laps.path(data).is_dir():
            inputs += [Case('', name, variant) for variant in LAP_VARIANTS]
    for name, (source, _) in ROUTES.items():
        if (data / name).is_dir():
            (folder / name).mkdir()
            paths = convert(data, folder / name, source)
            inputs += [Case('', name, variant, *paths) for variant in ROUTE_VARIANTS]
    for seed in range(1, options.demos + 1) if DEMO in (options.only or [DEMO]) else ():
        made = write_recording(folder / f'demo_{seed}', seed)
        inputs.append(Case('', DEMO, str(seed), made.recording, made.truth))
    for mechanism in mechanisms:
        for case in inputs:
            if case.recording in (options.only or [case.recording]):
                yield replace(case, mechanism=mechanism)


def floors(mechanism: str, seeds: int, minutes: float) -> str:
    """Return how many goals are reached on all floors, explored for some minutes (0: 60)."""
    values = tuple(f'{name}={value}' for name, value in MECHANISMS[mechanism].items())
    with tempfile.TemporaryDirectory() as out:
        trials = [
            trial for plan in FLOORS
            for row in navigation.pooled(
                partial(navigation.goals_run, navigation.Setting(
                    plan, 1.0, 0, Path(out), minutes, values)),
                [(seed, size) for size in navigation.SIZES for seed in range(1, seeds + 1)],
            )
            for trial in row.trials
        ]  # fmt: skip
    return f'{sum(trial.succeeded for trial in trials)} of {len(trials)}'


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    Setup.add_options(parser)
    parser.add_argument('--mechanism', action='append', choices=MECHANISMS, metavar='NAME',
                        help=f'may be repeated; one of {", ".join(MECHANISMS)} (default: all)')
    parser.add_argument('--only', action='append', choices=(*LAPS, *ROUTES, DEMO),
                        metavar='RECORDING', help="may be repeated; 'demo' is one, too")
    parser.add_argument('--demos', type=int, default=10, help='simulated runs (default: 10)')
    parser.add_argument('--floors', type=int, default=0, metavar='SEEDS',
                        help='seeds of navigation on each floor (default: 0)')
    parser.add_argument('--minutes', type=float, default=0.0,
                        help='exploration of each floor (default: that of navigation.py)')
    parser.add_argument('--jobs', type=int, default=2, help='number of processes (default: 2)')
    options = parser.parse_args()
    mechanisms = list(dict.fromkeys([BASELINE, *(options.mechanism or MECHANISMS)]))
    table = Table()
    with tempfile.TemporaryDirectory() as temporary:
        work = partial(run, options.data, Setup.of(options))
        tasks = list(cases(options, mechanisms, Path(temporary)))
        for case, found in in_processes(work, tasks, options.jobs):
            name = f'{case.mechanism:20} {case.recording:17} {case.variant:18}'
            if isinstance(found, RatslamError):
                print(name, found, flush=True)
                continue
            table.found[case.mechanism, case.recording, case.variant] = found
            print(name, ', '.join(f'{key} {value:.3f}' for key, value in found.items()),
                  flush=True)
    laps, routes = ([name for name in names if any(name == one.recording for one in tasks)]
                    for names in (LAPS, ROUTES))  # fmt: skip
    columns = ['switched off', 'right', 'precision', 'recall', 'spread',
               *(f'{name} [m]' for name in routes), 'demo [m]', 'worst demo [m]']  # fmt: skip
    print(f'\n| {" | ".join(columns)} |\n|{" --- |" * len(columns)}')
    for mechanism in mechanisms:
        print(table.row(mechanism, laps, routes))
    for mechanism in mechanisms if options.floors else ():
        if mechanism != INSPECTION:  # the preset navigation is not followed by one
            reached = floors(mechanism, options.floors, options.minutes)
            print(f'floors, {mechanism}: {reached} goals', flush=True)


if __name__ == '__main__':
    main()
