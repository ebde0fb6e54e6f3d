# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relocalisation as Kahn and Mazor (2002) print it: unary and binary tests, guess and proof."""

from __future__ import annotations

import math

import numpy as np
import pytest
from landmark_worlds import features, mapped, seen, world
from published_relocalisation import (
    equally_far,
    hypotheses,
    oriented_alike,
    relocalise_as_published,
)

from ratslam_ros.core.landmarks.compatibility import chi_square_limits, geometry_of

LIMIT = float(chi_square_limits(0.99, 1)[1])
"""6.63: an angle of a variance of 0.02 rad^2 passes within 0.364 rad."""


def bars(*rows: tuple[float, float, float, float], variance: float = 0.01):
    return features([np.array(row) for row in rows], variance * np.eye(4 * len(rows)))


def test_unary_test_is_that_of_the_angle_of_orientation() -> None:
    observed = geometry_of(bars((0.0, 0.0, 0.5, 2.0)))
    known = geometry_of(bars(
        (5.0, 5.0, 0.5 + 0.3, 9.0), (5.0, 5.0, 0.5 + 0.3 + 0.36, 2.0),
        (5.0, 5.0, 0.5 + 0.3 + 0.37, 2.0), (5.0, 5.0, 0.5 + 0.3 + math.tau - 0.36, 2.0),
    ))
    found = oriented_alike(observed, known, 0.3, LIMIT)
    assert found.tolist() == [[True, True, False, True]]  # whatever the length


def test_binary_test_is_that_of_the_difference_of_distances() -> None:
    """Distances have a variance of 0.02 m^2 each: 2.576 * 0.2 = 0.515 m."""
    observed = geometry_of(bars((0.0, 0.0, 0.0, 1.0), (3.0, 4.0, 1.0, 1.0)))
    for far_m, passes in ((5.5, True), (4.5, True), (5.53, False)):
        known = geometry_of(bars((0.0, 0.0, 2.0, 1.0), (0.0, far_m, 2.5, 1.0)))
        assert equally_far(observed, known, 0, 0, 1, 1, LIMIT) == passes  # whatever the direction


def test_hypotheses_are_all_features_that_pass_both_tests() -> None:
    observed = geometry_of(bars((0.0, 0.0, 0.0, 1.0), (2.0, 0.0, 0.0, 1.0)))
    known = geometry_of(bars(*((2.0 * n, 0.0, 0.0, 1.0) for n in range(4))))
    found = hypotheses(observed, known, np.ones((2, 4), np.bool_), [1, 0], LIMIT)
    assert found == [(0, 1), (1, 0), (1, 2), (2, 1), (2, 3), (3, 2)]


@pytest.mark.parametrize('seed', range(2))
def test_robot_with_compass_is_found_among_distinct_angles(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, pose = world(rng, 40, 30.0), (14.0, 16.0, 2.5)
    observed = seen(rng, rows, pose, 9.0)
    found = relocalise_as_published(observed, mapped(rng, rows), pose[2], seed)
    assert found is not None
    assert found.pose[:2] == pytest.approx(pose[:2], abs=0.3)
    assert len(found.pairs) >= len(observed) - 1


def test_angles_that_fit_nothing_give_no_place() -> None:
    rng = np.random.default_rng(1)
    rows, pose = world(rng, 4, 10.0), (5.0, 5.0, 0.0)
    observed = seen(rng, rows, pose, 20.0)
    assert relocalise_as_published(observed, mapped(rng, rows), 1.3, 0) is None


def test_three_observations_with_common_angles_are_a_guess() -> None:
    """Table 1: the largest set is the answer, so that a wrong place of the same size is one."""
    observed = bars((0.0, 0.0, 0.0, 1.0), (3.0, 0.0, 0.0, 1.0), (0.0, 4.0, 0.0, 1.0))
    corners = (0.0, 0.0), (3.0, 0.0), (0.0, 4.0)
    known = bars(*((20.0 * n + x, y, 0.0, 1.0) for n in range(3) for x, y in corners))
    places = set()
    for seed in range(12):
        found = relocalise_as_published(observed, known, 0.0, seed)
        assert found is not None and len(found.pairs) == 3
        places.add(round(found.pose.x_m / 20.0))
    assert places == {0, 1, 2}
