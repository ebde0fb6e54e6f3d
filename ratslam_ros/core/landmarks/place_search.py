# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled loops of relocalisation: sampling of observations, and verification.

`relocalisation.py` describes the method.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.landmarks.compatibility import (
    Fit,
    Geometry,
    add_pair,
    binary_compatible,
    empty_fit,
    freedom,
    pose_covariance,
)
from ratslam_ros.core.landmarks.joint_compatibility import search
from ratslam_ros.core.landmarks.place_evidence import (
    Grid,
    box,
    log_choose,
    log_evidence,
    log_position_density,
)

_MAX_PLACES = 100
"""Places that are compared; further ones replace the least probable."""

_MAX_NODES = 5000
"""Joint tests that verify one hypothesis; then the largest set so far is used."""


class Neighbours(NamedTuple):
    """Known features by their distance from each other, and the largest variances."""

    order: NDArray[np.int64]
    """(n, n) features by increasing distance from feature a, in row a."""
    distances: NDArray[np.float64]
    """(n, n) the distances."""
    distance_variance: float
    """Largest variance of a distance."""
    position_variance: float
    """Largest sum of the variances of x and y of a feature."""


class Effort(NamedTuple):
    """How thoroughly is searched, see ``RelocalisationParameters``.

    ``sample``: observations of a draw. ``least``: pairs that a place needs. ``draws``, ``nodes``:
    largest numbers of draws and of tests. ``error``: probability at which a competing place may
    be missed.
    """

    sample: int
    least: int
    draws: int
    nodes: int
    error: float


class Places(NamedTuple):
    """Places that explain the observations; of the rows, those below a number are in use."""

    assigned: NDArray[np.int64]
    """(places, n) known feature of each observation, or -1."""
    evidence: NDArray[np.float64]
    """(places,) logarithm of their evidence."""
    poses: NDArray[np.float64]
    """(places, 3) poses of the robot."""
    covariances: NDArray[np.float64]
    """(places, 3, 3) of these."""


class _Observations(NamedTuple):
    """A draw, and what fits the other observations at the pose of a hypothesis.

    ``drawn``: (n,) observations in random order, the sample first. ``is_drawn``: (n,) whether one
    is in the sample. ``order``, ``starts``, ``features``, ``distances2``: see ``_candidates``.
    """

    drawn: NDArray[np.int64]
    is_drawn: NDArray[np.bool_]
    order: NDArray[np.int64]
    starts: NDArray[np.int64]
    features: NDArray[np.int64]
    distances2: NDArray[np.float64]


@compiled
def _mixed(seed: int, counter: int) -> np.uint64:
    """Return pseudo-random bits (splitmix64, Steele, Lea and Flood 2014)."""
    bits = np.uint64(seed) + np.uint64(counter) * np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))


@compiled
def draw(items: NDArray[np.int64], k: int, seed: int, counter: int) -> None:
    """Exchange item k with a random one of those from k on (Fisher-Yates)."""
    other = k + np.int64(_mixed(seed, counter) % np.uint64(len(items) - k))
    items[k], items[other] = items[other], items[k]


@compiled
def _is_same_place(
    pose: NDArray[np.float64],
    covariance: NDArray[np.float64],
    other: NDArray[np.float64],
    covariance2: NDArray[np.float64],
    limit: float,
) -> bool:
    """Return whether two poses differ by no more than their covariances explain."""
    a, b, c = (
        covariance[0, 0] + covariance2[0, 0], covariance[0, 1] + covariance2[0, 1],
        covariance[0, 2] + covariance2[0, 2],
    )
    d, e, f = (
        covariance[1, 1] + covariance2[1, 1], covariance[1, 2] + covariance2[1, 2],
        covariance[2, 2] + covariance2[2, 2],
    )
    dx, dy, turn = pose[0] - other[0], pose[1] - other[1], wrap(pose[2] - other[2])
    xx, xy, xt = d * f - e * e, c * e - b * f, b * e - c * d
    yy, yt, tt = a * f - c * c, b * c - a * e, a * d - b * b
    scale = 1.0 / max(a * xx + b * xy + c * xt, 1e-300)
    distance2 = xx * dx * dx + yy * dy * dy + tt * turn * turn
    distance2 += 2.0 * (xy * dx * dy + xt * dx * turn + yt * dy * turn)
    return distance2 * scale <= limit


@compiled
def _candidates(
    seen: Geometry, known: Geometry, unary: NDArray[np.bool_], grid: Grid,
    limits: NDArray[np.float64], fit: Fit, level: int, variance: float, used: NDArray[np.bool_],
    least: int, found: _Observations,
) -> tuple[int, int]:
    """Find the features that fit each other observation at the pose of a hypothesis.

    Args:
        variance: largest position variance of a known feature.
        least: number of pairs that must be possible; the search ends as soon as it is not.
        found: its order, starts, features and distances2 receive the observations with
            candidates, and these, by increasing distance.

    Returns:
        the number of observations with candidates, -1 if there are too few; joint tests.
    """
    is_drawn, order, starts = found.is_drawn, found.order, found.starts
    features, distances2 = found.features, found.distances2
    n = len(seen.sizes)
    count, filled, tests = 0, 0, 0
    starts[0] = 0
    covariance = pose_covariance(fit, level)
    x, y, heading = fit.fitted[level, 0], fit.fitted[level, 1], fit.fitted[level, 2]
    c, s = math.cos(heading), math.sin(heading)
    for i in range(n):
        if is_drawn[i]:
            continue
        # The bound counts observations that can still get a candidate.
        rest = 0
        for k in range(i, n):
            rest += 0 if is_drawn[k] else 1
        if level + count + rest < least:
            return -1, tests
        sx, sy = seen.values[i, 0], seen.values[i, 1]
        px, py = x + c * sx - s * sy, y + s * sx + c * sy
        o = seen.offsets[i]
        spread = 2.0 * (covariance[0, 0] + covariance[1, 1])
        spread += 2.0 * covariance[2, 2] * (sx * sx + sy * sy) + variance
        spread += seen.covariance[o, o] + seen.covariance[o + 1, o + 1]
        radius = math.sqrt(limits[2] * spread)
        left, right, bottom, top = box(grid, px, py, radius)
        for row in range(bottom, top + 1):
            if left > right:
                break
            for item in range(
                grid.starts[row * grid.columns + left],
                grid.starts[row * grid.columns + right + 1],
            ):
                j = grid.items[item]
                if not unary[i, j] or used[j] or filled == len(features):
                    continue
                dx, dy = known.values[j, 0] - px, known.values[j, 1] - py
                if dx * dx + dy * dy > radius * radius:
                    continue
                tests += 1
                distance2 = add_pair(seen, known, fit, level, i, j)
                if distance2 > limits[freedom(fit, level + 1)]:
                    continue
                place = filled
                while place > starts[count] and distances2[place - 1] > distance2:
                    distances2[place], features[place] = distances2[place - 1], features[place - 1]
                    place -= 1
                distances2[place], features[place] = distance2, j
                filled += 1
        if filled > starts[count]:
            order[count] = i
            count += 1
            starts[count] = filled
    return count, tests


@compiled
def _verified(
    seen: Geometry, known: Geometry, unary: NDArray[np.bool_], grid: Grid,
    limits: NDArray[np.float64], fit: Fit, best: Fit, sample: int, variance: float,
    used: NDArray[np.bool_], needed: int, found: _Observations,
) -> tuple[int, int]:
    """Extend the pairs of a sample to the largest compatible set, which ``best`` receives.

    Args:
        fit: the pairs of the sample; further levels are used for the search.
        best: receives the pairs of the set.
        variance: largest position variance of a known feature.
        used: (total,) whether a known feature is in the sample.
        needed: number of pairs that the set must have.
        found: the draw.

    Returns:
        the number of pairs, 0 if there are too few; tests.
    """
    count, tests = _candidates(
        seen, known, unary, grid, limits, fit, sample, variance, used, needed, found
    )
    if count < 0 or sample + count < needed:
        return 0, tests
    for k in range(sample):
        best.seen[k], best.known[k] = fit.seen[k], fit.known[k]
    pairs, more = search(
        seen, known, fit, sample, found.order[:count], found.starts[: count + 1], found.features,
        limits, used, 0, max(needed - 1, sample - 1), _MAX_NODES, best,
    )
    return (pairs if pairs >= needed else 0), tests + more


@compiled
def _record(
    places: Places, count: int, fit: Fit, pairs: int, value: float, limit: float
) -> int:
    """Record a place with its evidence, unless it is known with more; return the number of places.

    If there is no room for a new place, it replaces the least probable one.
    """
    pose, covariance = fit.fitted[pairs], pose_covariance(fit, pairs)
    target = -1
    for other in range(count):
        if _is_same_place(
            pose, covariance, places.poses[other], places.covariances[other], limit
        ):
            target = other
            break
    if target < 0 and count < _MAX_PLACES:
        target = count
        count += 1
    elif target < 0:
        target = int(np.argmin(places.evidence[:count]))
    if value > places.evidence[target]:
        places.evidence[target] = value
        places.poses[target] = pose
        places.covariances[target] = covariance
        places.assigned[target] = -1
        for k in range(pairs):
            places.assigned[target, fit.seen[k]] = fit.known[k]
    return count


@compiled
def _is_recorded(
    assigned: NDArray[np.int64], drawn: NDArray[np.int64], features: NDArray[np.int64]
) -> bool:
    """Return whether a recorded place has the pairs of a sample.

    Args:
        assigned: (places, n) known feature of each observation.
        drawn, features: (sample,) observations and their features.
    """
    for place in range(len(assigned)):
        same = True
        for k in range(len(features)):
            same = same and assigned[place, drawn[k]] == features[k]
        if same:
            return True
    return False


@compiled
def search_places(
    seen: Geometry, known: Geometry, unary: NDArray[np.bool_], near: Neighbours, grid: Grid,
    limits: NDArray[np.float64], effort: Effort, seed: int,
) -> tuple[int, Places, int, int, float]:
    """Draw observations, find the places that explain them, and verify these.

    Returns:
        number of places; the places; draws; nodes; probability that a competing place was missed.
    """
    n, total, sample = len(seen.sizes), len(known.sizes), effort.sample
    places = Places(
        np.full((_MAX_PLACES, n), -1, np.int64), np.full(_MAX_PLACES, -math.inf),
        np.zeros((_MAX_PLACES, 3)), np.zeros((_MAX_PLACES, 3, 3)),
    )
    found = _Observations(
        np.arange(n), np.zeros(n, np.bool_), np.zeros(n, np.int64), np.zeros(n + 1, np.int64),
        np.zeros(64 * n, np.int64), np.zeros(64 * n),
    )
    drawn = found.drawn
    fit, best = empty_fit(n), empty_fit(n)
    used = np.zeros(total, np.bool_)
    features = np.zeros(sample, np.int64)
    place, end = np.zeros(sample, np.int64), np.zeros(sample, np.int64)

    range_m, log_position = log_position_density(seen)
    width = grid.columns * grid.cell_m + 2.0 * range_m
    height = grid.rows * grid.cell_m + 2.0 * range_m
    log_prior = -math.log(width * height * 2.0 * math.pi)
    count, nodes, draws, missed = 0, 0, 0, 1.0
    needed = effort.least
    most_pairs, most_evidence = 0, -math.inf
    while draws < effort.draws:
        for k in range(sample):
            draw(drawn, k, seed, draws * sample + k)
            found.is_drawn[drawn[k]] = True
        # Depth first: a feature for each observation of the sample, compatible with the others.
        depth = 0
        place[0], end[0] = 0, total
        while depth >= 0 and nodes < effort.nodes:
            if place[depth] == end[depth]:
                depth -= 1
                if depth >= 0:
                    used[features[depth]] = False
                continue
            j = place[depth] if depth == 0 else near.order[features[0], place[depth]]
            place[depth] += 1
            i = drawn[depth]
            if used[j] or not unary[i, j]:
                continue
            nodes += 1
            fits = True
            for k in range(depth):
                if not binary_compatible(seen, known, drawn[k], features[k], i, j, limits[1]):
                    fits = False
                    break
            if not fits:
                continue
            features[depth] = j
            if depth + 1 < sample:
                used[j] = True
                depth += 1
                # The features at about the same distance from the first one.
                distance = seen.distances[drawn[0], drawn[depth]]
                tolerance = math.sqrt(
                    limits[1]
                    * (seen.distance_variances[drawn[0], drawn[depth]] + near.distance_variance)
                )
                row = near.distances[features[0]]
                place[depth] = np.searchsorted(row, distance - tolerance)
                end[depth] = max(np.searchsorted(row, distance + tolerance), place[depth])
                continue
            if _is_recorded(places.assigned[:count], drawn, features):
                continue
            distance2 = 0.0
            for k in range(sample):
                distance2 = add_pair(seen, known, fit, k, drawn[k], features[k])
            if freedom(fit, sample) == 0 or distance2 > limits[freedom(fit, sample)]:
                continue
            used[j] = True
            pairs, tests = _verified(
                seen, known, unary, grid, limits, fit, best, sample, near.position_variance, used,
                needed, found,
            )
            used[j] = False
            nodes += tests
            if pairs == 0:
                continue
            for k in range(pairs):
                distance2 = add_pair(seen, known, fit, k, best.seen[k], best.known[k])
            value = log_evidence(
                seen, known, fit, pairs, distance2, grid, range_m, log_position, log_prior
            )
            count = _record(places, count, fit, pairs, value, limits[3])
            if value > most_evidence:
                most_evidence, most_pairs = value, pairs
        for k in range(sample):
            found.is_drawn[drawn[k]] = False
        if depth >= 0:
            break  # Too many nodes: this draw is incomplete and does not count.
        draws += 1
        if most_evidence > -math.log(effort.error):
            # Evidence of a pair of the best place, apart from what finding a pose costs. A place
            # that competes may lack the pairs that make up twice the required ratio.
            each = (most_evidence - log_prior) / most_pairs
            lacking = math.floor(-2.0 * math.log(effort.error) / each)
            needed = max(effort.least, most_pairs - lacking)
        hit = 0.0
        if needed >= sample:
            hit = math.exp(log_choose(needed, sample) - log_choose(n, sample))
        missed = (1.0 - hit) ** draws
        if missed <= effort.error:
            break
    return count, places, draws, nodes, missed
