# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ablation: what each mechanism contributes that the papers do not have.

    python benchmarks/ablation.py [--data ../shared/data] [--mechanism NAME ...] [--only CASE ...]
                                  [--demos 10] [--seeds 2] [--minutes 20] [--jobs N] [--again]

Each mechanism is switched off alone, by parameters, and everything is compared with the result of
all mechanisms ("baseline"). Each result is stored in --results at once, an interrupted command
continues, and stored results are not repeated, unless --again is given. The tables in
docs/algorithm.md are written from the stored results.

With nothing configured, an inspection included:

- Recordings of laps: the variants 'original', 'start 10 s later' and 'every second frame' of
  `stability.py`. The table shows how many maps are right, and the mean differences of precision,
  recall and spread.
- lecture_hall and tuc_corridor: difference of the error, in m. They have no images, so that their
  variants are 'original' and 'start 10 s later'.
- demo: difference of the error over simulated recordings, in m, and the largest error.

With the preset navigation, which has other mechanisms:

- goals: goals reached in `navigation.py goals`, with 100 x 40 x 36 cells, after --minutes of
  exploration, and the error of the map, in m.

Differences are paired, by variant for recordings and by seed for the others. The noise of a mean
difference is its standard error over variants or seeds. It does not contain the variation between
recordings, which are not a sample. Bold: more than twice the noise.
"""

from __future__ import annotations

import argparse
import math
import statistics
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import navigation
import papers
from defaults_on_recordings import ROUTES, error_m
from lap_measures import LAPS, Setup, in_processes, run_laps
from lecture_hall import convert
from papers import Result, Results
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
    'pc_vt_interpolate': {'pose_cells.pc_vt_interpolate': False},
    'pc_vt_spare_newest': {'pose_cells.pc_vt_spare_newest': False},
    INSPECTION: {},
}
"""Values that switch each mechanism off. The inspection is left out instead."""

NAVIGATION: dict[str, dict[str, Value]] = {
    BASELINE: {},
    'agreement of views': {'pose_cells.pc_vt_agree_views': 0.0},
    'pc_vt_interpolate': {'pose_cells.pc_vt_interpolate': False},
    'pc_vt_spare_newest': {'pose_cells.pc_vt_spare_newest': False},
    'vt_shift_fov_deg': {'local_view.vt_shift_fov_deg': 0.0},
    'vt_patch_normalise': {'local_view.vt_patch_normalise': 0},
    'exp_relaxation: solve': {'experience_map.exp_relaxation': 'sweep'},
    'exp_align_scans': {
        'experience_map.exp_align_scans': False, 'experience_map.exp_relocate': 'views',
    },
    'exp_gate_closures': {'experience_map.exp_gate_closures': False},
    'exp_relocate': {'experience_map.exp_relocate': 'views'},
    'route_back_factor': {'goal_recall.route_back_factor': 0.0},
    'route_join_m': {'goal_recall.route_join_m': 0.0},
    'route_switch_s': {'goal_recall.route_switch_s': 0.0},
}
"""The same for the preset navigation: values of the papers."""

LAP_VARIANTS = ORIGINAL, 'start 10 s later', 'every second frame'
ROUTE_VARIANTS = LAP_VARIANTS[:2]
DEMO, GOALS = 'demo', 'goals'

BEGIN, END = '<!-- benchmarks/ablation.py: begin -->\n', '<!-- benchmarks/ablation.py: end -->\n'
"""Marks of the generated tables."""


@dataclass(frozen=True)
class Case:
    """A run: a recording, 'demo' or 'goals', and a variant, or the seed.

    path, truth: the recording and its true trajectory, None for recordings of laps.
    """

    mechanism: str
    recording: str
    variant: str
    path: Path | None = None
    truth: Path | None = None


def run(data: Path, setup: Setup, minutes: float, case: Case) -> Result:
    """Run a case with its mechanism switched off, and measure the map."""
    if case.recording == GOALS:
        return reached(NAVIGATION[case.mechanism], int(case.variant), minutes)
    values = MECHANISMS[case.mechanism]
    setup = Setup(
        setup.config.with_values(values), setup.look_ahead and case.mechanism != INSPECTION,
        (*setup.fixed, *values),
    )
    if case.path is None or case.truth is None:
        laps = LAPS[case.recording]
        measures = run_laps(data, laps, setup, case.variant).measures
        return {**measures._asdict(), 'right': int(measures.is_right(laps.turns))}
    change = VARIANTS.get(case.variant, VARIANTS[ORIGINAL])
    return {'error_m': error_m(case.path, case.truth, setup, change)}


def reached(values: Mapping[str, Value], seed: int, minutes: float) -> Result:
    """Return how many goals are reached with values of parameters."""
    texts = tuple(f'{name}={value}' for name, value in values.items())
    with tempfile.TemporaryDirectory() as out:
        setting = navigation.Setting('', 1.0, 0, Path(out), minutes, texts)
        row = navigation.goals_run(setting, (seed, navigation.SIZES[0]))
    done = sum(trial.succeeded for trial in row.trials)
    return {'reached': done, 'goals': len(row.trials), 'map_m': row.error_m}


def difference(
    found: Results, mechanism: str, recordings: Iterable[str], measure: str
) -> tuple[float, float]:
    """Return the mean difference from the baseline, and its standard error.

    Every recording has the same weight, and the noise of its own variants.
    """
    means, errors = [], []
    for recording in recordings:
        base = found[BASELINE].get(recording, {})
        apart = [
            measures[measure] - base[variant][measure]
            for variant, measures in found[mechanism].get(recording, {}).items()
            if variant in base
        ]
        if apart:
            means.append(statistics.fmean(apart))
            spread = statistics.stdev(apart) if len(apart) > 1 else math.nan
            errors.append(spread / math.sqrt(len(apart)))
    if not means:
        return math.nan, math.nan
    return statistics.fmean(means), math.hypot(*errors) / len(means)


def signed(mean: float, noise: float, digits: int) -> str:
    """Return a difference and its noise, bold if it exceeds twice the noise, NaN if unknown."""
    if math.isnan(noise):
        return f'{mean:+.{digits}f}'
    text = f'{mean:+.{digits}f} +- {noise:.{digits}f}'
    return f'**{text}**' if abs(mean) > 2.0 * noise else text


def table(
    found: Results, shares: Mapping[str, tuple[Iterable[str], str, str]],
    columns: Mapping[str, tuple[Iterable[str], str, int]],
) -> list[str]:
    """Return the lines of a table in Markdown, of the mechanisms that have results for it.

    Args:
        found: all results, by mechanism, recording and variant.
        shares: title -> recordings, and the measures that are summed: 'A of B'. '' counts runs.
        columns: title -> recordings, measure and number of digits.
    """
    titles = ['switched off', *shares, *columns]
    lines = [f'| {" | ".join(titles)} |', f'|{" --- |" * len(titles)}']
    names = {name for names, *_ in (*shares.values(), *columns.values()) for name in names}
    for mechanism in {**MECHANISMS, **NAVIGATION}:
        mine = found.get(mechanism, {})
        if not names & mine.keys():
            continue
        cells = [mechanism]
        for recordings, part, whole in shares.values():
            rows = [row for name in recordings for row in mine.get(name, {}).values()]
            count = sum(row[whole] for row in rows) if whole else len(rows)
            cells.append(f'{sum(row[part] for row in rows):.0f} of {count:.0f}')
        for recordings, measure, digits in columns.values():
            rows = [row for name in recordings for row in mine.get(name, {}).values()]
            if not rows:
                cells.append('not run')
            elif mechanism == BASELINE:
                cells.append(f'{statistics.fmean(row[measure] for row in rows):.{digits}f}')
            else:
                cells.append(signed(*difference(found, mechanism, recordings, measure), digits))
        lines.append('| ' + ' | '.join(cells) + ' |')
    return lines


def tables(found: Results) -> str:
    """Return the tables of recordings and of navigation in Markdown."""
    laps = list(LAPS)
    recordings = table(
        found, {'right': (laps, 'right', '')}, {
            'precision': (laps, 'precision', 3), 'recall': (laps, 'recall', 3),
            'spread': (laps, 'spread', 4),
            **{f'{name} [m]': ([name], 'error_m', 2) for name in (*ROUTES, DEMO)},
        },
    )
    goals = table(
        found, {'goals reached': ([GOALS], 'reached', 'goals')}, {'map [m]': ([GOALS], 'map_m', 2)}
    )
    return '\n'.join([*recordings, '', *goals, ''])


def with_tables(page: str, found: Results) -> str:
    """Return a page with the present tables between its marks."""
    before, _, rest = page.partition(BEGIN)
    return f'{before}{BEGIN}\n{tables(found)}\n{END}{rest.partition(END)[2]}'


def cases(
    options: argparse.Namespace, wanted: Iterable[str], folder: Path, found: Results
) -> Iterator[Case]:
    """Yield the cases without a result; missing recordings are written to a folder."""
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
    inputs += [Case('', GOALS, str(seed)) for seed in range(1, options.seeds + 1)]
    for mechanism in wanted:
        for case in inputs:
            known = NAVIGATION if case.recording == GOALS else MECHANISMS
            stored = found.get(mechanism, {}).get(case.recording, {})
            if mechanism in known and case.recording in (options.only or [case.recording]) and (
                options.again or case.variant not in stored
            ):
                yield replace(case, mechanism=mechanism)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    names = {**MECHANISMS, **NAVIGATION}
    Setup.add_options(parser)
    parser.add_argument('--mechanism', action='append', choices=names, metavar='NAME',
                        help=f'may be repeated; one of {", ".join(names)} (default: all)')
    parser.add_argument('--only', action='append', choices=(*LAPS, *ROUTES, DEMO, GOALS),
                        metavar='CASE', help="recording, 'demo' or 'goals'; may be repeated")
    parser.add_argument('--demos', type=int, default=10, help='simulated runs (default: 10)')
    parser.add_argument('--seeds', type=int, default=2, help='seeds of goals (default: 2)')
    parser.add_argument('--minutes', type=float, default=20.0,
                        help='exploration before the goals (default: 20)')
    parser.add_argument('--jobs', type=int, default=2, help='number of processes (default: 2)')
    parser.add_argument('--again', action='store_true', help='repeat stored results')
    parser.add_argument('--results', type=Path, default=papers.ROOT / 'benchmarks/ablation.json')
    parser.add_argument('--docs', type=Path, default=papers.ROOT / 'docs/algorithm.md')
    options = parser.parse_args()
    wanted = dict.fromkeys([BASELINE, *(options.mechanism or names)])
    found = papers.load(options.results)
    with tempfile.TemporaryDirectory() as temporary:
        work = partial(run, options.data, Setup.of(options), options.minutes)
        tasks = cases(options, wanted, Path(temporary), found)
        for case, measures in in_processes(work, tasks, options.jobs):
            name = f'{case.mechanism:20} {case.recording:17} {case.variant:18}'
            if isinstance(measures, RatslamError):
                print(name, measures, flush=True)
                continue
            rows = found.setdefault(case.mechanism, {}).setdefault(case.recording, {})
            rows[case.variant] = {key: round(value, 5) for key, value in measures.items()}
            papers.store(options.results, found)
            print(name, ', '.join(f'{key} {value:.3f}' for key, value in measures.items()),
                  flush=True)
    page = options.docs.read_text('utf-8')
    options.docs.write_text(with_tables(page, found), 'utf-8')


if __name__ == '__main__':
    main()
