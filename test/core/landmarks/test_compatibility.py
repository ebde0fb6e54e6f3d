# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Chi-square tests of pairs: unary, binary and joint."""

from __future__ import annotations

import math

import numpy as np
import pytest
from landmark_worlds import features, in_frame, mapped, seen, world
from scipy.optimize import least_squares
from scipy.stats import chi2, kstest

from ratslam_ros.core.landmarks.compatibility import (
    UnusableFeatures,
    add_pair,
    binary_compatible,
    chi_square_limits,
    empty_fit,
    freedom,
    geometry_of,
    pose_covariance,
    unary_compatible,
)
from ratslam_ros.core.landmarks.features import Features

POSE = (3.0, -2.0, 2.5)


def joint_distance(fit, observed, known, order):
    distance2 = 0.0
    for level, i in enumerate(order):
        distance2 = add_pair(observed, known, fit, level, int(i), int(i))
    return distance2


def test_unary_test_compares_type_and_length_only() -> None:
    bars = [np.array([0.0, 0.0, 0.0, 1.0]), np.array([9.0, 9.0, 2.0, 1.2]), np.array([5.0, 5.0])]
    d = 10
    observed = geometry_of(features(bars[:1], 0.01 * np.eye(4)))
    known = geometry_of(features(bars, 0.01 * np.eye(d)))
    assert unary_compatible(observed, known, 9.0).tolist() == [[True, True, False]]
    assert unary_compatible(observed, known, 1.0).tolist() == [[True, False, False]]


@pytest.mark.parametrize('point_share', [0.0, 0.5, 1.0])
def test_binary_test_accepts_true_pairs_at_its_level(point_share: float) -> None:
    rng = np.random.default_rng(3)
    accepted, wrong, tested = 0, 0, 0
    limit = float(chi_square_limits(0.99, 1)[1])
    for _ in range(40):
        rows = world(rng, 12, 15.0, point_share)
        observed = geometry_of(seen(rng, rows, POSE, 100.0))
        known = geometry_of(mapped(rng, rows, full=True))
        for i in range(0, 12, 2):
            other = (i + 3) % 12
            tested += 1
            accepted += binary_compatible(observed, known, i, i, i + 1, i + 1, limit)
            wrong += rows[other].size == rows[i + 1].size and binary_compatible(
                observed, known, i, i, i + 1, other, limit
            )
    # A pair of bars passes four tests of 1 % each, which are correlated.
    assert accepted / tested > 0.94
    assert wrong / tested < 0.25


def test_line_to_coincident_feature_is_not_tested() -> None:
    rows = [np.array([1.0, 1.0, 0.0, 1.0]), np.array([1.0, 1.0, 2.0, 1.0])]
    geometry = geometry_of(features(rows, 0.01 * np.eye(8)))
    turned = geometry_of(features([rows[0], rows[1] + [0.0, 0.0, 1.0, 0.0]], 0.01 * np.eye(8)))
    assert binary_compatible(geometry, geometry, 0, 0, 1, 1, 6.6)
    assert not binary_compatible(geometry, turned, 0, 0, 1, 1, 6.6)  # by relative direction


@pytest.mark.parametrize('point_share', [0.0, 0.5, 1.0])
def test_joint_test_equals_least_squares_fit(point_share: float) -> None:
    """Compare with a general-purpose optimiser over the three values of the pose."""
    rng = np.random.default_rng(11)
    rows = world(rng, 6, 10.0, point_share)
    known_features = mapped(rng, rows, full=True)
    seen_features = seen(rng, rows, POSE, 100.0)
    observed, known, fit = geometry_of(seen_features), geometry_of(known_features), empty_fit(6)
    distance2 = joint_distance(fit, observed, known, range(6))
    d = len(seen_features.values)

    def whitened(pose):
        there = in_frame(seen_features, tuple(pose))
        residuals = known_features.values - there.values
        for o, is_bar in zip(there.offsets, there.are_bars, strict=False):
            if is_bar:
                residuals[o + 2] = math.remainder(residuals[o + 2], math.tau)
        # The covariance is that at the fitted pose.
        fitted = in_frame(seen_features, tuple(fit.fitted[6])).covariance
        root = np.linalg.cholesky(fitted + known_features.covariance + 1e-8 * np.eye(d))
        return np.linalg.solve(root, residuals)

    best = least_squares(whitened, fit.fitted[6], xtol=1e-12)
    assert freedom(fit, 6) == d - 3
    assert distance2 == pytest.approx(2.0 * best.cost, rel=0.03, abs=0.02)
    sds = np.sqrt(np.diagonal(pose_covariance(fit, 6)))
    assert (np.abs(best.x - fit.fitted[6]) < 0.05 * sds).all()
    np.testing.assert_allclose(
        pose_covariance(fit, 6), np.linalg.inv(best.jac.T @ best.jac), rtol=0.1, atol=1e-5
    )


def test_distance_of_true_pairs_is_chi_square_distributed() -> None:
    rng = np.random.default_rng(5)
    levels = []
    for _ in range(300):
        rows = world(rng, 4, 15.0, 0.3)
        observed = geometry_of(seen(rng, rows, POSE, 100.0))
        known = geometry_of(mapped(rng, rows, full=True))
        fit = empty_fit(4)
        distance2 = joint_distance(fit, observed, known, range(4))
        levels.append(chi2.cdf(distance2, freedom(fit, 4)))
    assert kstest(levels, 'uniform').pvalue > 0.01


def test_result_does_not_depend_on_what_was_tested_before() -> None:
    rng = np.random.default_rng(8)
    rows = world(rng, 5, 10.0, 0.5)
    observed, known = geometry_of(seen(rng, rows, POSE, 100.0)), geometry_of(mapped(rng, rows))
    fresh, reused = empty_fit(5), empty_fit(5)
    for order in rng.permuted(np.tile(np.arange(5), (20, 1)), axis=1):
        joint_distance(reused, observed, known, order)
    joint_distance(fresh, observed, known, range(4))
    joint_distance(reused, observed, known, range(4))
    for wrong in (0, 2, 3):
        add_pair(observed, known, reused, 4, 4, wrong)
    assert add_pair(observed, known, fresh, 4, 4, 4) == add_pair(observed, known, reused, 4, 4, 4)


def test_too_few_pairs_do_not_determine_pose() -> None:
    rng = np.random.default_rng(1)
    points = world(rng, 2, 10.0, 1.0)
    observed, known = geometry_of(seen(rng, points, POSE, 100.0)), geometry_of(mapped(rng, points))
    fit = empty_fit(2)
    assert add_pair(observed, known, fit, 0, 0, 1) == 0.0
    assert freedom(fit, 1) == 0
    add_pair(observed, known, fit, 1, 1, 0)
    assert freedom(fit, 2) == 1


@pytest.mark.parametrize(
    ('changes', 'reason'),
    [
        ({'values': np.array([0.0, math.nan])}, 'not finite'),
        ({'covariance': np.full((2, 2), math.inf)}, 'not finite'),
        ({'covariance': -np.eye(2)}, 'negative'),
        ({'covariance': np.eye(3)}, 'shape'),
        ({'offsets': np.array([0, 3])}, 'steps of 2'),
    ],
)
def test_invalid_features_are_refused(changes: dict, reason: str) -> None:
    fields = {
        'identifiers': np.array([0]), 'offsets': np.array([0, 2]), 'values': np.zeros(2),
        'covariance': np.eye(2),
    } | changes
    with pytest.raises(UnusableFeatures, match=reason):
        geometry_of(Features(**fields))
