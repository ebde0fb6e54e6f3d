# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every experiment of the papers: published results, and ours, as published and with our presets.

    python benchmarks/papers.py [EXPERIMENT ...] [--seeds 2] [--first 3] [--minutes M] [--again]
    python benchmarks/papers.py irat stlucia newcollege --data FOLDER --seeds 1

Without names, it runs all experiments. Every result is stored in --results at once, and an
interrupted command continues after the last one. Results that are stored already are not repeated,
unless --again is given. The tables in docs/experiments.md are written from the stored results.
--data names the folder of the recordings of Ball et al. (2013), whose names begin with that of the
experiment; without it, simulated recordings of the same format stand in for them.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import landmarks
import map_file_cost
import navigation
import numpy as np
import path_integration
from navigation import Setting
from tqdm import tqdm
from two_corridors import parameters_of, two_corridors_run
from two_routes import two_routes_run

from ratslam_ros.files.config import load_config
from ratslam_ros.offline.map_recording import map_recording
from ratslam_ros.results.evaluation import evaluate
from ratslam_ros.results.trajectory import Trajectory, read_tum
from ratslam_simulator.closed_loop import ClosedLoop
from ratslam_simulator.stand_ins import DATA_SETS, write_stand_in

ROOT = Path(__file__).resolve().parents[1]

Result = dict[str, int | float]
"""Figures of one run, or of several: then integers are sums, and floats are means."""

Results = dict[str, dict[str, dict[str, Result]]]
"""Experiment -> setting -> seed -> result."""

OURS = 'ours'
"""Setting with the presets and parameters of this project; the other one is `published`."""

STAND_IN = 'stand-in'
"""Setting of `published` on a simulated recording, until the recording of the paper is run."""

BEGIN, END = '<!-- benchmarks/papers.py: begin -->\n', '<!-- benchmarks/papers.py: end -->\n'
"""Marks of the generated tables."""

PAPER_2005 = 'Milford et al. (2005)'
PAPER_2006 = 'Milford et al. (2006)'
PAPER_2008 = 'Milford (2008)'
PAPER_MEMORY = 'Kahn and Mazor (2002)'
PAPER_2013 = 'Ball et al. (2013)'


@dataclass(frozen=True)
class Experiment:
    """An experiment, figure or table of a paper.

    Attributes:
        paper: the paper.
        part: its sections, figures and tables.
        subject: what is done.
        published: the published result.
        run: runs one seed in a setting.
        shown: format of the figures of a result.
        presets: setting, preset and camera rate in Hz, for each setting in which it is run.
        section: of docs/experiments.md, or another page of docs, that describes the experiment.
    """

    paper: str
    part: str
    subject: str
    published: str
    run: Callable[[Setting, int], Result]
    shown: str
    presets: tuple[tuple[str, str, int], ...] = ((OURS, Setting.config, Setting.camera_rate_hz),)
    section: str = ''


AS_2005 = (('published', 'milford2005', 10), (OURS, Setting.config, Setting.camera_rate_hz))
AS_2006 = (('published', 'milford2006', 7), (OURS, Setting.config, Setting.camera_rate_hz))


def goals(size: tuple[int, int]) -> Callable[[Setting, int], Result]:
    """Return the goals experiment with pose cells of a size."""

    def run(setting: Setting, seed: int) -> Result:
        row = navigation.goals_run(setting, (seed, size))
        done = [x for x in row.trials if x.succeeded]
        return {
            'reached': len(done), 'goals': len(row.trials),
            'experiences': float(row.experiences), 'map_m': row.error_m,
            'times_ms': row.temporal_map_ms, 'minutes': setting.explore_s(60.0) / 60.0,
        }

    return run


def goal_memory(
    size: str, people: int = 0, prepare: Callable[[ClosedLoop], None] = lambda _: None
) -> Callable[[Setting, int], Result]:
    """Return the goal memory experiment with pose cells of a size, and people who walk about."""

    def run(setting: Setting, seed: int) -> Result:
        found = replace(setting, people=people)
        trials = navigation.goal_memory_run(found, (seed, size), prepare)
        return {
            'reached': sum(x.reached for x in trials), 'goals': len(trials),
            'off_m': navigation.mean([x.error_m for x in trials]),
            'way_m': navigation.mean([x.way_m for x in trials]),
            'took_s': navigation.mean([x.took_s for x in trials]),
            'by_map': sum(x.reached_by_map for x in trials),
            'views': navigation.mean([x.views for x in trials]),
            'driven_m': navigation.mean([x.driven_m for x in trials]),
            'minutes': navigation.mean([x.minutes for x in trials]),
        }

    return run


def obstacle(setting: Setting, seed: int) -> Result:
    """Run the obstacle experiment."""
    row = navigation.obstacle_run(setting, seed)
    return {'held': int(row.held), 'runs': 1}


def people_in_the_way(setting: Setting, seed: int) -> Result:
    """Drive past people who stand in the way or walk along it, and without people."""
    rows = navigation.people_run(setting, seed)
    alone, past = ([x for x in rows if (x.case == 'alone') == wanted] for wanted in (True, False))
    lost = {
        f'lost_{case.removesuffix(" s")}': sum(x.lost for x in rows if x.case == case)
        for case in navigation.PEOPLE_CASES
    }
    return {
        **lost, 'for_good': sum(x.lost_for_good for x in rows),
        'reached': sum(x.reached for x in past), 'goals': len(past),
        'reached_alone': sum(x.reached for x in alone), 'goals_alone': len(alone),
        'short': sum(x.driven_m < navigation.SHORT_WAY_M for x in alone[1:]), 'runs': 1,
    }


def loop(setting: Setting, seed: int) -> Result:
    """Run the loop experiment."""
    row = navigation.loop_run(setting, seed)
    return {
        'closed': int(row.closed), 'runs': 1, 'drift_m': row.drift_m, 'map_m': row.map_after_m,
        'wrong': row.wrong,
    }


def hypotheses(setting: Setting, seed: int) -> Result:
    """Carry a robot into one of two corridors without a unique view."""
    found = two_corridors_run(parameters_of(setting.config), seed % 2)
    is_right = int(found.views_count > 0)
    return {'right': is_right, 'runs': 1, 'packets': float(max(found.packets))}


def two_routes(setting: Setting, seed: int) -> Result:
    """Compare two routes of equal length, one of which was driven at half the speed."""
    routes = two_routes_run(setting.config, is_first_slow=seed % 2 == 0)
    return {'right': int(routes.takes_fast), 'runs': 1, 'fast_s': routes.fast_s}


def blocked(setting: Setting, seed: int) -> Result:
    """Block the faster one of two routes until the other one is planned."""
    routes = two_routes_run(setting.config, is_first_slow=seed % 2 == 0)
    return {'other': int(routes.tries_count > 0), 'runs': 1, 'tries': float(routes.tries_count)}


def kidnapped(setting: Setting, seed: int) -> Result:
    """Carry a robot five times, with the relocation of its preset."""
    relocate = load_config(setting.config)[0].experience_map.exp_relocate
    rows = navigation.kidnapped_run(setting, (seed, relocate))
    found = [row for row in rows if row.recovered]
    return {
        'recovered': len(found), 'carries': len(rows), 'wrong': sum(row.wrong for row in rows),
        'took_s': navigation.mean([row.time_s for row in found]),
    }


def kidnapped_goals(setting: Setting, seed: int) -> Result:
    """Carry a robot on its way to each of five places, with the relocation of its preset."""
    relocate = load_config(setting.config)[0].experience_map.exp_relocate
    rows = navigation.kidnapped_goals_run(setting, (seed, relocate))
    reached = [row for row in rows if row.reached]
    return {
        'reached': len(reached), 'goals': len(rows),
        'wrong': sum(row.claimed and not row.reached for row in rows),
        'took_s': navigation.mean([row.time_s for row in reached]),
    }


def memory_size(setting: Setting, seed: int) -> Result:
    """Explore for an hour; measure the bytes of the whole state for each experience."""
    loop = setting.loop(seed, 'university_floor')
    loop.explore(setting.explore_s(60.0))
    count = len(loop.experience_map)
    kb = 1e-3 * sum(map_file_cost.values(loop.ratslam.state())) / count
    _, times_ms = navigation.timed_temporal_map(loop)
    return {'experiences': float(count), 'kb': kb, 'times_ms': times_ms}


def pruning(setting: Setting, seed: int) -> Result:
    """Run the pruning experiment."""
    row = navigation.pruning_run(setting, seed)
    return {
        'reached': sum(x.succeeded for x in row.trials), 'goals': len(row.trials),
        'free': float(row.free), 'limited': float(row.limited), 'free_m': row.free_m,
        'limited_m': row.limited_m, 'minutes': setting.explore_s(120.0) / 60.0,
    }


def pose_cells(setting: Setting, seed: int) -> Result:
    """Measure the rate at which a full matrix of pose cells is updated."""
    return {'rate_hz': 1.0 / path_integration.dense_step_s((36, 150, 150))}


WORLDS_COUNT = 5
"""Worlds for each seed of the relocalisation experiment; ten robots are carried in each."""


def relocalisation(case: str, published: str) -> Callable[[Setting, int], Result]:
    """Return the relocalisation experiment, in a world of ours or with the noise of a case.

    Args:
        case: key of ``landmarks.RELOCALISATION_CASES``.
        published: key of ``landmarks.AS_PUBLISHED_CASES``.
    """

    def run(setting: Setting, seed: int) -> Result:
        rows = []
        for world in range(WORLDS_COUNT * seed, WORLDS_COUNT * (seed + 1)):
            if setting.config == AS_PUBLISHED:
                rows += landmarks.as_published_run(published, True, world)
            else:
                rows += landmarks.relocalisation_run(case, world)
        x_m, y_m = np.array([row.error[:2] for row in rows if row.pose is not None]).T
        return {
            'right': sum(row.outcome == 'right' for row in rows), 'tries': len(rows),
            'x_m': float(x_m.mean()), 'x_sd_m': float(x_m.std()),
            'y_m': float(y_m.mean()), 'y_sd_m': float(y_m.std()),
        }

    return run


def mapping(setting: Setting, seed: int) -> Result:
    """Map a world with three observations per step."""
    row = landmarks.mapping_run('normal, 3 observations', seed)
    return {'within': row.within, 'rms_m': row.rms_m}


def memory(setting: Setting, seed: int) -> Result:
    """Map a world with a limit of 20 landmarks and with none."""
    rows = dict(zip(landmarks.LIMITS, landmarks.memory_run(seed), strict=True))
    (limited, limited_ms), (free, free_ms) = rows[20], rows[0]
    return {'limited_ms': limited_ms, 'free_ms': free_ms, 'limited_m': limited.rms_m,
            'free_m': free.rms_m}


def memory_relocalisation(setting: Setting, seed: int) -> Result:
    """Relocalise on maps with a limit of 80 landmarks and with none."""
    rows = landmarks.memory_relocalisation_run(landmarks.KIDNAP_WORLDS[-1], seed)
    right = {limit: sum(x.outcome == 'right' for x in found) for limit, found in rows.items()}
    return {'limited': right[80], 'free': right[0], 'tries': len(rows[0])}


def data_set(name: str, recording: Path | None = None) -> Callable[[Setting, int], Result]:
    """Return the experiment on a recording of Ball et al. (2013).

    Args:
        name: key of ``DATA_SETS``, and the preset.
        recording: the recording, and beside it the truth, if there is one, as a TUM file; None: a
            simulated one stands in for it.
    """

    def run(setting: Setting, seed: int) -> Result:
        duration_s = 60.0 * setting.minutes or None
        with tempfile.TemporaryDirectory() as folder:
            path = recording or Path(folder) / f'{name}.bag'
            if recording is None:
                write_stand_in(path, name, seed, duration_s)
            found = map_recording(
                path, config=name, image_topic=DATA_SETS[name].image_topic, history=False,
                quiet=True, duration_s=duration_s,
            )
            truth = path.with_suffix('.tum')

            def error_m(trajectory: Trajectory) -> float:
                if not truth.exists():
                    return math.nan
                return evaluate(trajectory, read_tum(truth), 'sim2').ate.rmse

            summary = found.summary
            return {
                'templates': float(summary['templates']),
                'experiences': float(summary['experiences']),
                'closures': float(summary['loop_closures']),
                'map_m': error_m(found.trajectory_final), 'dead_m': error_m(found.dead_reckoning),
            }

    return run


def use_recordings(folder: Path) -> None:
    """Let the recordings of a folder take the place of the simulated ones."""
    for name in DATA_SETS:
        for path in sorted(folder.glob(f'{name}*')):
            if path.suffix != '.tum':
                EXPERIMENTS[name] = replace(
                    EXPERIMENTS[name], run=data_set(name, path), presets=(('published', name, 0),)
                )


DATA_SET_SHOWN = (
    '{templates:.0f} templates, {experiences:.0f} experiences, {closures:.0f} loop closures; RMSE '
    'of the path {map_m:.2f} m, of dead reckoning {dead_m:.2f} m'
)
GOALS_SHOWN = (
    '{reached} of {goals} goals after {minutes:.0f} minutes on average, {experiences:.0f} '
    'experiences, RMSE of the map {map_m:.2f} m, temporal map {times_ms:.0f} ms'
)
GOAL_MEMORY_SHOWN = (
    '{reached} of {goals} goals, {off_m:.1f} m off, {took_s:.0f} s for {way_m:.0f} m; '
    'by the experience map {by_map}'
)
RELOCALISATION_SHOWN = (
    'x {x_m:.2f} +- {x_sd_m:.2f}, y {y_m:.2f} +- {y_sd_m:.2f}; {right} of {tries} right'
)
AS_PUBLISHED = 'as published'
"""In place of a preset: the landmarks have no configuration."""

LANDMARKS = (('published', AS_PUBLISHED, 0), (OURS, Setting.config, 0))

EXPERIMENTS: dict[str, Experiment] = {
    'goal_memory': Experiment(
        PAPER_2005, 'V, figures 6 to 10', 'two goals by goal memory, 140 x 80 x 36 cells',
        '2 of 2 goals: 16.5 m in 96 s, 21 m in 140 s; 1,274 views, about 166 m in 17 minutes',
        goal_memory('large'),
        GOAL_MEMORY_SHOWN + '; {views:.0f} views, {driven_m:.0f} m in {minutes:.0f} minutes',
        AS_2005, '#goal-memory',
    ),
    'pose_cells': Experiment(
        PAPER_2005, 'V.E', 'rate of a full matrix of pose cells', '800,000 cells at 10 Hz',
        pose_cells, '810,000 cells at {rate_hz:.0f} Hz', (('published', 'milford2005', 10),),
        'benchmarks.md#path-integration-of-the-pose-cells',
    ),
    'hypotheses': Experiment(
        PAPER_2005, 'II.D', 'two corridors without a unique view',
        'hypotheses converge to a single one', hypotheses,
        'right in {right} of {runs}, with up to {packets:.0f} packets',
        AS_2005, '#two-corridors',
    ),
    'two_routes': Experiment(
        PAPER_2005, 'V.D, figure 9', 'two routes of similar length', 'the faster one is taken',
        two_routes, 'the faster one in {right} of {runs}, {fast_s:.0f} s on the temporal map',
        AS_2005, '#two-routes',
    ),
    'irregular_rate': Experiment(
        PAPER_2005, 'IV.A', 'a rate that varies by as much as 5 Hz; here of the images only',
        'no adverse effects', goal_memory('large', prepare=navigation.make_irregular),
        GOAL_MEMORY_SHOWN, (('published', 'milford2005', 10), (OURS, Setting.config, 10)),
        '#goal-memory',
    ),
    'people': Experiment(
        PAPER_2005, 'IV.B', 'exploration while people move around; here three',
        'goals are reached', goal_memory('large', people=3), GOAL_MEMORY_SHOWN, AS_2005,
        '#goal-memory',
    ),
    'blocked': Experiment(
        PAPER_2005, 'VI', 'a blocked way makes it choose another one', 'announced, no results',
        blocked, 'the other one in {other} of {runs}, after {tries:.0f} failed tries on average',
        section='#two-routes',
    ),
    'kidnapped': Experiment(
        PAPER_2005, 'VI', 'a robot is carried while it explores', 'announced, no results',
        kidnapped,
        '{recovered} of {carries} recovered, after {took_s:.0f} s; {wrong} wrong places', AS_2005,
        '#kidnapped-robot',
    ),
    'kidnapped_goals': Experiment(
        PAPER_2005, 'VI', 'a robot is carried on its way to a goal, by the experience map here',
        'announced, no results', kidnapped_goals,
        '{reached} of {goals} goals, {took_s:.0f} s after that; {wrong} claimed elsewhere',
        AS_2005, '#kidnapped-robot',
    ),
    'goals_large': Experiment(
        PAPER_2006, 'V, figures 8 and 10', 'an hour of exploration, six goals, 100 x 40 x 36',
        '6 of 6 goals, about 5,900 experiences', goals((100, 40)), GOALS_SHOWN, AS_2006,
        '#goals-on-a-university-floor',
    ),
    'goals_small': Experiment(
        PAPER_2006, 'V, figures 9, 11 and 12', 'the same with 40 x 20 x 36 cells',
        '6 of 6 goals, about 5,900 experiences, temporal map 10 ms', goals((40, 20)), GOALS_SHOWN,
        AS_2006, '#goals-on-a-university-floor',
    ),
    'goal_memory_small': Experiment(
        PAPER_2006, 'II.A, figure 4', 'two goals by goal memory, 40 x 20 x 36 cells',
        'no meaningful temporal map', goal_memory('small'), GOAL_MEMORY_SHOWN, AS_2005,
        '#goal-memory',
    ),
    'obstacle': Experiment(
        PAPER_2006, 'VI, figures 13 to 16', 'a box closes the short way, and is removed',
        '3 of 3 goals; links at the box unlearned, and learned again', obstacle,
        '{held} of {runs} as published', AS_2006, '#an-obstacle',
    ),
    'people_in_the_way': Experiment(
        PAPER_2006, 'VI', 'people stand in the way, for up to 60 s here, or walk along it',
        'people are not learned as obstacles; no figures', people_in_the_way,
        '{reached} of {goals} goals, {reached_alone} of {goals_alone} without people; links lost: '
        '{lost_10}, {lost_30} and {lost_60} to people who stand for 10, 30 and 60 s, '
        '{lost_walking} to people who walk, {lost_alone} without people; not made again: '
        '{for_good}; '
        'the short way in {short} of {runs} after that', AS_2006, '#people-in-the-way',
    ),
    'loop': Experiment(
        PAPER_2006, 'VII', 'a loop of 122 m, along the left wall',
        'closed at the first traverse; drift 8.5 m and 6.7 m', loop,
        '{closed} of {runs} closed, drift {drift_m:.1f} m, {wrong} wrong closures, RMSE of the '
        'map {map_m:.2f} m', AS_2006, '#a-loop-of-122-m',
    ),
    'memory_size': Experiment(
        PAPER_2006, 'VII', 'memory of 6,000 experiences',
        '40 MB, up to 6.7 kB for each; temporal map 10 ms', memory_size,
        '{kb:.1f} kB for each of {experiences:.0f} experiences; temporal map {times_ms:.0f} ms',
        AS_2006, 'maps.md',
    ),
    'pruning': Experiment(
        PAPER_2008, '', 'two hours with a limit of experiences', 'no figures', pruning,
        '{limited:.0f} of {free:.0f} experiences after {minutes:.0f} minutes, RMSE of the map '
        '{limited_m:.2f} m instead of {free_m:.2f} m; {reached} of {goals} goals', AS_2006,
        '#pruning',
    ),
    'mapping': Experiment(
        PAPER_MEMORY, 'V, figure 1', 'mapping with three observations per step',
        'the map is correct', mapping, '{within:.0%} within 2 SD, RMS {rms_m:.2f} m',
        section='landmarks.md#mapping',
    ),
    'relocalisation_normal': Experiment(
        PAPER_MEMORY, 'table 1', 'relocalisation, normal features',
        'x -1.30 +- 20.73, y -0.58 +- 26.74',
        relocalisation('normal', '3 seen, angle 80 degrees'), RELOCALISATION_SHOWN, LANDMARKS,
        'landmarks.md#relocalisation-1',
    ),
    'relocalisation_distinct': Experiment(
        PAPER_MEMORY, 'table 1', 'relocalisation, distinct features',
        'x -0.12 +- 0.41, y 0.09 +- 0.39', relocalisation('distinct', '3 seen'),
        RELOCALISATION_SHOWN, LANDMARKS,
        'landmarks.md#relocalisation-1',
    ),
    'memory': Experiment(
        PAPER_MEMORY, 'figures 2 and 3', 'mapping with a limit of features',
        'faster, with larger errors', memory,
        'limit 20: {limited_ms:.2f} ms, RMS {limited_m:.2f} m; none: {free_ms:.2f} ms, '
        '{free_m:.2f} m',
        section='landmarks.md#memory-1',
    ),
    'memory_relocalisation': Experiment(
        PAPER_MEMORY, 'figure 4', 'relocalisation with a limit of 80 features', 'successful',
        memory_relocalisation, 'limit 80: {limited} of {tries} right; none: {free}',
        section='landmarks.md#relocalisation-with-a-limited-memory',
    ),
    **{
        name: Experiment(
            PAPER_2013, '', f'{title} data with preset `{name}`', published, data_set(name),
            DATA_SET_SHOWN, ((STAND_IN, name, 0),), '#data-sets-of-openratslam',
        )
        for name, title, published in (
            ('irat', 'iRat', 'a map'),
            (
                'stlucia', 'St Lucia',
                'a map; more than 51 loops closed on 66 km (Milford and Wyeth 2008)',
            ),
            ('newcollege', 'New College', 'a map'),
        )
    },
}


def combined(results: Sequence[Result]) -> Result:
    """Return the sums of integers and the means of floats of several runs."""
    return {
        key: sum(result[key] for result in results) if isinstance(value, int)
        else navigation.mean([float(result[key]) for result in results])
        for key, value in results[0].items()
    }


def table(results: Results) -> str:
    """Return the table of all experiments in Markdown."""
    lines = [
        '| experiment | published | as published | with our presets |',
        '| --- | --- | --- | --- |',
    ]
    for name, x in EXPERIMENTS.items():
        cells = []
        for setting in ('published', OURS):
            found, label = results.get(name, {}), ''
            kinds = [setting, STAND_IN] if setting == 'published' else [setting]
            rows = found.get(setting, {})
            if not rows and STAND_IN in kinds and STAND_IN in found:
                rows, label = found[STAND_IN], f'{STAND_IN}: '
            text = 'not run' if any(kind in kinds for kind, *_ in x.presets) else 'no preset'
            if rows:
                figures = x.shown.format_map(combined(list(rows.values())))
                text = f'{label}{figures} (seed{"s" * (len(rows) > 1)} {", ".join(rows)})'
            cells.append(text)
        title = f'[`{name}`]({x.section})' if x.section else f'`{name}`'
        part = ', '.join(filter(None, (x.paper, x.part)))
        lines.append(f'| {title}: {part}: {x.subject} | {x.published} | {" | ".join(cells)} |')
    return '\n'.join(lines) + '\n'


def with_table(page: str, results: Results) -> str:
    """Return a page with the present table between its marks."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f'{before}{BEGIN}\n{table(results)}\n{END}{after}'


def load(path: Path) -> Results:
    """Return the stored results, which may be absent."""
    results: Results = json.loads(path.read_text('utf-8')) if path.exists() else {}
    return results


def store(path: Path, results: Results) -> None:
    """Replace the stored results; an interruption leaves the old or the new ones."""
    path.parent.mkdir(parents=True, exist_ok=True)
    written = path.with_suffix('.new')
    written.write_text(json.dumps(results, indent=1, sort_keys=True) + '\n', 'utf-8')
    os.replace(written, path)


def run(
    names: Sequence[str], seeds: Sequence[int], path: Path, setting: Setting, again: bool = False
) -> None:
    """Run the experiments whose results are not stored yet, and store each result."""
    results = load(path)
    jobs = [
        (name, *preset, seed)
        for name in names
        for preset in EXPERIMENTS[name].presets for seed in seeds
        if again or str(seed) not in results.get(name, {}).get(preset[0], {})
    ]
    with tqdm(jobs, unit='run', disable=None) as progress:
        for name, kind, config, rate_hz, seed in progress:
            progress.set_description(f'{name}, {config}, seed {seed}')
            x = EXPERIMENTS[name]
            out = setting.out / name / kind
            out.mkdir(parents=True, exist_ok=True)
            found = x.run(
                replace(setting, config=config, camera_rate_hz=rate_hz, out=out), seed
            )
            rounded = {
                key: value if isinstance(value, int) or not math.isfinite(value)
                else round(value, 3)
                for key, value in found.items()
            }
            results.setdefault(name, {}).setdefault(kind, {})[str(seed)] = rounded
            store(path, results)
            progress.write(f'{name}, {config}, seed {seed}: {x.shown.format_map(rounded)}')


def main() -> None:
    """Run experiments, and write the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').partition('\n')[0])
    parser.add_argument('experiment', nargs='*', metavar='EXPERIMENT', help=', '.join(EXPERIMENTS))
    parser.add_argument('--seeds', type=int, default=2, help='number of seeds (default: 2)')
    parser.add_argument('--first', type=int, default=3, help='first seed (default: 3)')
    parser.add_argument(
        '--minutes', type=float, default=0.0, help="exploration time instead of the experiment's"
    )
    parser.add_argument('--again', action='store_true', help='repeat stored results')
    parser.add_argument('--results', type=Path, default=ROOT / 'benchmarks/papers.json')
    parser.add_argument('--out', type=Path, default=Path('results/papers'), help='pictures')
    parser.add_argument('--data', type=Path, help='folder of recordings of Ball et al. (2013)')
    parser.add_argument('--docs', type=Path, default=ROOT / 'docs/experiments.md')
    options = parser.parse_args()
    unknown = [name for name in options.experiment if name not in EXPERIMENTS]
    if unknown:
        parser.error(f'unknown: {", ".join(unknown)}; expected: {", ".join(EXPERIMENTS)}')
    if options.data:
        use_recordings(options.data)
    setting = Setting('', 1.0, 0, options.out, options.minutes)
    seeds = range(options.first, options.first + options.seeds)
    run(options.experiment or list(EXPERIMENTS), seeds, options.results, setting, options.again)
    page = options.docs.read_text('utf-8')
    options.docs.write_text(with_table(page, load(options.results)), 'utf-8')


if __name__ == '__main__':
    main()
