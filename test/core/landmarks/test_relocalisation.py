# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relocalisation finds the place, reports candidates if several match, and never guesses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from landmark_worlds import features, in_frame, mapped, moved, seen, world

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.landmarks.features import Features
from ratslam_ros.core.landmarks.place_search import RelocalisationParameters
from ratslam_ros.core.landmarks.relocalisation import KnownFeatures, Relocalisation, relocalise

PARAMETERS = RelocalisationParameters()
POSE = (12.0, 17.0, 2.5)


def bytes_of(result: Relocalisation) -> bytes:
    places = b''.join(
        np.array(p.pose).tobytes() + p.covariance.tobytes() + p.pairs.tobytes()
        + np.float64(p.probability).tobytes()
        for p in result.places
    )
    return places + repr((result.outcome, result.draws, result.search_nodes)).encode()


def empty() -> Features:
    return features([], np.zeros((0, 0)))


@pytest.mark.parametrize('point_share', [0.0, 0.5, 1.0])
@pytest.mark.parametrize('full', [False, True])
def test_place_is_found_with_consistent_covariance(point_share: float, full: bool) -> None:
    rng = np.random.default_rng(4)
    rows = world(rng, 80, 30.0, point_share)
    known = KnownFeatures(mapped(rng, rows, full=full))
    errors2 = []
    for seed in range(20):
        pose = (*rng.uniform(8.0, 22.0, 2), rng.uniform(-math.pi, math.pi))
        result = relocalise(seen(rng, rows, pose, 8.0), known, PARAMETERS, seed)
        assert result.outcome == 'found', (seed, result)
        (place,) = result.places
        error = np.array(place.pose) - pose
        error[2] = math.remainder(error[2], math.tau)
        errors2.append(error @ np.linalg.solve(place.covariance, error))
        assert np.hypot(*error[:2]) < 0.4
        assert place.probability >= 0.999 and result.missed <= 0.001
    assert 1.5 < np.mean(errors2) < 5.0  # Expected: 3, with a standard deviation of 0.55.


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.5, 1.0]))
def test_frame_and_order_do_not_matter(seed: int, point_share: float) -> None:
    rng = np.random.default_rng(seed)
    rows = world(rng, 60, 25.0, point_share)
    known, observed = mapped(rng, rows, full=True), seen(rng, rows, POSE, 8.0)
    frame = Pose(*rng.uniform(-50.0, 50.0, 2), rng.uniform(-math.pi, math.pi))
    order, known_order = rng.permutation(len(observed)), rng.permutation(len(known))
    first = relocalise(observed, known, PARAMETERS, 1)
    second = relocalise(
        observed.selected(order), in_frame(known.selected(known_order), frame), PARAMETERS, 1
    )
    assert first.outcome == second.outcome
    assert len(first.places) == len(second.places)
    for a, b in zip(first.places, second.places, strict=True):
        moved_pose = composed(frame, a.pose)
        assert math.dist(moved_pose[:2], b.pose[:2]) < 1e-6
        assert abs(math.remainder(moved_pose[2] - b.pose[2], math.tau)) < 1e-6
        pairs = sorted((int(order[i]), int(known_order[j])) for i, j in b.pairs)
        assert pairs == [tuple(pair) for pair in a.pairs.tolist()]


@pytest.mark.parametrize('point_share', [0.0, 1.0])
def test_repeated_world_is_ambiguous_with_all_candidates(point_share: float) -> None:
    rng = np.random.default_rng(6)
    part = world(rng, 30, 15.0, point_share)
    rows = part + moved(part, (40.0, 0.0, 1.0)) + moved(part, (0.0, 60.0, -2.0))
    result = relocalise(seen(rng, part, (7.0, 8.0, 1.0), 7.0), mapped(rng, rows), PARAMETERS, 3)
    assert result.outcome == 'ambiguous'
    assert len(result.places) == 3
    expected = [(7.0, 8.0, 1.0)]
    for frame in ((40.0, 0.0, 1.0), (0.0, 60.0, -2.0)):
        expected.append(tuple(composed(Pose(*frame), Pose(7.0, 8.0, 1.0))))
    for pose in expected:
        assert min(math.dist(pose[:2], place.pose[:2]) for place in result.places) < 0.3
    assert sum(place.probability for place in result.places) > 0.999


def test_symmetric_room_is_ambiguous() -> None:
    """A square room of four equal walls looks the same after each quarter turn."""
    walls = [np.array([3.0, -3.0, math.pi / 2, 6.0])]
    for _ in range(3):
        walls += moved(walls[-1:], (0.0, 0.0, math.pi / 2))
    rng = np.random.default_rng(6)
    parameters = RelocalisationParameters(error=0.05)
    far = moved(world(rng, 80, 60.0), (50.0, 50.0, 0.0))
    result = relocalise(seen(rng, walls, (1.0, 0.5, 0.0), 9.0), mapped(rng, walls + far),
                        parameters, 3)
    assert result.outcome == 'ambiguous'
    assert len(result.places) == 4


@pytest.mark.parametrize('count', [0, 1, 3])
def test_too_few_observations_are_not_here(count: int) -> None:
    rng = np.random.default_rng(1)
    rows = world(rng, 20, 10.0)
    few = seen(rng, rows, POSE, 100.0).selected(np.arange(count))
    assert relocalise(few, mapped(rng, rows), PARAMETERS, 0).outcome == 'not here'
    assert relocalise(few, empty(), PARAMETERS, 0).outcome == 'not here'


def test_spurious_observations_are_left_out() -> None:
    rng = np.random.default_rng(13)
    rows = world(rng, 60, 25.0)
    others = world(rng, 7, 25.0)
    known = mapped(rng, rows)
    mixed = seen(rng, rows[:10] + others, POSE, 100.0)
    result = relocalise(mixed, known, PARAMETERS, 0)
    assert result.outcome == 'found'
    assert {(int(i), int(j)) for i, j in result.places[0].pairs} >= {(k, k) for k in range(8)}
    assert all(i == j for i, j in result.places[0].pairs)


def test_equal_seeds_give_equal_bytes() -> None:
    rng = np.random.default_rng(2)
    rows = world(rng, 60, 25.0, 0.5)
    observed, known = seen(rng, rows, POSE, 8.0), mapped(rng, rows)
    results = [relocalise(observed, known, PARAMETERS, seed) for seed in (7, 7, -7)]
    results.append(relocalise(observed, KnownFeatures(known), PARAMETERS, 7))
    assert bytes_of(results[0]) == bytes_of(results[1]) == bytes_of(results[3])
    assert results[2].outcome == 'found'


def test_too_few_draws_do_not_exclude_competitors() -> None:
    rng = np.random.default_rng(2)
    rows = world(rng, 60, 25.0)
    observed, known = seen(rng, rows, POSE, 8.0), mapped(rng, rows)
    hurried = relocalise(observed, known, RelocalisationParameters(draws=1), 0)
    assert hurried.draws == 1 and hurried.missed > 0.001
    assert hurried.outcome != 'found'


def test_vague_observations_end_search_without_result() -> None:
    """With errors of metres, nearly every set of features is compatible."""
    rng = np.random.default_rng(2)
    rows = world(rng, 60, 25.0)
    vague = features(moved(rows[:4], (1.0, 2.0, 3.0)), 4.0 * np.eye(sum(map(len, rows[:4]))))
    parameters = RelocalisationParameters(nodes=20_000)
    result = relocalise(vague, mapped(rng, rows), parameters, 0)
    assert result.outcome != 'found' and result.draws == 0 and result.missed == 1.0
    assert 20_000 <= result.search_nodes < 40_000


def test_thousand_features_are_searched() -> None:
    rng = np.random.default_rng(21)
    rows = world(rng, 1000, 100.0, 1.0)
    known = KnownFeatures(mapped(rng, rows))
    many = relocalise(seen(rng, rows, (50.0, 50.0, 1.0), 12.0), known, PARAMETERS, 0)
    assert many.outcome == 'found'
    np.testing.assert_allclose(many.places[0].pose, (50.0, 50.0, 1.0), atol=0.3)


def test_thousand_observations_are_thinned_out() -> None:
    rng = np.random.default_rng(21)
    rows = world(rng, 1000, 100.0)
    known = KnownFeatures(mapped(rng, rows[:200]))
    near = seen(rng, rows, (50.0, 50.0, 1.0), 100.0)
    assert len(near) == 1000
    parameters = RelocalisationParameters(share=0.1, draws=2000)
    thinned = relocalise(near, known, parameters, 0)
    assert thinned.outcome == 'found' and len(thinned.places[0].pairs) <= 40
