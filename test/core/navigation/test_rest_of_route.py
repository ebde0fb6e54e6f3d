# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ratslam_ros.core.driving.goal_follower import PASSED_M, rest_of

BEND = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])


def test_what_is_passed_is_left_out():
    assert rest_of(BEND, 0.5, 0.1).tolist() == [[0.5, 0.0], [1.0, 0.0], [1.0, 1.0]]
    assert rest_of(BEND, 1.2, 0.4).tolist() == [[1.0, 0.4], [1.0, 1.0]]
    assert rest_of(BEND, 3.0, 3.0).tolist() == [[1.0, 1.0], [1.0, 1.0]]
    assert rest_of(BEND, -1.0, 0.0).tolist() == BEND.tolist()


def test_a_route_of_one_place_or_of_places_on_each_other_stays():
    assert rest_of(BEND[:1], 5.0, 5.0).tolist() == [[0.0, 0.0]]
    twice = np.array([[1.0, 1.0], [1.0, 1.0], [2.0, 1.0]])
    assert rest_of(twice, 1.5, 1.0).tolist() == [[1.5, 1.0], [2.0, 1.0]]


def test_the_way_back_is_not_taken_for_the_way_there():
    there_and_back = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 0.2], [0.0, 0.2]])
    left = rest_of(there_and_back, 1.0, 0.19)
    assert left[0].tolist() == [1.0, 0.0]
    assert len(left) == 4


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 20))
def test_driving_along_a_route_uses_it_up_and_never_goes_back(seed, size):
    rng = np.random.default_rng(seed)
    route = np.cumsum(rng.normal(0.0, 0.3, (size, 2)), axis=0)
    driven = np.concatenate(
        [a + np.linspace(0.0, 1.0, 9)[:, None] * (b - a) for a, b in zip(route, route[1:])]  # noqa: B905, RUF007
    )
    left, length_m = route, np.hypot(*np.diff(route, axis=0).T).sum()
    for x_m, y_m in driven + rng.normal(0.0, 0.05, driven.shape):
        left = rest_of(left, x_m, y_m)
        now_m = np.hypot(*np.diff(left, axis=0).T).sum()
        assert length_m - PASSED_M - np.hypot(*np.diff(route, axis=0).T).max() <= now_m
        assert now_m <= length_m + 1e-9
        assert left[-1] == pytest.approx(route[-1])
        length_m = now_m
