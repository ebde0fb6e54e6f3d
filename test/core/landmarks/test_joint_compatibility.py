# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Branch and bound finds the largest set of compatible pairs; the printed bound may miss it."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from landmark_worlds import features, mapped, moved, seen, world
from published_relocalisation import search_jointly_compatible

from ratslam_ros.core.landmarks.compatibility import (
    add_pair,
    chi_square_limits,
    empty_fit,
    freedom,
    geometry_of,
    unary_compatible,
)

POSE = (3.0, -2.0, 2.5)


def largest_set(observed, known, level=0.99) -> int:
    """Return the size of the largest set by testing all assignments."""
    seen_geometry, known_geometry = geometry_of(observed), geometry_of(known)
    n = len(observed)
    limits = chi_square_limits(level, 4 * n)
    unary = unary_compatible(seen_geometry, known_geometry, limits[1])
    choices = [[-1, *np.flatnonzero(row).tolist()] for row in unary]
    most = 0
    for assignment in itertools.product(*choices):
        pairs = [(i, j) for i, j in enumerate(assignment) if j >= 0]
        if len({j for _, j in pairs}) < len(pairs) or len(pairs) <= most:
            continue
        fit = empty_fit(n)
        if all(
            add_pair(seen_geometry, known_geometry, fit, level, i, j)
            <= limits[freedom(fit, level + 1)]
            for level, (i, j) in enumerate(pairs)
        ):
            most = len(pairs)
    return most


@settings(max_examples=12, deadline=None)
@given(
    st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 5), st.sampled_from([0.0, 0.5, 1.0])
)
def test_search_equals_all_assignments(seed: int, n: int, m: int, point_share: float) -> None:
    rng = np.random.default_rng(seed)
    rows = world(rng, m, 4.0, point_share)
    known = mapped(rng, rows, full=True)
    # Some observations are of other features, and the noise makes wrong pairs likely.
    rows = [rows[k] if k < m and rng.random() < 0.7 else world(rng, 1, 4.0, point_share)[0]
            for k in range(n)]
    observed = seen(rng, rows, POSE, 100.0, noise=4.0)
    most = largest_set(observed, known)
    found = {
        bound: search_jointly_compatible(observed, known, bound=bound)
        for bound in ('correct', 'exhaustive', 'printed')
    }
    assert len(found['correct'].pairs) == len(found['exhaustive'].pairs) == most
    assert len(found['printed'].pairs) <= most
    assert found['correct'].nodes <= found['exhaustive'].nodes
    assert found['correct'].is_complete


def test_printed_bound_misses_largest_set() -> None:
    """An observation that fits a wrong feature is never left out by the printed rule."""
    lengths = [5.0, 1.0, 2.0, 3.0]
    places = [(30.0, 30.0), (0.0, 0.0), (2.0, 1.0), (1.0, 3.0)]
    known = [np.array([*p, 0.3 * k, length]) for k, (p, length) in
             enumerate(zip(places, lengths, strict=True))]
    # A bar of 5 m that is not on the map stands beside the three others.
    around = [np.array([4.0, 4.0, 1.0, 5.0]), *known[1:]]
    covariance = 1e-3 * np.eye(16)
    seen_features = features(moved(around, (1.0, 2.0, 0.5)), covariance)
    known_features = features(known, covariance)
    correct = search_jointly_compatible(seen_features, known_features)
    printed = search_jointly_compatible(seen_features, known_features, bound='printed')
    assert correct.pairs.tolist() == [[1, 1], [2, 2], [3, 3]]
    assert printed.pairs.tolist() == [[0, 0]]


def test_search_finds_all_true_pairs() -> None:
    rng = np.random.default_rng(2)
    rows = world(rng, 6, 10.0)
    found = search_jointly_compatible(seen(rng, rows, POSE, 100.0), mapped(rng, rows))
    assert found.pairs.tolist() == [[k, k] for k in range(6)]


def test_limit_of_nodes_ends_search() -> None:
    rng = np.random.default_rng(2)
    rows = world(rng, 10, 5.0, 1.0)
    found = search_jointly_compatible(
        seen(rng, rows, POSE, 100.0), mapped(rng, rows), bound='exhaustive', max_nodes=1000
    )
    assert found.nodes == 1000 and not found.is_complete


def test_nothing_seen_gives_no_pairs() -> None:
    rng = np.random.default_rng(2)
    found = search_jointly_compatible(
        features([], np.zeros((0, 0))), mapped(rng, world(rng, 3, 5))
    )
    assert len(found.pairs) == 0 and found.is_complete
