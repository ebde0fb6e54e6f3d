# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Probabilities that cells are occupied, of scans and of sonars."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

HIT, MISS = math.log(0.7 / 0.3), math.log(0.4 / 0.6)
"""Log odds that a beam that ends in a cell, or passes it, adds: Hornung et al. (2013), OctoMap."""

LOWEST, HIGHEST = math.log(0.12 / 0.88), math.log(0.97 / 0.03)
"""Bounds of the log odds that are shown, of the same source."""


class Picture(NamedTuple):
    """Probabilities that cells are occupied.

    Attributes:
        x_m, y_m: position on the map of the corner of the first cell.
        cell_m: size of a cell.
        percent: (rows, columns) int8, x to the right and y up; -1: unknown.
    """

    x_m: float
    y_m: float
    cell_m: float
    percent: NDArray[np.int8]
