# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from synthetic_runs import SyntheticRun

from ratslam_ros.history.run_state import RunState
from ratslam_ros.viewer.scene import Pick
from ratslam_ros.viewer.scene.picking import TOLERANCE, pick


@pytest.fixture(scope='module')
def state() -> RunState:
    return SyntheticRun(400).state()


def aimed(origin: tuple[float, float, float], target: np.ndarray, state: RunState) -> Pick | None:
    return pick(origin, np.array([*target, 0.0]) - origin, state)


@pytest.mark.parametrize('origin', [(0.0, 0.0, 5.0), (30.0, -20.0, 12.0), (1.0, 2.0, 60.0)])
def test_ray_to_experience_picks_it(state, origin) -> None:
    for number in 0, 57, 399:
        found = aimed(origin, state.map.poses[number, :2], state)
        assert found is not None
        assert (found.kind, found.id) == ('experience', number)
        np.testing.assert_allclose(found.point[:2], state.map.poses[number, :2], atol=1e-9)


def test_tolerance_grows_with_camera_distance(state) -> None:
    x, y = state.map.poses.min(axis=0)[:2]
    off = (x - 0.3, y - 0.3)
    gap = np.hypot(*(state.map.poses[:, :2] - off).T).min()
    for factor, kind in (0.9, 'ground'), (1.1, 'experience'):
        height = gap / TOLERANCE * factor
        found = pick((*off, height), (0, 0, -1), state)
        assert found is not None
        assert found.kind == kind


def test_ray_between_experiences_picks_closure() -> None:
    run = SyntheticRun(200)
    state = run.state()
    for record in run.close():
        state.apply(record)
    source, target = run.closures[-1]
    middle = state.map.poses[[source, target], :2].mean(axis=0)
    found = pick((*middle, 3.0), (0, 0, -2), state)
    assert found is not None
    assert found.kind == 'closure'
    assert found.ends == (source, target)


@pytest.mark.parametrize(
    ('origin', 'direction'),
    [((0, 0, 5), (0, 0, 1)), ((0, 0, 5), (1, 0, 0)), ((0, 0, 5), (0, 0, 0)),
     ((0, 0, np.nan), (0, 0, -1)), ((0, 0, 5), (np.nan, 0, -1))],
)
def test_ray_without_ground_picks_nothing(state, origin, direction) -> None:
    assert pick(origin, direction, state) is None


def test_empty_map_gives_ground() -> None:
    assert pick((1, 2, 3), (0, 0, -1), RunState()) == Pick('ground', (1.0, 2.0, 0.0))


def test_experiences_without_pose_are_not_picked() -> None:
    run = SyntheticRun(50)
    state = run.state()
    state.map.poses[10] = np.nan
    x, y = run.poses[10, :2]
    found = pick((x, y, 0.5), (0, 0, -1), state)
    assert found is not None
    assert found.id != 10
