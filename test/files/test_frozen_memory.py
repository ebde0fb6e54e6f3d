# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Memory files of the first released format stay readable; see test/data/memory/README.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import ahead

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.goal_memory.goal_memory import GoalMemory
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.late_join import LateJoin
from ratslam_ros.core.mapping.scan_matching import ScanMatcher
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.vision.local_view import LocalView, ViewMatch
from ratslam_ros.files.config import load_config
from ratslam_ros.files.memory import load

FOLDER = Path(__file__).parents[1] / 'data' / 'memory'


@pytest.fixture(scope='module')
def config() -> Config:
    preset, _ = load_config('navigation')
    return preset.with_values({'pose_cells.exp_max': 40, 'goal_memory.goal_memory': True})


def read(part: str) -> Any:
    return load(FOLDER / f'{part}.npz', part)


def assert_same(found: Any, saved: Any, at: str) -> None:
    """Check that a state contains a saved one, arrays by type and content.

    The present version has more entries, and arrays instead of long lists.
    """
    if isinstance(saved, np.ndarray):
        assert found.dtype == saved.dtype, at
        assert np.array_equal(found, saved), at
    elif isinstance(saved, dict):
        assert found.keys() >= saved.keys(), at
        for key, value in saved.items():
            assert_same(found[key], value, f'{at}.{key}')
    elif isinstance(saved, list) and isinstance(found, np.ndarray):
        assert found.tolist() == saved, at
    elif isinstance(saved, list):
        assert len(found) == len(saved), at
        for n, value in enumerate(saved):
            assert_same(found[n], value, f'{at}[{n}]')
    else:
        assert found == saved, at


def test_local_view_restores_all_templates(config: Config) -> None:
    saved = read('local_view')['core']
    core = LocalView(config.local_view)
    core.restore(saved)
    assert len(core) == 226
    assert_same(core.state(), saved, 'local_view')


def test_pose_cells_restore_and_continue(config: Config) -> None:
    saved = read('pose_cells')
    core = PoseCells(config.pose_cells)
    core.restore(saved['core'])
    del saved['core']['unrolled']['claimed']  # of the parameter pc_vt_agree_near, removed since
    assert_same(core.state(), saved['core'], 'pose_cells')
    core.integrate(ahead(0.1))
    action = core.view(ViewMatch(226, True, 0.2, 0.0))
    assert action.action in ('create', 'link', 'set', 'none')
    memory = GoalMemory(config.pose_cells)
    memory.restore(saved['goal_memory'])
    assert list(memory.goals) == ['goal_1']
    assert_same(memory.state(), saved['goal_memory'], 'goal_memory')


def test_experience_map_restores_graph_scans_and_goals(config: Config) -> None:
    saved = read('experience_map')
    core = ExperienceMap(config.experience_map)
    core.restore(saved['core'])
    assert (len(core), core.link_count, core.current_id) == (40, 41, 29)
    assert core.pose_of(29) != Pose(0.0, 0.0, 0.0)
    notes = saved['core'].pop('notes')
    assert_same(core.state(), saved['core'], 'experience_map')
    assert [[one.duration_s, one.behaviour, one.count] for one in core.links()] == notes
    again = ExperienceMap(config.experience_map)
    again.restore(core.state())
    assert again.links() == core.links()
    late_join = LateJoin(core)
    late_join.restore(saved['joining'])
    assert_same(late_join.state(), saved['joining'], 'joining')
    scans = ScanMatcher()
    scans.restore(saved['scans'])
    ids, sizes, points = (saved['scans'][name] for name in ('ids', 'sizes', 'points'))
    for number, scan in zip(ids.tolist(), np.split(points, np.cumsum(sizes)[:-1]), strict=True):
        assert np.array_equal(scans.reference(number), scan)
    assert sum(scans.state()['sizes']) == len(points)
    (named,) = saved['goals']['named']
    assert named[0] == 'place_1'
