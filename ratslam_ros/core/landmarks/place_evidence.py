# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Evidence of a place: how much better the pairs of a fit explain what is seen than chance does.

`relocalisation.py` describes the method.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.landmarks.compatibility import VARIANCE_FLOOR, Fit, Geometry, cofactors
from ratslam_ros.core.landmarks.features import BAR_SIZE

_LOG_TWO_PI = math.log(2.0 * math.pi)


@compiled
def log_choose(n: int, k: int) -> float:
    """Return the logarithm of the number of ways to choose k of n."""
    return math.lgamma(n + 1.0) - math.lgamma(k + 1.0) - math.lgamma(n - k + 1.0)


@compiled
def log_position_density(seen: Geometry) -> tuple[float, NDArray[np.float64]]:
    """Return the largest range, and the log density of each position elsewhere.

    The density is a mixture in equal parts of a uniform disc around the robot, and of positions
    at the ends of bars that are seen as well: corners and walls meet, on the map or elsewhere. For
    several bars, the best one counts. Each observation is described given those before it.
    """
    n = len(seen.sizes)
    largest2, mean2 = 0.0, 0.0
    for i in range(n):
        range2 = seen.values[i, 0] * seen.values[i, 0] + seen.values[i, 1] * seen.values[i, 1]
        largest2 = max(largest2, range2)
        mean2 += range2 / n
    # Features spread uniformly over a disc of radius R have a mean square range of R^2 / 2.
    disc = 1.0 / max(2.0 * math.pi * mean2, 1e-6)
    log_density = np.empty(n)
    for i in range(n):
        at_end = 0.0
        for k in range(i):
            at_end = max(at_end, _end_density(seen, i, k, False))
            if seen.sizes[k] == BAR_SIZE:
                at_end = max(at_end, _end_density(seen, i, k, True))
            if seen.sizes[i] == BAR_SIZE:
                at_end = max(at_end, _end_density(seen, k, i, True))
        log_density[i] = math.log(0.5 * disc + 0.5 * at_end)
    return math.sqrt(largest2), log_density


@compiled
def _end_density(seen: Geometry, i: int, bar: int, far: bool) -> float:
    """Return the density of the distance between a feature and the start or end of a bar, at 0.

    Both are independent in this approximation.
    """
    a, b = seen.offsets[i], seen.offsets[bar]
    dx, dy = seen.values[i, 0] - seen.values[bar, 0], seen.values[i, 1] - seen.values[bar, 1]
    xx = seen.covariance[a, a] + seen.covariance[b, b] + VARIANCE_FLOOR
    xy = seen.covariance[a, a + 1] + seen.covariance[b, b + 1]
    yy = seen.covariance[a + 1, a + 1] + seen.covariance[b + 1, b + 1] + VARIANCE_FLOOR
    if far:
        length = seen.values[bar, 3]
        c, s = math.cos(seen.values[bar, 2]), math.sin(seen.values[bar, 2])
        dx, dy = dx - length * c, dy - length * s
        along = seen.covariance[b + 3, b + 3]
        across = length * length * seen.covariance[b + 2, b + 2]
        xx += c * c * along + s * s * across
        xy += c * s * (along - across)
        yy += s * s * along + c * c * across
    determinant = max(xx * yy - xy * xy, 1e-300)
    exponent = 0.5 * (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant
    return math.exp(-exponent) / (2.0 * math.pi * math.sqrt(determinant))


@compiled
def log_evidence(
    seen: Geometry,
    known: Geometry,
    fit: Fit,
    level: int,
    distance2: float,
    range_m: float,
    log_position: NDArray[np.float64],
    log_prior: float,
) -> float:
    """Return the logarithm of the evidence of the first ``level`` pairs of a fit (see module)."""
    information = cofactors(fit.sums[level])[6]
    value = log_prior + 1.5 * _LOG_TWO_PI - 0.5 * math.log(max(information, 1e-300))
    value -= 0.5 * (distance2 + fit.sums[level, 10] + fit.rows[level] * _LOG_TWO_PI)
    bars = 0
    for j in range(len(known.sizes)):
        bars += 1 if known.sizes[j] == BAR_SIZE else 0
    heading = fit.fitted[level, 2]
    for k in range(level):
        i = fit.seen[k]
        value -= log_position[i]
        if seen.sizes[i] != BAR_SIZE:
            continue
        # Density of the direction and length of this observation among the features of the map.
        o = seen.offsets[i]
        density = 0.0
        for j in range(len(known.sizes)):
            if known.sizes[j] != BAR_SIZE:
                continue
            q = known.offsets[j]
            turn = wrap(seen.values[i, 2] + heading - known.values[j, 2])
            longer = seen.values[i, 3] - known.values[j, 3]
            turn2 = seen.covariance[o + 2, o + 2] + known.covariance[q + 2, q + 2] + 1e-8
            longer2 = seen.covariance[o + 3, o + 3] + known.covariance[q + 3, q + 3] + 1e-8
            exponent = 0.5 * (turn * turn / turn2 + longer * longer / longer2)
            if exponent < 40.0:
                density += math.exp(-exponent) / math.sqrt(turn2 * longer2)
        value -= math.log(max(density, 1e-12) / bars) - _LOG_TWO_PI
    n = len(seen.sizes)
    x, y = fit.fitted[level, 0], fit.fitted[level, 1]
    visible = 0
    for j in range(len(known.sizes)):
        dx, dy = known.values[j, 0] - x, known.values[j, 1] - y
        visible += 1 if dx * dx + dy * dy <= range_m * range_m else 0
    visible = max(visible, level)
    value -= math.log(min(n, visible) + 1.0) + log_choose(n, level)
    return value - math.lgamma(visible + 1.0) + math.lgamma(visible - level + 1.0)
