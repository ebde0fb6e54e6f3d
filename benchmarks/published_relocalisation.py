# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relocalisation as Kahn and Mazor (2002) print it, for comparison with the package.

Section III: a unary test of the angle of orientation, a binary test of the difference between the
distances, and the joint test; JCBB with the printed bound; random sampling that splits the
observations into a guess, by unary and binary tests only, and a proof by JCBB. There is no test
whether another place matches as well: the largest set of pairs is the answer.

The angle of orientation of a feature can be compared only in one frame, so the robot's heading
must be known, as by a compass. The paper does not say so, but its table 1 has no heading.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.landmarks.compatibility import (
    VARIANCE_FLOOR,
    Geometry,
    add_pair,
    chi_square_limits,
    empty_fit,
    freedom,
    geometry_of,
    unary_compatible,
)
from ratslam_ros.core.landmarks.features import BAR_SIZE, Features
from ratslam_ros.core.landmarks.joint_compatibility import (
    CORRECT,
    EXHAUSTIVE,
    PRINTED,
    search,
)
from ratslam_ros.core.landmarks.place_search import exchange

Bound = Literal['correct', 'printed', 'exhaustive']

BOUNDS: dict[Bound, int] = {'correct': CORRECT, 'printed': PRINTED, 'exhaustive': EXHAUSTIVE}
"""Searches by name, see core/landmarks/joint_compatibility.py."""

LEVEL = 0.99
"""Level of the chi-square tests; the paper does not give it."""

MAX_NODES = 5000
"""Joint tests that prove one guess; then the largest set so far is used."""


@dataclass(frozen=True)
class JointlyCompatible:
    """The result of a search.

    Attributes:
        pairs: (k, 2) indices of the observed and the known feature.
        nodes: number of joint tests.
        is_complete: False if the limit of nodes was reached.
    """

    pairs: NDArray[np.int64]
    nodes: int
    is_complete: bool


def search_jointly_compatible(
    seen: Features,
    known: Features,
    level: float = 0.99,
    bound: Bound = 'correct',
    max_nodes: int = 10_000_000,
) -> JointlyCompatible:
    """Return the largest set of jointly compatible pairs, without random sampling.

    Args:
        seen: observed features, in the robot's frame.
        known: features of the map.
        level: level of the chi-square tests.
        bound: the search, see core/landmarks/joint_compatibility.py.
        max_nodes: number of joint tests after which the best set so far is returned.
    """
    observed, mapped = geometry_of(seen), geometry_of(known)
    n = len(seen)
    limits = chi_square_limits(level, BAR_SIZE * n + 1)
    unary = unary_compatible(observed, mapped, limits[1])
    starts = np.concatenate(([0], np.cumsum(unary.sum(axis=1)))).astype(np.int64)
    fit, best = empty_fit(n), empty_fit(n)
    count, nodes = search(
        observed, mapped, fit, 0, np.arange(n), starts, np.nonzero(unary)[1], limits,
        np.zeros(len(known), np.bool_), BOUNDS[bound], 0, max_nodes, best,
    )
    return JointlyCompatible(
        np.stack((best.seen[:count], best.known[:count]), axis=1), nodes, nodes < max_nodes
    )


@dataclass(frozen=True)
class PublishedPlace:
    """The answer: the largest set of pairs that was found.

    Attributes:
        pose: of the robot, in the frame of the map.
        pairs: (k, 2) indices of the observed and the known feature.
    """

    pose: Pose
    pairs: NDArray[np.int64]


def relocalise_as_published(
    seen: Features, known: Features, heading_rad: float, seed: int, sample: int = 3,
    guesses: int = 200,
) -> PublishedPlace | None:
    """Find the robot's pose on a map by what it sees.

    Args:
        seen: observed bars, in the robot's frame.
        known: bars of the map.
        heading_rad: heading of the robot on the map.
        seed: of the random choice of the observations for the guess.
        sample: number of these (p of section III.C).
        guesses: largest number of guesses that are proven, in random order; the paper has none.

    Returns:
        The place; None if nothing fits the sample.
    """
    observed, mapped = geometry_of(seen), geometry_of(known)
    n = len(seen)
    limits = chi_square_limits(LEVEL, BAR_SIZE * n + 1)
    unary = oriented_alike(observed, mapped, heading_rad, limits[1])
    order = shuffled(n, seed, 0)
    first, rest = order[:sample].tolist(), order[sample:]
    starts = np.concatenate(([0], np.cumsum(unary[rest].sum(axis=1)))).astype(np.int64)
    candidates = np.nonzero(unary[rest])[1]
    found = hypotheses(observed, mapped, unary, first, limits[1])
    fit, best = empty_fit(n), empty_fit(n)
    largest: list[tuple[int, int]] = []
    for guess in (found[k] for k in shuffled(len(found), seed, n)[:guesses].tolist()):
        used = np.zeros(len(known), np.bool_)
        for level, (i, j) in enumerate(zip(first, guess, strict=True)):
            add_pair(observed, mapped, fit, level, i, j)
            used[j] = True
        for k, pair in enumerate(zip(first, guess, strict=True)):
            best.seen[k], best.known[k] = pair
        count, _ = search(
            observed, mapped, fit, sample, rest, starts, candidates, limits, used,
            PRINTED, max(len(largest), sample), MAX_NODES, best,
        )
        if count > len(largest):
            pairs = np.stack((best.seen[:count], best.known[:count]), axis=1)
            largest = [(i, j) for i, j in pairs.tolist()]
        if len(largest) == n:
            break
    if not largest:
        return None
    for level, (i, j) in enumerate(largest):
        add_pair(observed, mapped, fit, level, i, j)
    if freedom(fit, len(largest)) == 0:
        return None
    pose = Pose(*fit.fitted[len(largest)].tolist())
    return PublishedPlace(pose, np.array(largest, np.int64))


def shuffled(count: int, seed: int, first: int) -> NDArray[np.int64]:
    """Return the numbers from 0 to ``count`` - 1 in random order.

    Args:
        count: how many.
        seed: of the random order.
        first: number of the first random number that is used.
    """
    items = np.arange(count)
    for k in range(count):
        exchange(items, k, seed, first + k)
    return items


def oriented_alike(
    seen: Geometry, known: Geometry, heading_rad: float, limit: float
) -> NDArray[np.bool_]:
    """Return the (n_seen, n_known) result of the unary test of the angles of orientation.

    Args:
        seen, known: the two sets of features.
        heading_rad: heading of the robot, whose frame the observed angles are in.
        limit: quantile of the chi-square distribution with one degree of freedom.
    """
    variances = [np.diagonal(one.covariance)[one.offsets + 2] for one in (seen, known)]
    off = np.subtract.outer(seen.values[:, 2] + heading_rad, known.values[:, 2])
    off = (off + math.pi) % math.tau - math.pi
    return np.asarray(off * off <= limit * (np.add.outer(*variances) + VARIANCE_FLOOR))


def equally_far(
    seen: Geometry, known: Geometry, i: int, j: int, i2: int, j2: int, limit: float
) -> bool:
    """Return the result of the binary test: the difference between the distances."""
    off_m = seen.distances[i, i2] - known.distances[j, j2]
    variance = seen.distance_variances[i, i2] + known.distance_variances[j, j2]
    return bool(off_m * off_m <= limit * variance)


def hypotheses(
    seen: Geometry, known: Geometry, unary: NDArray[np.bool_], sample: list[int], limit: float
) -> list[tuple[int, ...]]:
    """Return all known features for a sample of observations that pass unary and binary tests."""
    found: list[tuple[int, ...]] = [()]
    for i in sample:
        candidates = np.flatnonzero(unary[i]).tolist()
        found = [
            (*chosen, j) for chosen, j in itertools.product(found, candidates)
            if j not in chosen and all(
                equally_far(seen, known, i, j, i2, j2, limit)
                for i2, j2 in zip(sample, chosen, strict=False)
            )
        ]
    return found
