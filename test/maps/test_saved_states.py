# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""States that were saved are accepted; values that are not as declared are refused."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import extended, picture
from hypothesis import given, settings
from hypothesis import strategies as st
from states import filed

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.saved import Field, Saved, check, found
from ratslam_ros.core.common.scan import checked_scan
from ratslam_ros.core.pose_cells.attractor import Network, kernel
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import load_config
from ratslam_ros.maps.part import STAGES
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
    })), 40)


def checked(states: States) -> None:
    for part, state in states.items():
        if part in STAGES:
            check(STAGES[part], state, part, {})


def declared(kind: type[Saved], state: Any) -> Iterator[tuple[Any, str, Field]]:
    """Yield what contains each declared value of a state, its key, and its field."""
    for field in kind.SAVED:
        *groups, key = field.key.split('/')
        container = found(state, '/'.join(groups))
        if field.part and (not key or key in container):
            yield from declared(field.part, container[key] if key else container)
        elif key in container:
            yield container, key, field


@pytest.mark.parametrize('preset', ['auto', 'default', 'navigation'])
@pytest.mark.parametrize('steps', [0, 1, 5])
def test_state_of_any_age_is_accepted(preset: str, steps: int) -> None:
    checked(driven(RatSLAM(load_config(preset)[0]), steps))


def test_every_value_of_a_state_is_declared(states: States) -> None:
    for part in states.keys() & STAGES.keys():
        left = copy.deepcopy(states[part])
        for container, key, _ in [*declared(STAGES[part], left)]:
            del container[key]
        assert not [*leaves(left)]


def leaves(state: Any) -> Iterator[Any]:
    if not isinstance(state, dict):
        yield state
    else:
        for value in state.values():
            yield from leaves(value)


def test_every_declared_value_is_checked(states: States) -> None:
    changed = copy.deepcopy(states)
    checked(changed)
    count = 0
    for part in states.keys() & STAGES.keys():
        for container, key, field in [*declared(STAGES[part], changed[part])]:
            old = container[key]
            for value in alterations(field, old):
                container[key] = value
                with pytest.raises(UnusableInput, match=f'^{part}.*expected') as caught:
                    check(STAGES[part], changed[part], part, {})
                assert '\n' not in str(caught.value)
                count += 1
            container[key] = old
    assert count > 300


def alterations(field: Field, value: Any) -> Iterator[Any]:
    """Yield values that the field of a value does not permit."""
    yield 7 if field.dtype in (str, list, dict, object) else 'far'
    if field.dtype in (str, list, dict, object):
        return
    yield np.zeros((1, 2, 3, 4, 5), np.int64)
    numbers = np.array(value, np.float64)
    if numbers.size and field.low != -math.inf:
        large = 10**6 if isinstance(field.high, str) else 1e300
        for wrong in (math.nan, -1e300, *([large] if field.high != math.inf else [])):
            numbers.flat[0] = wrong
            yield numbers.tolist()


@pytest.mark.parametrize(('key', 'value'), [
    ('box', np.array([0, 0, 10**6, 14, 14, 14])), ('box', np.zeros(6, np.int64)),
    ('box', np.array([0, -(10**6), 0, 14, 14, 14])),
    ('frame', np.array([0.0, math.nan, 0.0])), ('cells', np.full((14, 14, 14), -1.0)),
])
def test_packet_outside_of_the_pose_cells_is_refused(states: States, key: str, value: Any) -> None:
    changed = copy.deepcopy(states)
    changed['pose_cells']['core']['packets'][0][key] = value
    with pytest.raises(UnusableInput, match='boxes on the torus'):
        checked(changed)


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
        checked({'pose_cells': {'core': {'dims': [40, 40, 40], 'packets': found}}})
        packets = network.step(packets, 0.4, 0.0)


def test_saved_state_is_checked(states: States, tmp_path: Path) -> None:
    state = copy.deepcopy(states['experience_map'])
    assert filed({'experience_map': state}, tmp_path)
    state['core']['ends'][0] = 999
    with pytest.raises(UnusableInput, match='core/ends'):
        filed({'experience_map': state}, tmp_path)


def test_state_of_another_size_is_rejected() -> None:
    config = extended().with_values({'pose_cells.pc_dim_x': 50})
    with pytest.raises(UnusableInput, match='pc_dim_x'):
        PoseCells(config.pose_cells).restore(PoseCells(extended('pose_cells')).state())
    core = LocalView(extended('local_view'))
    core.match(picture(0, 48, 64))
    config = extended().with_values({'local_view.template_y_size': 8})
    with pytest.raises(UnusableInput, match='template_y_size'):
        LocalView(config.local_view).restore(core.state())
