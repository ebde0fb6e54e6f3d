# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""States that were saved are accepted; numbers that would lead out of an array are not."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import original, picture
from hypothesis import given, settings
from hypothesis import strategies as st
from states import differences, filed

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import checked_scan
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.id_map import IdMap
from ratslam_ros.core.mapping.late_join import LateJoin
from ratslam_ros.core.pose_cells.attractor import Network, kernel
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import load_config
from ratslam_ros.maps.state_check import RULES, check_state
from ratslam_ros.pipeline.ratslam import RatSLAM

States = dict[str, dict[str, Any]]
STEP_NS = 10**8


def driven(slam: RatSLAM, steps: int) -> States:
    """Drive a circle with twelve views, scans and odometry; return the states."""
    random = np.random.default_rng(1)
    views = [random.integers(0, 256, (48, 64), dtype=np.uint8) for _ in range(12)]
    for step in range(steps):
        at_ns = (step + 10) * STEP_NS
        slam.odometry(Odometry(at_ns, Twist(0.5, 0.3), Pose(0.05 * step, 0.0, 0.0)))
        ranges = 2.0 + np.cos(np.arange(31) + step % 12)
        slam.scan(checked_scan(at_ns, -1.5, 0.1, 0.1, 10.0, ranges))
        slam.image(at_ns, views[step % 12])
    return slam.state()


@pytest.fixture(scope='module')
def states() -> States:
    config, _ = load_config('navigation')
    return driven(RatSLAM(config.with_values({
        'experience_map.exp_align_scans': True, 'goal_memory.goal_memory': True,
    })), 40)  # fmt: skip


@pytest.mark.parametrize('preset', ['auto', 'default', 'navigation'])
@pytest.mark.parametrize('steps', [0, 1, 5])
def test_state_of_any_age_is_accepted(preset: str, steps: int) -> None:
    config, _ = load_config(preset)
    for part, state in driven(RatSLAM(config), steps).items():
        check_state(part, state)


def test_most_rules_apply_to_a_state(states: States) -> None:
    for part, state in states.items():
        check_state(part, state)
    found = [
        rule.path for part in RULES for rule in RULES[part] if _has(states[part], rule.path)
    ]
    assert len(found) > 0.9 * sum(map(len, RULES.values()))


def _has(state: Any, path: str) -> bool:
    for key in path.split('/'):
        if key not in state:
            return False
        state = state[key]
    return True


@pytest.mark.parametrize(('path', 'value'), [
    ('experience_map/core/ends', 10**6), ('experience_map/core/ends', -1),
    ('experience_map/core/poses', math.nan), ('experience_map/core/current', 40),
    ('experience_map/core/current', None), ('experience_map/core/way_m', 'far'),
    ('experience_map/scans/ids', 2**40), ('pose_cells/core/gaps/ways_m', None),
    ('pose_cells/core/transitions', 39), ('pose_cells/core/dims', 0),
    ('goal_memory/ends', 2**30), ('goal_memory/cells', 10**9),
    ('pose_cells/core/visits/counts', np.zeros(3, np.int64)),
    ('experience_map/core/shapes', np.zeros((2, 3))),
])  # fmt: skip
def test_number_out_of_range_is_refused(states: States, path: str, value: Any) -> None:
    changed = copy.deepcopy(states)
    part, *keys = path.split('/')
    if part == 'goal_memory':
        part, keys = 'pose_cells', ['goal_memory', *keys]
    container: Any = changed[part]
    for key in keys[:-1]:
        container = container[key]
    old = container[keys[-1]]
    if isinstance(old, (np.ndarray, list)) and len(old) and isinstance(value, (int, float)):
        if isinstance(old, list):
            old[0] = value
        else:
            old.reshape(-1)[0] = value
    else:
        container[keys[-1]] = value
    with pytest.raises(UnusableInput, match=r'expected|does not consist'):
        check_state(part, changed[part])


@pytest.mark.parametrize(('key', 'value'), [
    ('box', np.array([0, 0, 10**6, 14, 14, 14])), ('box', np.zeros(6, np.int64)),
    ('box', np.array([0, -(10**6), 0, 14, 14, 14])),
    ('frame', np.array([0.0, math.nan, 0.0])), ('cells', np.full((14, 14, 14), -1.0)),
])  # fmt: skip
def test_packet_outside_of_the_pose_cells_is_refused(
    states: States, key: str, value: Any
) -> None:
    changed = copy.deepcopy(states['pose_cells'])
    changed['core']['packets'][0][key] = value
    with pytest.raises(UnusableInput, match='boxes on the torus'):
        check_state('pose_cells', changed)


@settings(max_examples=30)
@given(st.lists(st.tuples(*[st.floats(0.0, 4.0)] * 3), min_size=1, max_size=10))
def test_packets_across_the_edge_of_the_torus_are_accepted(
    places: list[tuple[float, float, float]],
) -> None:
    network = Network((40, 40, 40), kernel(7, 1.0), kernel(5, 2.0), 0.00002)
    packets = network.start()
    for place in places:
        packets = network.inject(packets, *place, 0.1)
        found = [packet._asdict() for packet in packets]
        check_state('pose_cells', {'core': {'dims': [40, 40, 40], 'packets': found}})
        packets = network.step(packets, 0.4, 0.0)


def test_saved_state_is_checked(states: States, tmp_path: Path) -> None:
    state = copy.deepcopy(states['experience_map'])
    assert filed({'experience_map': state}, tmp_path)
    state['core']['ends'][0] = 999
    with pytest.raises(UnusableInput, match='core/ends'):
        filed({'experience_map': state}, tmp_path)


def test_state_of_another_size_is_rejected() -> None:
    config = original().with_values({'pose_cells.pc_dim_x': 50})
    with pytest.raises(UnusableInput, match='pc_dim_x'):
        PoseCells(config.pose_cells).restore(PoseCells(original('pose_cells')).state())
    core = LocalView(original('local_view'))
    core.match(picture(0, 48, 64))
    config = original().with_values({'local_view.template_y_size': 8})
    with pytest.raises(UnusableInput, match='template_y_size'):
        LocalView(config.local_view).restore(core.state())


def test_id_map_and_late_join_are_restored(tmp_path: Path) -> None:
    numbering, graph = IdMap(), ExperienceMap(original('experience_map'))
    numbering.set_memory(3)
    numbering.own_id(9)
    numbering.set_memory(4)
    joining = LateJoin(graph)
    found = filed({'pose_cells': {'a': numbering.state(), 'b': joining.state()}}, tmp_path)
    again, joined = IdMap(), LateJoin(graph)
    again.restore(found['pose_cells']['a'])
    joined.restore(found['pose_cells']['b'])
    assert again.own_id(0) == numbering.own_id(0) == 10
    assert list(differences(joined.state(), joining.state())) == []
