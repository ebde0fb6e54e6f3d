# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The part of a route that is still ahead of the robot."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ratslam_ros.core.driving.goal_follower import MAX_PASSED_M, remaining_route

BEND = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])


def test_passed_part_is_removed():
    assert remaining_route(BEND, 0.5, 0.1).tolist() == [[0.5, 0.0], [1.0, 0.0], [1.0, 1.0]]
    assert remaining_route(BEND, 1.2, 0.4).tolist() == [[1.0, 0.4], [1.0, 1.0]]
    assert remaining_route(BEND, 3.0, 3.0).tolist() == [[1.0, 1.0], [1.0, 1.0]]
    assert remaining_route(BEND, -1.0, 0.0).tolist() == BEND.tolist()


def test_route_of_coincident_points_is_kept():
    assert remaining_route(BEND[:1], 5.0, 5.0).tolist() == [[0.0, 0.0]]
    twice = np.array([[1.0, 1.0], [1.0, 1.0], [2.0, 1.0]])
    assert remaining_route(twice, 1.5, 1.0).tolist() == [[1.5, 1.0], [2.0, 1.0]]


def test_parallel_way_back_is_not_matched():
    there_and_back = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 0.2], [0.0, 0.2]])
    left = remaining_route(there_and_back, 1.0, 0.19)
    assert left[0].tolist() == [1.0, 0.0]
    assert len(left) == 4


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 20))
def test_driving_along_route_never_moves_backwards(seed, size):
    rng = np.random.default_rng(seed)
    route = np.cumsum(rng.normal(0.0, 0.3, (size, 2)), axis=0)
    driven = np.concatenate(
        [a + np.linspace(0.0, 1.0, 9)[:, None] * (b - a) for a, b in zip(route, route[1:])]  # noqa: B905, RUF007
    )
    left, length_m = route, np.hypot(*np.diff(route, axis=0).T).sum()
    for x_m, y_m in driven + rng.normal(0.0, 0.05, driven.shape):
        left = remaining_route(left, x_m, y_m)
        now_m = np.hypot(*np.diff(left, axis=0).T).sum()
        assert length_m - MAX_PASSED_M - np.hypot(*np.diff(route, axis=0).T).max() <= now_m
        assert now_m <= length_m + 1e-9
        assert left[-1] == pytest.approx(route[-1])
        length_m = now_m
