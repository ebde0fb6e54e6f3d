# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cholesky factor of a covariance that grows row by row, in a fixed order of operations."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled


@compiled
def extend_factor(
    lower: NDArray[np.float64], row: int, least_pivot: float = 1e-300
) -> None:
    """Replace a row of a positive definite matrix by that of its factor, after the rows before it.

    Args:
        lower: lower triangle; the rows before this one are those of the factor.
        row: the row.
        least_pivot: smallest square of the diagonal element, against rounding.
    """
    for column in range(row + 1):
        total = lower[row, column]
        for k in range(column):
            total -= lower[row, k] * lower[column, k]
        if column < row:
            lower[row, column] = total / lower[column, column]
        else:
            lower[row, row] = math.sqrt(max(total, least_pivot))


@compiled
def solve_row(lower: NDArray[np.float64], row: int, values: NDArray[np.float64]) -> float:
    """Return element ``row`` of the solution of L y = b.

    Args:
        lower: the factor L up to this row.
        row: the row.
        values: (d,) the elements of y before the row, and that of b in it.
    """
    total = values[row]
    for k in range(row):
        total -= lower[row, k] * values[k]
    return total / lower[row, row]
