# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rotation gain of odometry, estimated from closed loops.

On the way from a place back to the same place, a robot turns by a multiple of 360 degrees plus the
difference of its headings there. Odometry that measures a turn T instead has the gain g with
g T = 360 k + difference, for an integer k. One loop fits many gains, one for each k; several
loops with different turns, or the assumption that a simple loop has k = 1, select one of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import TWO_PI
from ratslam_ros.core.common.compiled import compiled

Floats = NDArray[np.float64]

HEADING_SD_RAD = math.radians(10.0)
"""Standard deviation of the difference of the headings at which a robot passes a place twice."""

TURN_SD_RATIO = 0.06
"""Standard deviation of a measured turn of 360 degrees, relative to it; the variance is
proportional to the turn."""

OUTLIER_SHARE = 0.2
"""Assumed share of loops that are false recognitions."""

GRID_RATIO = 1.01
"""Ratio of successive gains that are tried."""

MIN_SCORE = 0.1
"""Smallest score of an estimate. A gain that explains no loop has a negative score."""

MIN_EVIDENCE = 10.0
"""Smallest sum of log likelihood ratios over all loops. With fewer loops, one of the many gains
that are tried fits by chance."""

MIN_SHARE = 0.5
"""Smallest share of the loops that an estimate has to explain."""

CONSISTENT_SD = 2.0
"""Largest residual of a loop that an estimate explains, in standard deviations."""

MIN_PEAK_RATIO = 1.1
"""Ratio between the scores of an estimate and of any other gain that is not close to it."""

CLOSE_RATIO = 1.1
"""Gains whose ratio is smaller are estimates of the same gain."""


class GainEstimate(NamedTuple):
    """A rotation gain, and the evidence for it.

    ``gain``: factor for measured turns. ``loops``: number of loops that it explains. ``share``:
    their share of all loops. ``residual_sd_rad``: standard deviation of their residuals.
    """

    gain: float
    loops: int
    share: float
    residual_sd_rad: float


def estimate_gain(
    turns_rad: Floats, differences_rad: Floats, low: float, high: float
) -> GainEstimate | None:
    """Estimate the rotation gain from closed loops.

    The score of a gain is the mean log likelihood ratio of the loops' residuals, under a mixture
    of a normal and a uniform distribution. The normal distribution widens with the corrected turn,
    so that of gains that explain the loops with k, 2k, ... the smallest has the highest score. A
    loop whose corrected turn rounds to k = 0 counts for no gain and against none. The best gain of
    a grid is refined by weighted least squares over the loops that it explains.

    Args:
        turns_rad: (n,) turn of each loop as measured, not wrapped.
        differences_rad: (n,) heading at the end of the loop minus heading at its start, as seen.
        low, high: limits of the gain, above 0.

    Returns:
        The estimate, None if the loops contain no information on the gain, contradict each other
        or fit different gains equally well.
    """
    if len(turns_rad) == 0:
        return None
    count = round(math.log(high / low) / math.log(GRID_RATIO)) + 1
    gains = np.array([min(low * GRID_RATIO**i, high) for i in range(count)])
    scores = np.empty(count)
    _score(turns_rad, differences_rad, gains, scores)
    best = int(scores.argmax())
    rival = max(
        (
            scores[i] for i in range(count)
            if not 1.0 / CLOSE_RATIO < gains[i] / gains[best] < CLOSE_RATIO
        ),
        default=-math.inf,
    )  # fmt: skip
    if scores[best] < max(MIN_SCORE, MIN_EVIDENCE / len(turns_rad), MIN_PEAK_RATIO * rival):
        return None
    gain, explained, variance = _refined(turns_rad, differences_rad, float(gains[best]))
    share = explained / len(turns_rad)
    if share < MIN_SHARE or not low <= gain <= high:
        return None
    return GainEstimate(gain, explained, share, math.sqrt(variance))


@compiled
def _residual(turn: float, difference: float, gain: float) -> tuple[float, float, float]:
    """Return k, the residual of the corrected turn, and its variance, in rad and rad^2."""
    turns = round((gain * turn - difference) / TWO_PI)
    residual = gain * turn - difference - TWO_PI * turns
    sd = TURN_SD_RATIO * TWO_PI
    variance = HEADING_SD_RAD * HEADING_SD_RAD + sd * sd * abs(gain * turn) / TWO_PI
    return turns, residual, variance


@compiled
def _score(turns: Floats, differences: Floats, gains: Floats, scores: Floats) -> None:
    """Fill ``scores`` with the score of each gain."""
    for i in range(gains.shape[0]):
        total = 0.0
        for j in range(turns.shape[0]):
            k, residual, variance = _residual(turns[j], differences[j], gains[i])
            if k != 0.0:
                normal = math.exp(-0.5 * residual * residual / variance)
                normal *= math.sqrt(TWO_PI / variance)
                total += math.log((1.0 - OUTLIER_SHARE) * normal + OUTLIER_SHARE)
        scores[i] = total / turns.shape[0]


@compiled
def _refined(turns: Floats, differences: Floats, gain: float) -> tuple[float, int, float]:
    """Return the refined gain, the number of explained loops and the mean squared residual."""
    explained = 0
    squares = 0.0
    for _ in range(5):
        numerator = denominator = squares = 0.0
        explained = 0
        for j in range(turns.shape[0]):
            k, residual, variance = _residual(turns[j], differences[j], gain)
            if k != 0.0 and residual * residual <= CONSISTENT_SD * CONSISTENT_SD * variance:
                numerator += turns[j] * (TWO_PI * k + differences[j]) / variance
                denominator += turns[j] * turns[j] / variance
                squares += residual * residual
                explained += 1
        if explained == 0:
            break
        gain = numerator / denominator
    return gain, explained, squares / max(explained, 1)
