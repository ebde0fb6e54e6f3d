# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Observations of the goal memory as Milford et al. (2005) print them: equations (2) to (5).

In every iteration, each cell i that was active in the last one is linked with each cell j that is
active now, forwards and backwards in time: mu_ij = mu_ji.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Cells = NDArray[np.int64]
Reals = NDArray[np.float64]

ETA_TAU, ETA_CHI_S, ETA_DELTA_S = 1.0, 0.25, 0.1
"""Weights of elapsed time, of weak activity and of each cell of distance: section IV.C."""

ITERATION_S = 0.1
"""Duration of an iteration: the networks run at 10 Hz on average (section IV.A)."""

STAMP_JITTER_S = 0.001
"""An iteration may be this much shorter, as odometry at 10, 20 or 40 Hz is never quite regular."""

INITIAL_S = 1000.0
"""Time of a link before its first observation; the paper says "large values". This one exceeds the
time of any route over a floor. A packet at 0.16 m/s leaves a cell after fifteen iterations, which
divide it by 33,000."""


def observations_s(
    before: tuple[Cells, Reals], now: tuple[Cells, Reals], elapsed_s: float,
    extents: tuple[int, int],
) -> Reals:
    """Return the terms that (5) adds to the links between two iterations.

    Args:
        before: cells of the last iteration, y * n_x + x, and their activity G_i (1), above 0.
        now: cells of this iteration, and their activity G_j.
        elapsed_s: t_k - t_(k-1).
        extents: n_x and n_y of the torus.

    Returns:
        (cells before, cells now) tau + chi + delta, in seconds.
    """
    (i, g_i), (j, g_j) = before, now
    n_x, n_y = extents
    # The largest activity of both iterations, so that chi, a time, is never negative.
    g_max = max(g_i.max(), g_j.max())
    tau = ETA_TAU * elapsed_s  # (2)
    chi = ETA_CHI_S * (g_max * g_max / np.multiply.outer(g_i, g_j) - 1.0)  # (3)
    dx = np.abs(np.subtract.outer(i % n_x, j % n_x))
    dy = np.abs(np.subtract.outer(i // n_x, j // n_x))
    dx, dy = np.minimum(dx, n_x - dx), np.minimum(dy, n_y - dy)
    delta = ETA_DELTA_S * np.sqrt(dx * dx + dy * dy)  # (4), around the torus
    return np.asarray(tau + chi + delta)


def updated_s(mu_s: float, observed_s: float) -> float:
    """Return the time of a link after an observation: equation (5)."""
    return 0.5 * (mu_s + observed_s)
