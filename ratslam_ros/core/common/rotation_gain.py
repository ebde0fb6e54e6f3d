# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Systematic errors of the turns that odometry measures, estimated from closed loops.

On the way from a place back to the same place, a robot turns by a multiple of 360 degrees plus the
difference of its headings there. Wheel odometry has two systematic errors, Borenstein and Feng
(1996): a wrong wheel base scales all turns, and unequal wheel diameters add a turn to every metre.
With the wrong field of view, visual odometry scales all turns, by any factor. If T is the measured
turn of a loop of length s, the gain g and the turn per metre c satisfy

    g T + c s = 360 k + difference

for an integer k. One loop fits many gains, one for each k; several loops select one of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import TWO_PI
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.turn_correction import TurnCorrection

Floats = NDArray[np.float64]

LOWEST_GAIN, HIGHEST_GAIN = 0.2, 8.0
"""Range of the gains that are tried."""

HEADING_SD_RAD = math.radians(10.0)
"""Standard deviation of the difference of the headings at which a robot passes a place twice."""

TURN_SD_RATIO = 0.06
"""Standard deviation of a measured turn of 360 degrees, relative to it; the variance is
proportional to the turn."""

OUTLIER_SHARE = 0.2
"""Assumed share of loops that are false recognitions."""

GRID_RATIO = 1.01
"""Ratio of successive gains that are tried."""

PEAK_STEPS = 10
"""Gains fewer steps apart are estimates of the same gain."""

MIN_EVIDENCE = 10.0
"""Smallest sum of log likelihood ratios over all loops. With fewer loops, one of the many gains
that are tried fits by chance."""

MIN_SCORE = 0.1
"""Smallest mean of the log likelihood ratios."""

MIN_SHARE = 0.5
"""Smallest share of the loops that an estimate has to explain."""

CONSISTENT_SD = 2.0
"""Largest residual of a loop that an estimate explains, in standard deviations."""

ITERATIONS = 5
"""Repetitions of the least squares fit, each with the loops that the last one explains."""

OPEN_SHARE_TOLERANCE = 0.02
"""Difference between the distances of the ends of loops, relative to their lengths, below which
two gains close the loops equally well."""

RIVAL_RATIO = 0.3
"""Scores that exceed this fraction of the highest one belong to gains that may be right."""

SMALL_ERROR_RATIO = 1.15
"""Largest gain, or inverse of a gain, that is an error of wheels or of a gyro. A larger one means
that the scale of the measured turns is unknown."""

GAIN_SD, PER_M_SD_RAD = 0.03, 0.005
"""Standard deviations of the systematic errors of odometry in general, as prior. 0.005 rad/m are
0.2 % difference between wheels that are 0.4 m apart."""

INDEPENDENT_LOOPS_COUNT = 10.0
"""The evidence of more loops is scaled down to that of so many. Loops of one route share the
errors of the route, which further laps do not average out."""


class Estimate(NamedTuple):
    """A correction, the number of loops that it explains, and their share of all loops."""

    correction: TurnCorrection
    loops: int
    share: float


def estimate_correction(
    turns_rad: Floats, lengths_m: Floats, differences_rad: Floats, expected: float | None = None,
    open_share: Callable[[float], float] | None = None,
) -> Estimate | None:  # fmt: skip
    """Estimate the systematic errors of measured turns from closed loops.

    The score of a gain is the mean log likelihood ratio of the loops' residuals, under a mixture
    of a normal and a uniform distribution. A loop whose corrected turn rounds to k = 0 counts for
    no gain and against none.

    A gain close to the expected one is preferred. For it, both errors are estimated by least
    squares with their prior. Otherwise several gains may have high scores: multiples of the right
    gain explain the loops with multiples of k, and if opposite places look alike, so does twice
    the right gain. Of those whose loops are closed in translation as well, the smallest one is
    refined by least squares.

    Args:
        turns_rad: (n,) turn of each loop as measured, not wrapped.
        lengths_m: (n,) length of each loop as measured, negative if driven backwards.
        differences_rad: (n,) heading at the end of the loop minus heading at its start, as seen.
        expected: the gain that small errors are relative to; None if the scale of the turns is
            unknown.
        open_share: returns the distance between the ends of the loops relative to their length,
            for a gain; None if the path is not known well enough.

    Returns:
        The estimate, None if the loops contain too little information or contradict each other.
    """
    n = len(turns_rad)
    if n == 0:
        return None
    count = round(math.log(HIGHEST_GAIN / LOWEST_GAIN) / math.log(GRID_RATIO)) + 1
    gains = np.array([LOWEST_GAIN * GRID_RATIO**i for i in range(count)])
    scores = np.empty(count)
    _score(turns_rad, differences_rad, gains, scores)
    least = max(MIN_SCORE, MIN_EVIDENCE / n)
    peaks = [
        i for i in range(count)
        if scores[i] >= least
        and scores[i] == scores[max(i - PEAK_STEPS, 0) : i + PEAK_STEPS + 1].max()
    ]  # fmt: skip
    if not peaks:
        return None
    best = max(float(scores[i]) for i in peaks)
    fits = [
        _scale(turns_rad, differences_rad, float(gains[i]))
        for i in peaks if scores[i] >= RIVAL_RATIO * best
    ]  # fmt: skip
    fits = [(gain, loops) for gain, loops in fits if loops >= MIN_SHARE * n]
    if not fits:
        return None
    if expected is not None:
        gain, loops = min(fits, key=lambda fit: abs(math.log(fit[0] / expected)))
        if is_small_error(gain / expected):
            gain, per_m_rad, loops = _systematic_errors(
                turns_rad, lengths_m, differences_rad, gain, expected
            )
            if loops < MIN_SHARE * n:
                return None
            return Estimate(TurnCorrection(gain, per_m_rad), loops, loops / n)
    gain, loops = fits[0] if open_share is None else _smallest_closed(fits, open_share)
    return Estimate(TurnCorrection(gain, 0.0), loops, loops / n)


def _smallest_closed(
    fits: list[tuple[float, int]], open_share: Callable[[float], float]
) -> tuple[float, int]:
    """Return the smallest gain with which loops are about as well closed as with the best one.

    Args:
        fits: gains, ascending, and the numbers of loops that they explain.
        open_share: see ``estimate_correction``.
    """
    shares = [open_share(gain) for gain, _ in fits]
    limit = min(shares) + OPEN_SHARE_TOLERANCE
    return next(fit for fit, share in zip(fits, shares, strict=True) if share <= limit)


def is_small_error(ratio: float) -> bool:
    """Return whether a gain, relative to the expected one, is an error of wheels or of a gyro."""
    return 1.0 / SMALL_ERROR_RATIO < ratio < SMALL_ERROR_RATIO


@compiled
def _residual(corrected: float, difference: float) -> tuple[float, float, float]:
    """Return k, the residual of a corrected turn, and its variance, in rad and rad^2."""
    k = round((corrected - difference) / TWO_PI)
    sd = TURN_SD_RATIO * TWO_PI
    variance = HEADING_SD_RAD * HEADING_SD_RAD + sd * sd * abs(corrected) / TWO_PI
    return k, corrected - difference - TWO_PI * k, variance


@compiled
def _score(turns: Floats, differences: Floats, gains: Floats, scores: Floats) -> None:
    """Fill ``scores`` with the score of each gain."""
    for i in range(gains.shape[0]):
        total = 0.0
        for j in range(turns.shape[0]):
            k, residual, variance = _residual(gains[i] * turns[j], differences[j])
            if k != 0.0:
                normal = math.exp(-0.5 * residual * residual / variance)
                normal *= math.sqrt(TWO_PI / variance)
                total += math.log((1.0 - OUTLIER_SHARE) * normal + OUTLIER_SHARE)
        scores[i] = total / turns.shape[0]


@compiled
def _scale(turns: Floats, differences: Floats, gain: float) -> tuple[float, int]:
    """Refine a gain by least squares; return it and the number of loops that it explains."""
    loops = 0
    for _ in range(ITERATIONS):
        numerator = denominator = 0.0
        loops = 0
        for j in range(turns.shape[0]):
            k, residual, variance = _residual(gain * turns[j], differences[j])
            if k != 0.0 and residual * residual <= CONSISTENT_SD * CONSISTENT_SD * variance:
                numerator += turns[j] * (TWO_PI * k + differences[j]) / variance
                denominator += turns[j] * turns[j] / variance
                loops += 1
        if loops == 0:
            break
        gain = numerator / denominator
    return gain, loops


@compiled
def _systematic_errors(
    turns: Floats, lengths: Floats, differences: Floats, gain: float, expected: float
) -> tuple[float, float, int]:
    """Refine a gain, and estimate the turn per metre, by least squares with prior.

    Returns:
        The gain, the turn per metre and the number of loops that they explain.
    """
    per_m = 0.0
    loops = 0
    for _ in range(ITERATIONS):
        a = b = c = right_a = right_b = 0.0
        loops = 0
        for j in range(turns.shape[0]):
            corrected = gain * turns[j] + per_m * lengths[j]
            k, residual, variance = _residual(corrected, differences[j])
            if k != 0.0 and residual * residual <= CONSISTENT_SD * CONSISTENT_SD * variance:
                error = TWO_PI * k + differences[j] - expected * turns[j]
                a += turns[j] * turns[j] / variance
                b += turns[j] * lengths[j] / variance
                c += lengths[j] * lengths[j] / variance
                right_a += turns[j] * error / variance
                right_b += lengths[j] * error / variance
                loops += 1
        weight = max(loops / INDEPENDENT_LOOPS_COUNT, 1.0)
        a += weight / (GAIN_SD * GAIN_SD * expected * expected)
        c += weight / (PER_M_SD_RAD * PER_M_SD_RAD)
        determinant = a * c - b * b
        gain = expected + (c * right_a - b * right_b) / determinant
        per_m = (a * right_b - b * right_a) / determinant
    return gain, per_m, loops
