# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compatibility of observed and known features: unary, binary and joint chi-square tests.

A pair assigns an observed feature to a known one. Nothing is assumed about the robot's pose, so
the tests use only what does not depend on it:

- unary: the type, and the length of a bar. A direction depends on the unknown heading.
- binary: the distance between two features, their relative direction, and the bearing of the line
  between them relative to the direction of a bar.
- joint: the residuals of all pairs at the pose that fits them best. The fit uses up three degrees
  of freedom.

The joint test is computed incrementally. Let r be the residuals of the pairs at a pose, C their
covariance, J their derivative by the pose and C = L Lᵀ. With y = L⁻¹ r and W = L⁻¹ J, the fitted
pose differs by d = (Wᵀ W)⁻¹ Wᵀ y, its covariance is (Wᵀ W)⁻¹ and the squared Mahalanobis distance
is yᵀ y - dᵀ Wᵀ y. Another pair adds rows to L, y and W and terms to the sums.

Sources: Neira and Tardós 2001, Data association in stochastic mapping using the joint
compatibility test, section III; Kahn and Mazor (2002), section III.A.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.landmarks.features import BAR_SIZE, POINT_SIZE, Features
from ratslam_ros.errors import UnusableInput

VARIANCE_FLOOR = 1e-8
"""Variance added to every residual, in m^2 or rad^2, so that exact features can be compared."""

RELINEARISE_RAD = 0.02
"""The joint test is linearised again if its heading changes by more than this. The error is
quadratic: 2 mm at a range of 10 m."""

_ITERATIONS = 6
"""Largest number of linearisations of one joint test."""

_LARGE_RAD2 = 0.25
"""Variance of a bearing beyond which it is not tested, because it is far from Gaussian."""

_FLAG = 3
"""Column of ``Fit.poses`` that is 1 if the pairs determine the pose."""


class UnusableFeatures(UnusableInput):
    """Features that are not finite, or whose arrays do not belong together."""


class Geometry(NamedTuple):
    """Features as arrays for compiled functions, with what does not depend on their frame.

    Entry (a, b) of the (n, n) tables describes the line from feature a to feature b.
    """

    values: NDArray[np.float64]
    """(n, 4) x, y, direction, length; the last two are 0 for points."""
    sizes: NDArray[np.int64]
    """(n,) number of values."""
    offsets: NDArray[np.int64]
    """(n,) first row of each feature in ``covariance``."""
    covariance: NDArray[np.float64]
    """(d, d) joint covariance."""
    distances: NDArray[np.float64]
    """(n, n) distances in metres."""
    distance_variances: NDArray[np.float64]
    """(n, n) variances of the distances."""
    bearings: NDArray[np.float64]
    """(n, n) bearings of the lines relative to the direction of feature a, if it is a bar."""
    bearing_variances: NDArray[np.float64]
    """(n, n) variances of the bearings."""


class Fit(NamedTuple):
    """Pairs and the incremental joint test of them; level k stands for the first k pairs."""

    seen: NDArray[np.int64]
    """(levels,) observed feature of each pair."""
    known: NDArray[np.int64]
    """(levels,) known feature of each pair."""
    rows: NDArray[np.int64]
    """(levels + 1,) number of residuals."""
    lower: NDArray[np.float64]
    """(4 levels, 4 levels) Cholesky factor L."""
    whitened: NDArray[np.float64]
    """(4 levels, 4) whitened derivative W and residuals y."""
    sums: NDArray[np.float64]
    """(levels + 1, 11) WᵀW (6 values of its upper triangle), Wᵀy (3), yᵀy, log det C."""
    poses: NDArray[np.float64]
    """(levels + 1, 4) pose at which the residuals are linearised, and 1 if it is determined."""
    fitted: NDArray[np.float64]
    """(levels + 1, 3) pose that fits best."""
    current: NDArray[np.float64]
    """(3,) pose at which ``lower``, ``whitened`` and ``sums`` are linearised now."""


def chi_square_limits(level: float, freedoms: int) -> NDArray[np.float64]:
    """Return the (freedoms + 1,) chi-square quantiles of a level; infinite at 0 degrees.

    Infinity lets sets of pairs pass that leave no residual.
    """
    from scipy.special import chdtri  # loaded only by a search: the import is slow

    limits = np.full(freedoms + 1, math.inf)
    limits[1:] = chdtri(np.arange(1, freedoms + 1), 1.0 - level)
    return limits


def geometry_of(features: Features) -> Geometry:
    """Validate features and return their geometry.

    Raises:
        UnusableFeatures: a value or covariance is not finite, or a shape is wrong.
    """
    n = len(features)
    offsets = np.asarray(features.offsets, np.int64)
    covariance = np.ascontiguousarray(features.covariance, np.float64)
    values = np.asarray(features.values, np.float64)
    sizes = np.diff(offsets)
    if offsets.shape != (n + 1,) or not np.isin(sizes, (POINT_SIZE, BAR_SIZE)).all():
        raise UnusableFeatures(
            f'{n} features have offsets with steps {np.unique(sizes).tolist()}; expected '
            f'{n + 1} offsets with steps of {POINT_SIZE} (point) or {BAR_SIZE} (bar)'
        )
    d = int(offsets[-1])
    if values.shape != (d,) or covariance.shape != (d, d):
        raise UnusableFeatures(
            f'the values have shape {values.shape} and the covariance {covariance.shape}; '
            f'expected ({d},) and ({d}, {d})'
        )
    if not np.isfinite(values).all() or not np.isfinite(covariance).all():
        raise UnusableFeatures('a value or covariance is not finite')
    if (np.diagonal(covariance) < 0.0).any():
        raise UnusableFeatures('a variance is negative')
    padded = np.zeros((n, BAR_SIZE))
    for column in range(BAR_SIZE):
        has = sizes > column
        padded[has, column] = values[offsets[:-1][has] + column]
    tables = _lines(padded, sizes, offsets[:-1], covariance)
    return Geometry(padded, sizes, offsets[:-1].copy(), covariance, *tables)


@compiled
def _lines(
    values: NDArray[np.float64],
    sizes: NDArray[np.int64],
    offsets: NDArray[np.int64],
    covariance: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return distances, their variances, bearings and their variances, each (n, n)."""
    n = len(values)
    distances, distance_variances = np.zeros((n, n)), np.zeros((n, n))
    bearings, bearing_variances = np.zeros((n, n)), np.full((n, n), 1e9)
    for a in range(n):
        for b in range(a + 1, n):
            dx, dy = values[b, 0] - values[a, 0], values[b, 1] - values[a, 1]
            distance = math.sqrt(dx * dx + dy * dy)
            ux, uy = (dx / distance, dy / distance) if distance > 1e-9 else (1.0, 0.0)
            p, q = offsets[a], offsets[b]
            xx = covariance[p, p] + covariance[q, q] - 2.0 * covariance[p, q]
            yy = covariance[p + 1, p + 1] + covariance[q + 1, q + 1]
            yy -= 2.0 * covariance[p + 1, q + 1]
            xy = covariance[p, p + 1] + covariance[q, q + 1]
            xy -= covariance[p, q + 1] + covariance[p + 1, q]
            along = ux * ux * xx + 2.0 * ux * uy * xy + uy * uy * yy
            across = uy * uy * xx - 2.0 * ux * uy * xy + ux * ux * yy
            distances[a, b] = distances[b, a] = distance
            variance = max(along, 0.0) + VARIANCE_FLOOR
            distance_variances[a, b] = distance_variances[b, a] = variance
            if distance < 1e-6:
                continue
            line = math.atan2(dy, dx)
            for end in range(2):
                e = a if end == 0 else b
                if sizes[e] != BAR_SIZE:
                    continue
                o = offsets[e] + 2
                # Covariance of the direction with the displacement across the line.
                cross_x = covariance[o, q] - covariance[o, p]
                cross_y = covariance[o, q + 1] - covariance[o, p + 1]
                cross = (ux * cross_y - uy * cross_x) / distance
                spread = across / (distance * distance) + covariance[o, o] - 2.0 * cross
                spread = max(spread, 0.0) + VARIANCE_FLOOR
                if end == 0:
                    bearings[a, b] = wrap(line - values[a, 2])
                    bearing_variances[a, b] = spread
                else:
                    bearings[b, a] = wrap(line + math.pi - values[b, 2])
                    bearing_variances[b, a] = spread
    return distances, distance_variances, bearings, bearing_variances


@compiled
def unary_compatible(seen: Geometry, known: Geometry, limit: float) -> NDArray[np.bool_]:
    """Return the (n_seen, n_known) result of the unary test: equal type, and compatible length.

    Args:
        seen, known: the two sets of features.
        limit: quantile of the chi-square distribution with one degree of freedom.
    """
    passes = np.zeros((len(seen.values), len(known.values)), np.bool_)
    for i in range(len(seen.values)):
        for j in range(len(known.values)):
            if seen.sizes[i] != known.sizes[j]:
                continue
            if seen.sizes[i] == POINT_SIZE:
                passes[i, j] = True
                continue
            a, b = seen.offsets[i] + 3, known.offsets[j] + 3
            variance = seen.covariance[a, a] + known.covariance[b, b] + VARIANCE_FLOOR
            difference = seen.values[i, 3] - known.values[j, 3]
            passes[i, j] = difference * difference <= limit * variance
    return passes


@compiled
def binary_compatible(
    seen: Geometry, known: Geometry, i: int, j: int, i2: int, j2: int, limit: float
) -> bool:
    """Return whether the pairs (i, j) and (i2, j2) are compatible; the types must be equal.

    Args:
        seen, known: the two sets of features.
        i, j, i2, j2: indices of the features of the two pairs.
        limit: quantile of the chi-square distribution with one degree of freedom.
    """
    difference = seen.distances[i, i2] - known.distances[j, j2]
    variance = seen.distance_variances[i, i2] + known.distance_variances[j, j2]
    if difference * difference > limit * variance:
        return False
    if seen.sizes[i] == BAR_SIZE and seen.sizes[i2] == BAR_SIZE:
        a, a2, b, b2 = (
            seen.offsets[i] + 2, seen.offsets[i2] + 2, known.offsets[j] + 2, known.offsets[j2] + 2,
        )
        variance = seen.covariance[a, a] + seen.covariance[a2, a2] - 2.0 * seen.covariance[a, a2]
        variance += known.covariance[b, b] + known.covariance[b2, b2]
        variance += VARIANCE_FLOOR - 2.0 * known.covariance[b, b2]
        difference = wrap(
            seen.values[i2, 2] - seen.values[i, 2] - known.values[j2, 2] + known.values[j, 2]
        )
        if difference * difference > limit * variance:
            return False
    return _bearing_fits(seen, known, i, j, i2, j2, limit) and _bearing_fits(
        seen, known, i2, j2, i, j, limit
    )


@compiled
def _bearing_fits(
    seen: Geometry, known: Geometry, i: int, j: int, i2: int, j2: int, limit: float
) -> bool:
    """Return whether the bearings of the second pair agree, as measured from the first one."""
    variance = seen.bearing_variances[i, i2] + known.bearing_variances[j, j2]
    if seen.sizes[i] != BAR_SIZE or variance >= _LARGE_RAD2:
        return True
    difference = wrap(seen.bearings[i, i2] - known.bearings[j, j2])
    return difference * difference <= limit * variance


@compiled
def empty_fit(levels: int) -> Fit:
    """Return a joint test without pairs that has space for ``levels`` of them."""
    rows = BAR_SIZE * levels
    return Fit(
        np.zeros(levels, np.int64), np.zeros(levels, np.int64), np.zeros(levels + 1, np.int64),
        np.zeros((rows, rows)), np.zeros((rows, 4)), np.zeros((levels + 1, 11)),
        np.zeros((levels + 1, 4)), np.zeros((levels + 1, 3)), np.zeros(3),
    )


@compiled
def add_pair(seen: Geometry, known: Geometry, fit: Fit, level: int, i: int, j: int) -> float:
    """Add the pair (i, j) to the first ``level`` pairs; return the squared Mahalanobis distance.

    The distance is chi-square distributed with ``freedom(fit, level + 1)`` degrees of freedom if
    all pairs are correct. It is 0 as long as the pairs do not determine the pose. The result
    depends only on the pairs and their order, not on what was tested before.
    """
    fit.seen[level], fit.known[level] = i, j
    fit.rows[level + 1] = fit.rows[level] + seen.sizes[i]
    if fit.poses[level, _FLAG] == 0.0:
        if not _start_pose(seen, known, fit, level):
            fit.poses[level + 1, _FLAG] = 0.0
            return 0.0
        _linearise(seen, known, fit, level + 1)
    else:
        same = True
        for k in range(3):
            same = same and fit.current[k] == fit.poses[level, k]
        if not same:
            for k in range(3):
                fit.current[k] = fit.poses[level, k]
            _linearise(seen, known, fit, level)
        _append(seen, known, fit, level)
    dx, dy, turn, distance = _solve(fit.sums[level + 1])
    for _ in range(_ITERATIONS - 1):
        if abs(turn) <= RELINEARISE_RAD:
            break
        fit.current[0] += dx
        fit.current[1] += dy
        fit.current[2] = wrap(fit.current[2] + turn)
        _linearise(seen, known, fit, level + 1)
        dx, dy, turn, distance = _solve(fit.sums[level + 1])
    for k in range(3):
        fit.poses[level + 1, k] = fit.current[k]
    fit.poses[level + 1, _FLAG] = 1.0
    fit.fitted[level + 1, 0] = fit.current[0] + dx
    fit.fitted[level + 1, 1] = fit.current[1] + dy
    fit.fitted[level + 1, 2] = wrap(fit.current[2] + turn)
    return distance


@compiled
def freedom(fit: Fit, level: int) -> int:
    """Return the degrees of freedom of the joint test of the first ``level`` pairs."""
    return fit.rows[level] - 3 if fit.poses[level, _FLAG] == 1.0 else 0


@compiled
def pose_covariance(fit: Fit, level: int) -> NDArray[np.float64]:
    """Return the (3, 3) covariance of the pose that fits the first ``level`` pairs."""
    xx, xy, xt, yy, yt, tt, determinant = cofactors(fit.sums[level])
    scale = 1.0 / determinant
    inverse = np.empty((3, 3))
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = scale * xx, scale * xy, scale * xt
    inverse[1, 0], inverse[1, 1], inverse[1, 2] = scale * xy, scale * yy, scale * yt
    inverse[2, 0], inverse[2, 1], inverse[2, 2] = scale * xt, scale * yt, scale * tt
    return inverse


@compiled
def cofactors(
    upper: NDArray[np.float64]
) -> tuple[float, float, float, float, float, float, float]:
    """Return the cofactors and the determinant of a symmetric 3x3 matrix.

    The six values of its upper triangle are given, and its cofactors are returned, row by row.
    """
    a, b, c, d, e, f = upper[0], upper[1], upper[2], upper[3], upper[4], upper[5]
    xx, xy, xt = d * f - e * e, c * e - b * f, b * e - c * d
    yy, yt, tt = a * f - c * c, b * c - a * e, a * d - b * b
    return xx, xy, xt, yy, yt, tt, a * xx + b * xy + c * xt


@compiled
def _start_pose(seen: Geometry, known: Geometry, fit: Fit, level: int) -> bool:
    """Set ``current`` to a pose that fits a bar, or two points; return False without either."""
    i, j = fit.seen[level], fit.known[level]
    x, y = seen.values[i, 0], seen.values[i, 1]
    if seen.sizes[i] == BAR_SIZE:
        heading = wrap(known.values[j, 2] - seen.values[i, 2])
    else:
        first = -1
        for k in range(level):
            if seen.distances[i, fit.seen[k]] > 1e-6 and known.distances[j, fit.known[k]] > 1e-6:
                first = k
                break
        if first < 0:
            return False
        i2, j2 = fit.seen[first], fit.known[first]
        heading = wrap(
            math.atan2(
                known.values[j, 1] - known.values[j2, 1], known.values[j, 0] - known.values[j2, 0]
            )
            - math.atan2(
                seen.values[i, 1] - seen.values[i2, 1], seen.values[i, 0] - seen.values[i2, 0]
            )
        )
    c, s = math.cos(heading), math.sin(heading)
    fit.current[0] = known.values[j, 0] - (c * x - s * y)
    fit.current[1] = known.values[j, 1] - (s * x + c * y)
    fit.current[2] = heading
    return True


@compiled
def _linearise(seen: Geometry, known: Geometry, fit: Fit, levels: int) -> None:
    for level in range(levels):
        _append(seen, known, fit, level)


@compiled
def _append(seen: Geometry, known: Geometry, fit: Fit, level: int) -> None:
    """Compute the rows of one pair at the current pose, from those of the pairs before it."""
    i, j = fit.seen[level], fit.known[level]
    size, start = seen.sizes[i], fit.rows[level]
    c, s = math.cos(fit.current[2]), math.sin(fit.current[2])
    lower, whitened = fit.lower, fit.whitened
    a, k = seen.offsets[i], known.offsets[j]
    for other in range(level + 1):
        b, k2 = seen.offsets[fit.seen[other]], known.offsets[fit.known[other]]
        column = fit.rows[other]
        width = seen.sizes[fit.seen[other]]
        for r in range(size):
            for q in range(width):
                # Entry (r, q) of R S Rᵀ: the first two values of a feature are rotated.
                if r < 2 and q < 2:
                    m0 = c if r == 0 else s
                    m1 = -s if r == 0 else c
                    n0 = c if q == 0 else s
                    n1 = -s if q == 0 else c
                    rotated = m0 * (
                        n0 * seen.covariance[a, b] + n1 * seen.covariance[a, b + 1]
                    ) + m1 * (n0 * seen.covariance[a + 1, b] + n1 * seen.covariance[a + 1, b + 1])
                elif r < 2:
                    m0 = c if r == 0 else s
                    m1 = -s if r == 0 else c
                    rotated = m0 * seen.covariance[a, b + q] + m1 * seen.covariance[a + 1, b + q]
                elif q < 2:
                    n0 = c if q == 0 else s
                    n1 = -s if q == 0 else c
                    rotated = n0 * seen.covariance[a + r, b] + n1 * seen.covariance[a + r, b + 1]
                else:
                    rotated = seen.covariance[a + r, b + q]
                lower[start + r, column + q] = rotated + known.covariance[k + r, k2 + q]
    x, y = seen.values[i, 0], seen.values[i, 1]
    rx, ry = c * x - s * y, s * x + c * y
    for r in range(size):
        row = start + r
        for q in range(4):
            whitened[row, q] = 0.0
        if r == 0:
            whitened[row, 0], whitened[row, 2] = 1.0, -ry
            whitened[row, 3] = known.values[j, 0] - fit.current[0] - rx
        elif r == 1:
            whitened[row, 1], whitened[row, 2] = 1.0, rx
            whitened[row, 3] = known.values[j, 1] - fit.current[1] - ry
        elif r == 2:
            whitened[row, 2] = 1.0
            whitened[row, 3] = wrap(known.values[j, 2] - seen.values[i, 2] - fit.current[2])
        else:
            whitened[row, 3] = known.values[j, 3] - seen.values[i, 3]
    before, after = fit.sums[level], fit.sums[level + 1]
    for q in range(11):
        after[q] = before[q]
    for row in range(start, start + size):
        lower[row, row] += VARIANCE_FLOOR
        for column in range(row):
            total = lower[row, column]
            for q in range(column):
                total -= lower[row, q] * lower[column, q]
            lower[row, column] = total / lower[column, column]
        pivot = lower[row, row]
        w0, w1, w2, w3 = (
            whitened[row, 0], whitened[row, 1], whitened[row, 2], whitened[row, 3],
        )
        for q in range(row):
            factor = lower[row, q]
            pivot -= factor * factor
            w0 -= factor * whitened[q, 0]
            w1 -= factor * whitened[q, 1]
            w2 -= factor * whitened[q, 2]
            w3 -= factor * whitened[q, 3]
        root = math.sqrt(max(pivot, VARIANCE_FLOOR))
        lower[row, row] = root
        w0, w1, w2, w3 = w0 / root, w1 / root, w2 / root, w3 / root
        whitened[row, 0], whitened[row, 1], whitened[row, 2], whitened[row, 3] = w0, w1, w2, w3
        after[0] += w0 * w0
        after[1] += w0 * w1
        after[2] += w0 * w2
        after[3] += w1 * w1
        after[4] += w1 * w2
        after[5] += w2 * w2
        after[6] += w0 * w3
        after[7] += w1 * w3
        after[8] += w2 * w3
        after[9] += w3 * w3
        after[10] += 2.0 * math.log(root)


@compiled
def _solve(sums: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return the change of the pose that fits best, and the squared distance at it."""
    l00 = math.sqrt(max(sums[0], 1e-12))
    l10, l20 = sums[1] / l00, sums[2] / l00
    l11 = math.sqrt(max(sums[3] - l10 * l10, 1e-12))
    l21 = (sums[4] - l20 * l10) / l11
    l22 = math.sqrt(max(sums[5] - l20 * l20 - l21 * l21, 1e-12))
    z0 = sums[6] / l00
    z1 = (sums[7] - l10 * z0) / l11
    z2 = (sums[8] - l20 * z0 - l21 * z1) / l22
    turn = z2 / l22
    dy = (z1 - l21 * turn) / l11
    dx = (z0 - l10 * dy - l20 * turn) / l00
    distance = max(sums[9] - z0 * z0 - z1 * z1 - z2 * z2, 0.0)
    return dx, dy, turn, distance
