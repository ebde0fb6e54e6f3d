# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""benchmarks/papers.py: stored results, the table in the docs, and short forms of experiments."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import papers
import pytest

from ratslam_ros.core.common.pose import Pose
from ratslam_simulator.samples import ImageSample

ROOT = Path(__file__).resolve().parents[1]
FIRST = {'right': 3, 'tries': 10, 'x_m': 1.0, 'x_sd_m': 2.0, 'y_m': 3.0, 'y_sd_m': 4.0}


@pytest.fixture
def setting(tmp_path: Path):
    return papers.Setting('', 1.0, 0, tmp_path, 0.0)


def test_table_in_docs_is_that_of_stored_results() -> None:
    page = (ROOT / 'docs/experiments.md').read_text('utf-8')
    stored = papers.load(ROOT / 'benchmarks/papers.json')
    assert page == papers.with_table(page, stored)
    assert set(stored) <= set(papers.EXPERIMENTS)


def test_table_combines_seeds_and_names_missing_results() -> None:
    results = {'relocalisation_normal': {'ours': {'3': FIRST, '4': {**FIRST, 'right': 5}}}}
    lines = papers.table(results).splitlines()
    assert len(lines) == 2 + len(papers.EXPERIMENTS)
    [line] = [line for line in lines if 'relocalisation_normal' in line]
    assert '| not run | x 1.00 +- 2.00, y 3.00 +- 4.00; 8 of 20 right (seeds 3, 4) |' in line
    assert lines[2].endswith('| not run | not run |')
    assert lines[-1].endswith('| not run | no preset |')
    with_nan = [{'m': 1.0}, {'m': float('nan')}, {'m': 2.0}]
    assert papers.combined(with_nan) == {'m': 1.5}


def test_interrupted_run_continues_after_stored_results(
    setting, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[int] = []

    def fails_at_second(_: object, seed: int) -> dict[str, float]:
        ran.append(seed)
        if len(ran) == 2:
            raise KeyboardInterrupt
        return {**FIRST, 'right': seed}

    name, path = 'relocalisation_normal', tmp_path / 'results.json'
    presets = papers.EXPERIMENTS[name].presets[1:]
    changed = replace(papers.EXPERIMENTS[name], run=fails_at_second, presets=presets)
    monkeypatch.setitem(papers.EXPERIMENTS, name, changed)
    with pytest.raises(KeyboardInterrupt):
        papers.run([name], [1, 2, 3], path, setting)
    papers.run([name], [1, 2, 3], path, setting)
    assert ran == [1, 2, 2, 3]
    assert {seed: row['right'] for seed, row in json.loads(path.read_text())[name]['ours'].items()
            } == {'1': 1, '2': 2, '3': 3}
    papers.run([name], [3], path, setting, again=True)
    assert ran == [1, 2, 2, 3, 3]


def test_robot_of_2006_does_not_look_back(setting) -> None:
    found = {}
    for config, looks_back in (('milford2006', False), ('milford2006', True), ('pioneer', False)):
        made = replace(setting, config=config, looks_back=looks_back).loop(1, 'obstacle_loop')
        found[config, looks_back] = made.exploration._look_backs
    assert found['milford2006', False] == papers.navigation.LOOK_BACKS_2006
    assert found['milford2006', True] == found['pioneer', False]


def test_robot_of_2005_has_sonars_and_draws_occupancy(setting) -> None:
    loops = {
        config: replace(setting, config=config).loop(1, 'obstacle_loop')
        for config in ('milford2005', 'navigation')
    }
    has_sonars = {name: x.simulator.options.sonars is not None for name, x in loops.items()}
    assert has_sonars == {'milford2005': True, 'navigation': False}
    for name, loop in loops.items():
        grid = papers.navigation.watched_by_sonar(loop)
        loop.explore(2.0)
        papers.navigation.draw_driven(loop, grid, 0, setting.out / f'{name}.png')
        assert (grid.percent() >= 0).any() == has_sonars[name]
        assert (setting.out / f'{name}.png').exists() == has_sonars[name]


def test_exploration_runs_with_sonars(setting) -> None:
    row = papers.navigation.exploration_run(replace(setting, minutes=0.3), (3, True))
    assert (row.seed, row.sensor, row.collisions) == (3, 'sonars', 0)
    assert row.driven_m > 1.0 and row.speed_mps == pytest.approx(row.driven_m / 18.0)
    assert row.squares >= 2


def test_people_who_stand_for_ten_seconds_delay_the_robot(
    setting, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(papers.navigation, 'TO_START_S', 0.0)
    loop = setting.loop(3, 'obstacle_loop', papers.navigation.LookBacks(every_m=np.inf))
    loop.explore(2.0)
    loop.name_place('G')  # near S: the robot turns round at the other end of the corridor
    at = {'G': loop.simulator.truth[:2]}
    at['S'] = loop.simulator.plan.places['G']
    loop.explore(18.0)
    row = papers.navigation.people_trial(loop, at, '10 s', 1.0)
    assert row.met and row.reached
    assert row.lost == row.lost_for_good == 0
    assert row.took_s > 26.0  # 20.9 s without people
    assert len(loop.simulator.world.people) == 0


def test_goal_memory_draws_figures_and_counts_views(
    setting, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(papers.navigation, 'NAMING_INTERVAL_S', 5.0)
    name, path = 'goal_memory', tmp_path / 'results.json'
    presets = papers.EXPERIMENTS[name].presets[:1]
    monkeypatch.setitem(
        papers.EXPERIMENTS, name, replace(papers.EXPERIMENTS[name], presets=presets)
    )
    papers.run([name], [3], path, replace(setting, minutes=0.3))
    drawn = sorted(file.name for file in tmp_path.rglob('*.png'))
    assert drawn == sorted(f'figure_{number}.png' for number in range(6, 11))
    [row] = papers.load(path)[name]['published'].values()
    assert row['goals'] == 2 and row['views'] > 10
    assert row['minutes'] > 0.3 and row['driven_m'] > 1.0


def test_irregular_rate_halves_images_in_alternate_stretches() -> None:
    image, other = ImageSample(0, np.zeros((1, 1), np.uint8), Pose(0.0, 0.0, 0.0)), object()
    loop = SimpleNamespace(now_s=0.0, simulator=SimpleNamespace(step=lambda: [other, image]))
    papers.navigation.make_irregular(loop)
    counts = []
    for loop.now_s in (5.0, 15.0, 25.0, 35.0):
        samples = [loop.simulator.step() for _ in range(20)]
        assert all(other in found for found in samples)
        counts.append(sum(image in found for found in samples))
    assert counts == [20, 10, 20, 10]


def test_hypotheses_converge_without_a_unique_view() -> None:
    """Milford et al. (2005), section II.D, with their preset."""
    found = papers.two_corridors_run(papers.parameters_of('milford2005'), 0)
    assert max(found.packets) >= 4 and found.errors_cells[0] > 20.0
    assert found.views_count == 3
    assert max(found.errors_cells[2:]) < 1.0


@pytest.mark.parametrize('is_first_slow', [False, True])
def test_faster_of_two_routes_is_planned_until_blocked(is_first_slow: bool) -> None:
    routes = papers.two_routes_run('navigation', is_first_slow)
    assert routes.takes_fast
    assert routes.fast_s == pytest.approx(18.0, abs=1.0)
    assert 2 <= routes.tries_count <= 8


def test_recording_takes_the_place_of_its_stand_in(
    setting, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, path = 'newcollege', tmp_path / 'results.json'
    monkeypatch.setitem(papers.EXPERIMENTS, name, papers.EXPERIMENTS[name])  # restored afterwards
    papers.run([name], [1], path, replace(setting, minutes=0.25))
    cell = papers.table(papers.load(path)).splitlines()[-1].split(' | ')[-2]
    assert cell.startswith('stand-in: ') and cell.endswith(' (seed 1)')
    bag = tmp_path / 'data' / 'newcollege_2008.bag'
    bag.parent.mkdir()
    papers.write_stand_in(bag, name, 1, 15.0)
    papers.use_recordings(bag.parent)
    papers.run([name], [1], path, setting)
    assert papers.table(papers.load(path)).splitlines()[-1].split(' | ')[-2] == cell[10:]
    [row] = papers.load(path)[name]['published'].values()
    assert row['experiences'] > 10 and row['map_m'] < 1.0
    bag.with_suffix('.tum').unlink()
    papers.run([name], [1], path, setting, again=True)
    [row] = papers.load(path)[name]['published'].values()
    assert np.isnan(row['map_m'])


ALIKE = {'goal_memory', 'goal_memory_small', 'irregular_rate', 'goals_large', 'irat', 'stlucia',
         'newcollege', 'relocalisation_distinct'}
"""Experiments that run the code of another one with other values, or that of a test above."""


@pytest.mark.parametrize('name', sorted(papers.EXPERIMENTS.keys() - ALIKE))
def test_short_experiment_fills_its_columns(
    setting, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Explore for half a minute, with the preset of the paper if the experiment has one."""
    for module, limit, value in (
        (papers.navigation, 'GOALS_COUNT', 1), (papers.navigation, 'CARRIES_COUNT', 1),
        (papers.navigation, 'MAX_LOST_S', 5.0), (papers.navigation, 'FOUND_S', 5.0),
        (papers.navigation, 'NAMING_INTERVAL_S', 35.0 if name == 'pruning' else 5.0),
        (papers.navigation, 'RING_LENGTH_M', 10.0),
        (papers.navigation, 'ONWARD_M', 0.0), (papers.landmarks, 'LIMITS', (20, 0)),
        (papers.landmarks, 'KIDNAPS_COUNT', 3), (papers, 'WORLDS_COUNT', 1),
    ):
        monkeypatch.setattr(module, limit, value)
    x, path = papers.EXPERIMENTS[name], tmp_path / 'results.json'
    monkeypatch.setitem(papers.EXPERIMENTS, name, replace(x, presets=x.presets[:1]))
    # A robot is carried 8 m away; a map of 60 experiences is pruned.
    minutes = 0.8 if name in ('kidnapped', 'kidnapped_goals', 'pruning') else 0.3
    papers.run([name], [5], path, replace(setting, minutes=minutes))
    [[row]] = [list(found.values()) for found in papers.load(path)[name].values()]
    assert x.shown.format_map(row)
    counts = [row[key] for key in ('goals', 'tries', 'runs', 'carries') if key in row]
    assert 0 not in counts or name == 'people_in_the_way'  # it has not passed S and G
