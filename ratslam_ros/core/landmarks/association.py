# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Data association while mapping: nearest neighbours that are jointly compatible.

Individual tests accept neighbours of the right landmark if the pose is uncertain. Joint ones do
not, because an error of the pose moves all landmarks alike (Neira and Tardos 2001). Instead of
their full search, pairs are accepted in the order of their distance, each given those before it,
and every pair is tried as the first one. The result is what all sets with the most pairs have in
common, because rows of equal shelves may fit in two ways.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.landmarks.cholesky import extend_factor, solve_row
from ratslam_ros.core.landmarks.features import BAR_SIZE, POINT_SIZE, Features
from ratslam_ros.core.landmarks.stochastic_map_kernels import survival

MAX_STARTS = 50
"""Largest number of pairs that are tried as the first one."""

_LEAST_PIVOT = 1e-12
"""Smallest conditional variance of an innovation, against rounding."""


def jointly_nearest(
    seen: Features, known: Features, outlier_probability: float
) -> NDArray[np.int64]:
    """Return the index of the known feature of each seen one, -1 without one.

    A bar and a point are compared by their positions. No feature is used twice.

    Args:
        seen: features in the robot's frame.
        known: features of the map in the robot's frame, which includes the error of the pose.
        outlier_probability: probability that a correct pair is rejected.
    """
    return _associate(
        seen.offsets, seen.values, seen.covariance, known.offsets, known.values,
        known.covariance, outlier_probability,
    )


@compiled
def _associate(
    offsets: NDArray[np.int64], values: NDArray[np.float64], covariance: NDArray[np.float64],
    known_offsets: NDArray[np.int64], known_values: NDArray[np.float64],
    known_covariance: NDArray[np.float64], outlier_probability: float,
) -> NDArray[np.int64]:
    n, count = len(offsets) - 1, len(known_offsets) - 1
    squared, pairs = np.zeros(n * count), np.zeros(n * count, np.int64)
    factor, solved = np.zeros((BAR_SIZE, BAR_SIZE)), np.zeros(BAR_SIZE)
    rows, known_rows = np.zeros(BAR_SIZE * n, np.int64), np.zeros(BAR_SIZE * n, np.int64)
    found = possible = 0
    for o in range(n):
        before = found
        for f in range(count):
            rows[0], known_rows[0] = offsets[o], known_offsets[f]
            m = _size(offsets, known_offsets, o, f)
            distance = _extend(
                0, m, values, covariance, known_values, known_covariance, rows, known_rows,
                factor, solved,
            )
            if survival(distance, m) >= outlier_probability:
                squared[found], pairs[found] = distance, o * count + f
                found += 1
        possible += found > before
    order = np.argsort(squared[:found], kind='mergesort')
    best, best_count = np.full(n, -1), 0
    factor, solved = np.zeros((BAR_SIZE * n, BAR_SIZE * n)), np.zeros(BAR_SIZE * n)
    for start in range(min(found, MAX_STARTS)):
        matches, is_taken = np.full(n, -1), np.zeros(count, np.bool_)
        size, accepted = 0, 0
        for turn in range(found + 1):
            k = order[start] if turn == 0 else order[turn - 1]
            o, f = pairs[k] // count, pairs[k] % count
            if matches[o] >= 0 or is_taken[f]:
                continue
            rows[size], known_rows[size] = offsets[o], known_offsets[f]
            m = _size(offsets, known_offsets, o, f)
            distance = _extend(
                size, m, values, covariance, known_values, known_covariance, rows, known_rows,
                factor, solved,
            )
            if survival(distance, m) >= outlier_probability:
                matches[o], is_taken[f] = f, True
                size, accepted = size + m, accepted + 1
        if accepted > best_count:
            best, best_count = matches, accepted
        elif accepted == best_count:
            # Two explanations that are equally good: keep what they have in common.
            for o in range(n):
                if matches[o] != best[o]:
                    best[o] = -1
        if best_count == possible == found:
            break
    return best


@compiled
def _size(
    offsets: NDArray[np.int64], known_offsets: NDArray[np.int64], o: int, f: int
) -> int:
    """Return the number of values by which two features are compared."""
    return min(offsets[o + 1] - offsets[o], known_offsets[f + 1] - known_offsets[f])


@compiled
def _extend(
    size: int, m: int, values: NDArray[np.float64], covariance: NDArray[np.float64],
    known_values: NDArray[np.float64], known_covariance: NDArray[np.float64],
    rows: NDArray[np.int64], known_rows: NDArray[np.int64], factor: NDArray[np.float64],
    solved: NDArray[np.float64],
) -> float:
    """Append a pair to the Cholesky factor of the joint innovation.

    Args:
        size: number of rows before it.
        m: number of values of the pair; its places are at ``rows[size]``, ``known_rows[size]``.
        values, covariance: of the seen features.
        known_values, known_covariance: of the known features.
        rows, known_rows: places of all rows.
        factor: lower triangle, extended.
        solved: factor^-1 times the innovation, extended.

    Returns:
        The squared Mahalanobis distance of the pair, given those before it.
    """
    squared = 0.0
    for a in range(m):
        i = size + a
        rows[i], known_rows[i] = rows[size] + a, known_rows[size] + a
        innovation = values[rows[i]] - known_values[known_rows[i]]
        solved[i] = wrap(innovation) if a == POINT_SIZE else innovation
        for j in range(i + 1):
            factor[i, j] = (
                covariance[rows[i], rows[j]] + known_covariance[known_rows[i], known_rows[j]]
            )
        extend_factor(factor, i, _LEAST_PIVOT)
        solved[i] = solve_row(factor, i, solved)
        squared += solved[i] * solved[i]
    return squared
