# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled loops of the stochastic map.

The state has d values: the pose (x, y, heading) and then the values of every feature. Its
covariance is the lower triangle ``p``, row by row: element (i, j <= i) is p[i (i + 1) / 2 + j].
New features append rows, and every update reads and writes half of the matrix.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.landmarks.cholesky import extend_factor, solve_row
from ratslam_ros.core.landmarks.features import BAR_SIZE

POSE_SIZE = 3
"""Values of the pose."""

LEAST_DISTANCE_M = 1e-3
"""Landmarks nearer to the robot than this have no bearing; their observations are rejected."""

UPDATED, REJECTED, NEW, REPEATED = 0, 1, 2, 3
"""Results of one observation."""

UNKNOWN, DOUBTFUL = -1, -2
"""Associations of observations without a feature: of a new landmark, or not to be used."""

_COLUMNS = POSE_SIZE + BAR_SIZE
"""Values that one observation depends on: the pose and one feature."""


class Estimate(NamedTuple):
    """State of the filter; functions change it in place unless they return another one."""

    x: NDArray[np.float64]
    """(d,) means."""
    first: NDArray[np.float64]
    """(d,) first estimates, at which the Jacobians are computed (``StochasticMap``)."""
    p: NDArray[np.float64]
    """(d (d + 1) / 2,) triangle of the covariance."""


@compiled
def predict(
    state: Estimate, forward_m: float, left_m: float, turn_rad: float, position_variance: float,
    drift_variance: float, turn_variance: float,
) -> None:
    """Move the pose, and add the noise of the motion; arguments as in ``StochasticMap.predict``.

    The Jacobian contains the way from the previous predicted pose to the new one.

    Args:
        state: the state.
        position_variance: m^2 per m of distance.
        drift_variance, turn_variance: rad^2 per m of distance and per rad of turn.
    """
    x, first, p = state
    c, s = math.cos(x[2]), math.sin(x[2])
    m_x, m_y = c * forward_m - s * left_m, s * forward_m + c * left_m
    x[0] += m_x
    x[1] += m_y
    x[2] = wrap(x[2] + turn_rad)
    f_x, f_y = x[0] - first[0], x[1] - first[1]
    first[:POSE_SIZE] = x[:POSE_SIZE]
    for i in range(POSE_SIZE, len(x)):
        row = i * (i + 1) // 2
        p[row] -= f_y * p[row + 2]
        p[row + 1] += f_x * p[row + 2]
    distance = math.hypot(forward_m, left_m)
    xy = position_variance * distance
    # Noise of the heading that accumulates evenly along the way moves the end of the way to its
    # side: the integrals of 1 - u and (1 - u)^2 over the way are 1/2 and 1/3.
    heading = drift_variance * distance + turn_variance * abs(turn_rad)
    h = p[5]
    p[0] += f_y * f_y * h - 2.0 * f_y * p[3] + m_y * m_y * heading / 3.0 + xy
    p[1] += f_x * p[3] - f_y * p[4] - f_x * f_y * h - m_x * m_y * heading / 3.0
    p[2] += f_x * f_x * h + 2.0 * f_x * p[4] + m_x * m_x * heading / 3.0 + xy
    p[3] -= f_y * h + m_y * heading / 2.0
    p[4] += f_x * h + m_x * heading / 2.0
    p[5] += heading


@compiled
def _element(p: NDArray[np.float64], i: int, j: int) -> float:
    if j > i:
        i, j = j, i
    value: float = p[i * (i + 1) // 2 + j]
    return value


@compiled
def _column(start: int, b: int) -> int:
    """Return the place in the state of value b of the pose and the feature at ``start``."""
    return b if b < POSE_SIZE else start + b - POSE_SIZE


@compiled
def _linearise(
    state: Estimate, start: int, m: int, z: NDArray[np.float64], h: NDArray[np.float64],
    innovation: NDArray[np.float64],
) -> bool:
    """Compute the innovation and the Jacobian of an observation; False if it is too near.

    Args:
        state: the state.
        start: place of the feature within the state.
        m: number of values that are compared, 2 or 4.
        z: range, bearing, direction and length.
        h: (4, 7) output: derivatives by the pose and by the values of the feature.
        innovation: (4,) output.
    """
    x, first, _ = state
    d_x, d_y = x[start] - x[0], x[start + 1] - x[1]
    innovation[0] = z[0] - math.sqrt(d_x * d_x + d_y * d_y)
    innovation[1] = wrap(z[1] - math.atan2(d_y, d_x) + x[2])
    d_x, d_y = first[start] - first[0], first[start + 1] - first[1]
    q = d_x * d_x + d_y * d_y
    r = math.sqrt(q)
    if not r > LEAST_DISTANCE_M:
        return False
    h[:, :] = 0.0
    h[0, 3], h[0, 4] = d_x / r, d_y / r
    h[1, 3], h[1, 4] = -d_y / q, d_x / q
    for a in range(2):
        h[a, 0], h[a, 1] = -h[a, 3], -h[a, 4]
    h[1, 2] = -1.0
    if m == BAR_SIZE:
        h[2, 2], h[2, 5], h[3, 6] = -1.0, 1.0, 1.0
        innovation[2] = wrap(z[2] - x[start + 2] + x[2])
        innovation[3] = z[3] - x[start + 3]
    return True


@compiled
def _squared_distance(
    p: NDArray[np.float64], start: int, m: int, h: NDArray[np.float64],
    innovation: NDArray[np.float64], variances: NDArray[np.float64],
) -> float:
    """Return the squared Mahalanobis distance of an innovation."""
    s = np.zeros((BAR_SIZE, BAR_SIZE))
    columns = POSE_SIZE + m
    for b in range(columns):
        for k in range(columns):
            value = _element(p, _column(start, b), _column(start, k))
            for a in range(m):
                for e in range(a + 1):
                    s[a, e] += h[a, b] * value * h[e, k]
    squared = 0.0
    solved = innovation.copy()
    for a in range(m):
        s[a, a] += variances[a]
        extend_factor(s, a)
        solved[a] = solve_row(s, a, solved)
        squared += solved[a] * solved[a]
    return squared


@compiled
def survival(squared: float, m: int) -> float:
    """Return the probability that chi-square with 2 or 4 degrees of freedom is larger."""
    half = 0.5 * squared
    return math.exp(-half) if m == 2 else (1.0 + half) * math.exp(-half)


@compiled
def _correct(
    state: Estimate, start: int, m: int, h: NDArray[np.float64], innovation: NDArray[np.float64],
    variances: NDArray[np.float64], c: NDArray[np.float64], k: NDArray[np.float64],
) -> None:
    """Update the state by one observation; ``c`` and ``k`` are (4, d) scratch.

    Joseph form, expanded: P - K C' - C K' + K S K' with C = P H' is P - K A' - A K' with
    A = C - S K / 2. It is symmetric for any gain, an error of the gain enters by its square, and
    one triangle suffices.
    """
    x, _, p = state
    d, columns = len(x), POSE_SIZE + m
    values = np.zeros(_COLUMNS)
    for i in range(d):
        for b in range(columns):
            values[b] = _element(p, i, _column(start, b))
        for a in range(m):
            total = 0.0
            for b in range(columns):
                total += h[a, b] * values[b]
            c[a, i] = total
    s = np.zeros((BAR_SIZE, BAR_SIZE))
    for a in range(m):
        for e in range(a + 1):
            total = variances[a] if a == e else 0.0
            for b in range(columns):
                total += c[a, _column(start, b)] * h[e, b]
            s[a, e] = s[e, a] = total
    factor = s.copy()
    for a in range(m):
        extend_factor(factor, a)
        for i in range(d):
            k[a, i] = c[a, i]
        for b in range(a):
            for i in range(d):
                k[a, i] -= factor[a, b] * k[b, i]
        for i in range(d):
            k[a, i] /= factor[a, a]
    for a in range(m - 1, -1, -1):
        for b in range(a + 1, m):
            for i in range(d):
                k[a, i] -= factor[b, a] * k[b, i]
        for i in range(d):
            k[a, i] /= factor[a, a]
    for a in range(m):
        for i in range(d):
            x[i] += k[a, i] * innovation[a]
        for b in range(m):
            for i in range(d):
                c[a, i] -= 0.5 * s[a, b] * k[b, i]
    for i in range(d):
        row = p[i * (i + 1) // 2 : (i + 1) * (i + 2) // 2]
        for a in range(0, m, 2):  # Two at a time, as m is even: half the passes over the row.
            k_0, a_0, k_1, a_1 = k[a, i], c[a, i], k[a + 1, i], c[a + 1, i]
            for j in range(i + 1):
                row[j] -= (k_0 * c[a, j] + a_0 * k[a, j]) + (
                    k_1 * c[a + 1, j] + a_1 * k[a + 1, j]
                )


@compiled
def observe(
    state: Estimate, offsets: NDArray[np.int64], starts: NDArray[np.int64],
    is_repeated: NDArray[np.bool_], z: NDArray[np.float64], sizes: NDArray[np.int64],
    variances: NDArray[np.float64], outlier_probability: float,
) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
    """Update the state by the observations of one moment.

    All observations are linearised and tested at the state before the first update. The outcome
    is thus independent of their order, up to rounding.

    Args:
        state: the state.
        offsets: (features + 1,) places of the features within the state, and its length d.
        starts: (n,) places of the observed features; -1 if unknown.
        is_repeated: (n,) True for observations that are not used.
        z: (n, 4) range, bearing, direction and length.
        sizes: (n,) number of values to compare, 2 or 4.
        variances: (n, 4) of range, bearing, direction and length.
        outlier_probability: observations whose innovations are less probable are rejected.

    Returns:
        (n,) UPDATED, REJECTED, NEW or REPEATED; (n,) squared Mahalanobis distances of the
        innovations, NaN without one.
    """
    x = state.x
    n, before = len(starts), x.copy()
    results, squared = np.zeros(n, np.int8), np.full(n, np.nan)
    h = np.zeros((n, BAR_SIZE, _COLUMNS))
    innovations = np.zeros((n, BAR_SIZE))
    for o in range(n):
        if is_repeated[o]:
            results[o] = REPEATED
            continue
        if starts[o] < 0:
            results[o] = NEW if z[o, 0] > LEAST_DISTANCE_M else REJECTED
            continue
        results[o] = REJECTED
        if _linearise(state, starts[o], sizes[o], z[o], h[o], innovations[o]):
            squared[o] = _squared_distance(
                state.p, starts[o], sizes[o], h[o], innovations[o], variances[o]
            )
            if survival(squared[o], sizes[o]) >= outlier_probability:
                results[o] = UPDATED
    c, k = np.zeros((BAR_SIZE, len(x))), np.zeros((BAR_SIZE, len(x)))
    innovation = np.zeros(BAR_SIZE)
    for o in range(n):
        if results[o] != UPDATED:
            continue
        for a in range(sizes[o]):
            innovation[a] = innovations[o, a]
            for b in range(POSE_SIZE + sizes[o]):
                i = _column(starts[o], b)
                innovation[a] -= h[o, a, b] * (x[i] - before[i])
        _correct(state, starts[o], sizes[o], h[o], innovation, variances[o], c, k)
    x[2] = wrap(x[2])
    for f in range(len(offsets) - 1):
        if offsets[f + 1] - offsets[f] == BAR_SIZE:
            x[offsets[f] + 2] = wrap(x[offsets[f] + 2])
    return results, squared


@compiled
def extended(
    state: Estimate, z: NDArray[np.float64], sizes: NDArray[np.int64],
    variances: NDArray[np.float64],
) -> Estimate:
    """Return the state with more features, given by their observations as for ``observe``."""
    d = len(state.x)
    total = d + sizes.sum()
    larger = Estimate(np.zeros(total), np.zeros(total), np.zeros(total * (total + 1) // 2))
    larger.x[:d], larger.first[:d], larger.p[: len(state.p)] = state
    for o in range(len(z)):
        _add(larger, d, z[o], sizes[o], variances[o])
        d += sizes[o]
    return larger


@compiled
def _add(
    state: Estimate, d: int, z: NDArray[np.float64], m: int, variances: NDArray[np.float64]
) -> None:
    """Add a feature of m values at place d, which is correlated with the rest by the pose."""
    x, first, p = state
    angle = x[2] + z[1]
    c, s = math.cos(angle), math.sin(angle)
    x[d], x[d + 1] = x[0] + z[0] * c, x[1] + z[0] * s
    pose = np.zeros((BAR_SIZE, POSE_SIZE))
    pose[0, 0] = pose[1, 1] = pose[2, 2] = 1.0
    pose[0, 2], pose[1, 2] = first[1] - x[d + 1], x[d] - first[0]
    if m == BAR_SIZE:
        x[d + 2], x[d + 3] = wrap(x[2] + z[2]), z[3]
    first[d : d + m] = x[d : d + m]
    along, across = variances[0], z[0] * z[0] * variances[1]
    noise = np.zeros((BAR_SIZE, BAR_SIZE))
    noise[0, 0] = along * c * c + across * s * s
    noise[1, 0] = (along - across) * c * s
    noise[1, 1] = along * s * s + across * c * c
    noise[2, 2], noise[3, 3] = variances[2], variances[3]
    for a in range(m):
        row = p[(d + a) * (d + a + 1) // 2 :]
        for j in range(d):
            total = 0.0
            for b in range(POSE_SIZE):
                total += pose[a, b] * _element(p, b, j)
            row[j] = total
        for e in range(a + 1):
            total = noise[a, e]
            for b in range(POSE_SIZE):
                total += row[b] * pose[e, b]
            row[d + e] = total


@compiled
def without(state: Estimate, kept: NDArray[np.int64]) -> Estimate:
    """Return the state with the values at the given places only, which ascend, in place."""
    x, first, p = state
    end = 0
    for i in range(len(kept)):
        x[i], first[i] = x[kept[i]], first[kept[i]]
        row = kept[i] * (kept[i] + 1) // 2
        for j in range(i + 1):
            p[end] = p[row + kept[j]]
            end += 1
    return Estimate(x[: len(kept)], first[: len(kept)], p[:end])


@compiled
def covariance_from(p: NDArray[np.float64], first: int, end: int) -> NDArray[np.float64]:
    """Return the covariance of the values from ``first`` to before ``end`` as a full matrix."""
    full = np.zeros((end - first, end - first))
    for i in range(first, end):
        for j in range(first, i + 1):
            full[i - first, j - first] = full[j - first, i - first] = p[i * (i + 1) // 2 + j]
    return full


@compiled
def to_robot_frame(
    state: Estimate, offsets: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the (d - 3,) features in the frame of the robot, and their covariance.

    The covariance is J P J', with the Jacobian J by the pose and the features. ``offsets`` as for
    ``observe``.
    """
    x, first, p = state
    d = len(x)
    n = d - POSE_SIZE
    values, covariance = np.zeros(n), np.zeros((n, n))
    c, s = math.cos(x[2]), math.sin(x[2])
    # A row of J has at most five elements; unused ones are zero.
    places = np.zeros((n, 5), np.int64)
    slopes = np.zeros((n, 5))
    for f in range(len(offsets) - 1):
        start = offsets[f]
        i = start - POSE_SIZE
        d_x, d_y = x[start] - x[0], x[start + 1] - x[1]
        values[i], values[i + 1] = c * d_x + s * d_y, -s * d_x + c * d_y
        for a in range(2):
            places[i + a] = np.array([0, 1, 2, start, start + 1])
        d_x, d_y = first[start] - first[0], first[start + 1] - first[1]
        slopes[i] = np.array([-c, -s, -s * d_x + c * d_y, c, s])
        slopes[i + 1] = np.array([s, -c, -c * d_x - s * d_y, -s, c])
        if offsets[f + 1] - start == BAR_SIZE:
            values[i + 2], values[i + 3] = wrap(x[start + 2] - x[2]), x[start + 3]
            places[i + 2, 0], places[i + 2, 1], places[i + 3, 0] = 2, start + 2, start + 3
            slopes[i + 2, 0], slopes[i + 2, 1], slopes[i + 3, 0] = -1.0, 1.0, 1.0
    product = np.zeros(d)
    for i in range(n):
        for j in range(d):
            total = 0.0
            for b in range(5):
                total += slopes[i, b] * _element(p, places[i, b], j)
            product[j] = total
        for j in range(i + 1):
            total = 0.0
            for b in range(5):
                total += product[places[j, b]] * slopes[j, b]
            covariance[i, j] = covariance[j, i] = total
    return values, covariance


@compiled
def associate(
    state: Estimate, offsets: NDArray[np.int64], z: NDArray[np.float64], sizes: NDArray[np.int64],
    variances: NDArray[np.float64], outlier_probability: float,
) -> NDArray[np.int64]:
    """Return the index of the feature of each observation, UNKNOWN or DOUBTFUL without one.

    Of all pairs of the same type that pass the chi-square test, the nearest one is taken first;
    no feature and no observation is used twice. An observation without a feature is doubtful if
    it may be an outlier of a feature that no other observation matches: a pair that fails at the
    given probability, but passes at its square. Arguments as for ``observe``.
    """
    n, count = len(z), len(offsets) - 1
    squared = np.zeros(n * count)
    pairs = np.zeros(n * count, np.int64)
    found = 0
    h, innovation = np.zeros((BAR_SIZE, _COLUMNS)), np.zeros(BAR_SIZE)
    for o in range(n):
        for f in range(count):
            if offsets[f + 1] - offsets[f] != sizes[o]:
                continue
            if not _linearise(state, offsets[f], sizes[o], z[o], h, innovation):
                continue
            distance = _squared_distance(
                state.p, offsets[f], sizes[o], h, innovation, variances[o]
            )
            if survival(distance, sizes[o]) >= outlier_probability * outlier_probability:
                squared[found], pairs[found] = distance, o * count + f
                found += 1
    matches = np.full(n, UNKNOWN)
    is_taken = np.zeros(count, np.bool_)
    order = np.argsort(squared[:found], kind='mergesort')
    for k in order:
        o, f = pairs[k] // count, pairs[k] % count
        passes = survival(squared[k], sizes[o]) >= outlier_probability
        if passes and matches[o] == UNKNOWN and not is_taken[f]:
            matches[o], is_taken[f] = f, True
    for k in order:
        o, f = pairs[k] // count, pairs[k] % count
        if matches[o] == UNKNOWN and not is_taken[f]:
            matches[o] = DOUBTFUL
    return matches
