# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quantiles of the chi-square distribution, as limits of compatibility tests."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled


def chi_square_limits(level: float, freedoms: int) -> NDArray[np.float64]:
    """Return the (freedoms + 1,) chi-square quantiles of a level; infinite at 0 degrees.

    Infinity lets sets of pairs pass that leave no residual.
    """
    limits: NDArray[np.float64] = _limits(level, freedoms)
    return limits


@compiled
def _limits(level: float, freedoms: int) -> NDArray[np.float64]:
    limits = np.full(freedoms + 1, math.inf)
    low = 0.0
    for k in range(1, freedoms + 1):
        high = low + 1.0
        while _chi_square(high, k) < level:
            high = 2.0 * high
        for _ in range(80):
            middle = 0.5 * (low + high)
            if _chi_square(middle, k) < level:
                low = middle
            else:
                high = middle
        limits[k] = high  # The next quantile is larger, so the search goes on from this one.
    return limits


@compiled
def _chi_square(x: float, k: int) -> float:
    """Return the distribution function with k degrees of freedom at x.

    It is the regularised incomplete gamma function P(k / 2, x / 2), by its power series
    (Abramowitz and Stegun 1964, 6.5.29), of which all terms are positive.
    """
    a, z = 0.5 * k, 0.5 * x
    if z <= 0.0:
        return 0.0
    term = math.exp(a * math.log(z) - z - math.lgamma(a + 1.0))
    total = term
    step = a
    while term > 1e-17 * total:
        step += 1.0
        term *= z / step
        total += term
    return min(total, 1.0)
