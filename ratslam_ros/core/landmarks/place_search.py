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
    cofactors,
    empty_fit,
    freedom,
    pose_covariance,
)
from ratslam_ros.core.landmarks.joint_compatibility import CORRECT, search
from ratslam_ros.core.landmarks.place_evidence import (
    log_choose,
    log_evidence,
    log_position_density,
)

_MAX_PLACES = 100
"""Places that are compared; further ones replace the least probable."""

_MAX_NODES = 5000
"""Joint tests that verify one hypothesis; then the largest set so far is used."""


class Neighbours(NamedTuple):
    """Known features by distance and by position, and the largest variances."""

    order: NDArray[np.int64]
    """(n, n) features by increasing distance from feature a, in row a."""
    distances: NDArray[np.float64]
    """(n, n) the distances."""
    by_x: NDArray[np.int64]
    """(n,) features by increasing x."""
    x: NDArray[np.float64]
    """(n,) their x."""
    distance_variance: float
    """Largest variance of a distance."""
    position_variance: float
    """Largest sum of the variances of x and y of a feature."""


class Task(NamedTuple):
    """What is searched for."""

    seen: Geometry
    """Observed features."""
    known: Geometry
    """Features of the map."""
    near: Neighbours
    """The features of the map, sorted."""
    unary: NDArray[np.bool_]
    """(n_seen, n_known) result of the unary test."""
    limits: NDArray[np.float64]
    """Chi-square quantiles by degrees of freedom."""


class RelocalisationParameters(NamedTuple):
    """How thoroughly is searched, and which places are reported."""

    sample: int = 3
    """Number of observations that are drawn to generate a hypothesis (p of Kahn and Mazor
    (2002)). The others verify it."""
    pairs: int = 4
    """Least number of pairs of a place (m of Kahn and Mazor (2002))."""
    share: float = 0.5
    """Least share of the observations that match the map at a place."""
    draws: int = 500
    """Largest number of draws (t of Kahn and Mazor (2002)). The search ends earlier if another
    place with enough pairs is unlikely to be missed."""
    nodes: int = 500_000
    """Largest number of pairs that are tested, about 0.5 s. If a search ends by it, its result is
    not `found`, because a competing place may have been missed."""
    error: float = 0.001
    """Largest probability that a place that is reported as found is wrong, or that the search
    missed another place that matches as well."""
    unmapped: float = 0.5
    """Prior probability that the robot is at no place of the map."""


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


class _Draw(NamedTuple):
    """A draw of observations, and the hypotheses on them."""

    order: NDArray[np.int64]
    """(n,) observations in random order, the sample first."""
    features: NDArray[np.int64]
    """(sample,) known feature of each observation of the sample."""
    used: NDArray[np.bool_]
    """(n_known,) whether a known feature belongs to the sample."""
    place: NDArray[np.int64]
    """(sample,) place of the next candidate of each observation among those near the first."""
    end: NDArray[np.int64]
    """(sample,) place after the last candidate."""


class _Candidates(NamedTuple):
    """Known features that fit the observations beside the sample, see ``search``."""

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
def exchange(items: NDArray[np.int64], k: int, seed: int, counter: int) -> None:
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
    total = (covariance + covariance2).ravel()
    xx, xy, xt, yy, yt, tt, determinant = cofactors(total[np.array([0, 1, 2, 4, 5, 8])])
    dx, dy, turn = pose[0] - other[0], pose[1] - other[1], wrap(pose[2] - other[2])
    scale = 1.0 / max(determinant, 1e-300)
    distance2 = xx * dx * dx + yy * dy * dy + tt * turn * turn
    distance2 += 2.0 * (xy * dx * dy + xt * dx * turn + yt * dy * turn)
    return distance2 * scale <= limit


@compiled
def _find_candidates(
    task: Task, draw: _Draw, fit: Fit, needed: int, found: _Candidates
) -> tuple[int, int]:
    """Find the features that fit each other observation at the pose of a hypothesis.

    Args:
        task: the task.
        draw: the draw.
        fit: the pairs of the sample, and room for another one.
        needed: number of pairs that must be possible; the search ends as soon as it is not.
        found: receives the observations with candidates, and these, by increasing distance.

    Returns:
        the number of observations with candidates, -1 if there are too few; joint tests.
    """
    seen, known, near = task.seen, task.known, task.near
    features, distances2 = found.features, found.distances2
    sample = len(draw.features)
    count, filled, tests = 0, 0, 0
    covariance = pose_covariance(fit, sample)
    x, y, heading = fit.fitted[sample]
    c, s = math.cos(heading), math.sin(heading)
    others = np.sort(draw.order[sample:])
    for other in range(len(others)):
        if sample + count + len(others) - other < needed:
            return -1, tests
        i = others[other]
        sx, sy = seen.values[i, 0], seen.values[i, 1]
        px, py = x + c * sx - s * sy, y + s * sx + c * sy
        o = seen.offsets[i]
        spread = 2.0 * (covariance[0, 0] + covariance[1, 1])
        spread += 2.0 * covariance[2, 2] * (sx * sx + sy * sy) + near.position_variance
        spread += seen.covariance[o, o] + seen.covariance[o + 1, o + 1]
        radius = math.sqrt(task.limits[2] * spread)
        first, end = np.searchsorted(near.x, px - radius), np.searchsorted(near.x, px + radius)
        for j in near.by_x[first:end]:
            if not task.unary[i, j] or draw.used[j] or filled == len(features):
                continue
            dx, dy = known.values[j, 0] - px, known.values[j, 1] - py
            if dx * dx + dy * dy > radius * radius:
                continue
            tests += 1
            distance2 = add_pair(seen, known, fit, sample, i, j)
            if distance2 > task.limits[freedom(fit, sample + 1)]:
                continue
            at = filled
            while at > found.starts[count] and distances2[at - 1] > distance2:
                distances2[at], features[at] = distances2[at - 1], features[at - 1]
                at -= 1
            distances2[at], features[at] = distance2, j
            filled += 1
        if filled > found.starts[count]:
            found.order[count] = i
            count += 1
            found.starts[count] = filled
    return count, tests


@compiled
def _verify(
    task: Task, draw: _Draw, fit: Fit, best: Fit, needed: int, found: _Candidates
) -> tuple[int, int]:
    """Extend the pairs of a sample to the largest compatible set, which ``best`` receives.

    Args:
        task: the task.
        draw: the draw.
        fit: the pairs of the sample; further levels are used for the search.
        best: receives the pairs of the set.
        needed: number of pairs that the set must have.
        found: room for candidates.

    Returns:
        the number of pairs, 0 if there are too few; tests.
    """
    sample = len(draw.features)
    count, tests = _find_candidates(task, draw, fit, needed, found)
    if count < 0 or sample + count < needed:
        return 0, tests
    for k in range(sample):
        best.seen[k], best.known[k] = fit.seen[k], fit.known[k]
    pairs, more = search(
        task.seen, task.known, fit, sample, found.order[:count], found.starts[: count + 1],
        found.features, task.limits, draw.used, CORRECT, max(needed - 1, sample - 1), _MAX_NODES,
        best,
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
def _is_recorded(assigned: NDArray[np.int64], draw: _Draw) -> bool:
    """Return whether one of the recorded places, (places, n), has the pairs of the sample."""
    for place in range(len(assigned)):
        same = True
        for k in range(len(draw.features)):
            same = same and assigned[place, draw.order[k]] == draw.features[k]
        if same:
            return True
    return False


@compiled
def _next_hypothesis(
    task: Task, draw: _Draw, depth: int, nodes: int, max_nodes: int
) -> tuple[bool, int, int]:
    """Find the next features that fit the observations of the sample by their binary tests.

    The search is depth first: a feature for each observation, compatible with those before it.

    Args:
        task: the task.
        draw: the draw; its features and used ones become those of the hypothesis.
        depth: number of observations that have a feature.
        nodes: number of tests before.
        max_nodes: number of tests after which the search ends.

    Returns:
        whether there is a hypothesis; the depth, -1 after the last hypothesis; number of tests.
    """
    seen, near, features = task.seen, task.near, draw.features
    while depth >= 0 and nodes < max_nodes:
        if draw.place[depth] == draw.end[depth]:
            depth -= 1
            if depth >= 0:
                draw.used[features[depth]] = False
            continue
        j = draw.place[depth] if depth == 0 else near.order[features[0], draw.place[depth]]
        draw.place[depth] += 1
        i = draw.order[depth]
        if draw.used[j] or not task.unary[i, j]:
            continue
        nodes += 1
        fits = True
        for k in range(depth):
            fits = fits and binary_compatible(
                seen, task.known, draw.order[k], features[k], i, j, task.limits[1]
            )
        if not fits:
            continue
        features[depth] = j
        if depth + 1 == len(features):
            return True, depth, nodes
        draw.used[j] = True
        depth += 1
        # The features at about the same distance from the first one.
        first, other = draw.order[0], draw.order[depth]
        distance = seen.distances[first, other]
        tolerance = math.sqrt(
            task.limits[1] * (seen.distance_variances[first, other] + near.distance_variance)
        )
        row = near.distances[features[0]]
        draw.place[depth] = np.searchsorted(row, distance - tolerance)
        draw.end[depth] = max(np.searchsorted(row, distance + tolerance), draw.place[depth])
    return False, depth, nodes


@compiled
def _tested(task: Task, draw: _Draw, fit: Fit) -> bool:
    """Return whether the pairs of the sample, which ``fit`` receives, are jointly compatible."""
    sample, distance2 = len(draw.features), 0.0
    for k in range(sample):
        distance2 = add_pair(task.seen, task.known, fit, k, draw.order[k], draw.features[k])
    return freedom(fit, sample) > 0 and distance2 <= task.limits[freedom(fit, sample)]


@compiled
def search_places(
    task: Task, size_m: tuple[float, float], effort: RelocalisationParameters, seed: int
) -> tuple[int, Places, int, int, float]:
    """Draw observations, find the places that explain them, and verify these.

    Args:
        task: the task.
        size_m: extents of the map.
        effort: limits of the search; ``pairs`` follows from ``share`` already.
        seed: of the draws.

    Returns:
        number of places; the places; draws; nodes; probability that a competing place was missed.
    """
    seen, known = task.seen, task.known
    n, total, sample = len(seen.sizes), len(known.sizes), effort.sample
    places = Places(
        np.full((_MAX_PLACES, n), -1, np.int64), np.full(_MAX_PLACES, -math.inf),
        np.zeros((_MAX_PLACES, 3)), np.zeros((_MAX_PLACES, 3, 3)),
    )
    draw = _Draw(
        np.arange(n), np.zeros(sample, np.int64), np.zeros(total, np.bool_),
        np.zeros(sample, np.int64), np.zeros(sample, np.int64),
    )
    found = _Candidates(
        np.zeros(n, np.int64), np.zeros(n + 1, np.int64), np.zeros(64 * n, np.int64),
        np.zeros(64 * n),
    )
    fit, best = empty_fit(n), empty_fit(n)
    range_m, log_position = log_position_density(seen)
    log_prior = -math.log(
        (size_m[0] + 2.0 * range_m) * (size_m[1] + 2.0 * range_m) * 2.0 * math.pi
    )
    count, nodes, draws, missed = 0, 0, 0, 1.0
    needed = effort.pairs
    most_pairs, most_evidence = 0, -math.inf
    while draws < effort.draws:
        for k in range(sample):
            exchange(draw.order, k, seed, draws * sample + k)
        depth = 0
        draw.place[0], draw.end[0] = 0, total
        while True:
            has_next, depth, nodes = _next_hypothesis(task, draw, depth, nodes, effort.nodes)
            if not has_next:
                break
            if _is_recorded(places.assigned[:count], draw) or not _tested(task, draw, fit):
                continue
            draw.used[draw.features[depth]] = True
            pairs, tests = _verify(task, draw, fit, best, needed, found)
            draw.used[draw.features[depth]] = False
            nodes += tests
            if pairs == 0:
                continue
            distance2 = 0.0
            for k in range(pairs):
                distance2 = add_pair(seen, known, fit, k, best.seen[k], best.known[k])
            value = log_evidence(
                seen, known, fit, pairs, distance2, range_m, log_position, log_prior
            )
            count = _record(places, count, fit, pairs, value, task.limits[3])
            if value > most_evidence:
                most_evidence, most_pairs = value, pairs
        if depth >= 0:
            break  # Too many nodes: this draw is incomplete and does not count.
        draws += 1
        if most_evidence > -math.log(effort.error):
            # Evidence of a pair of the best place, apart from what finding a pose costs. A place
            # that competes may lack the pairs that make up twice the required ratio.
            each = (most_evidence - log_prior) / most_pairs
            lacking = math.floor(-2.0 * math.log(effort.error) / each)
            needed = max(effort.pairs, most_pairs - lacking)
        hit = 0.0
        if needed >= sample:
            hit = math.exp(log_choose(needed, sample) - log_choose(n, sample))
        missed = (1.0 - hit) ** draws
        if missed <= effort.error:
            break
    return count, places, draws, nodes, missed
