# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Systematic errors of the turns that odometry measures, estimated from closed loops.

On the way from a place back to the same place, a robot turns by a multiple of 360 degrees plus the
difference of its headings there. If T is the measured turn of a loop of length s, the gain g and
the turn per metre c satisfy

    g T + c s = 360 k + difference

for an integer k. There are two cases.

Wheels and gyros measure turns in a known unit. They have two small systematic errors, Borenstein
and Feng (1996): a wrong wheel base scales all turns, and unequal wheel diameters add a turn to
every metre (`systematic_errors`).

A camera with an unknown field of view measures turns in an unknown unit (`scale_of_turns`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.turn_correction import TurnCorrection

Floats = NDArray[np.float64]

OUTLIER_SHARE = 0.2
"""Assumed share of loops that are false recognitions."""

MIN_SHARE = 0.5
"""Smallest share of the loops that an estimate has to explain."""

MIN_EVIDENCE = 10.0
"""Smallest sum of log likelihood ratios over all loops. With fewer loops, one of the many gains
that are tried fits by chance."""

GRID_RATIO = 1.01
"""Ratio of successive gains that are tried."""

# Turns in a known unit

HEADING_SD_RAD = math.radians(10.0)
"""Standard deviation of the difference of the headings at which a robot passes a place twice."""

TURN_SD_RATIO = 0.06
"""Standard deviation of a measured turn of 360 degrees, relative to it; the variance is
proportional to the turn."""

CONSISTENT_SD = 2.0
"""Largest residual of a loop that an estimate explains, in standard deviations."""

ITERATIONS = 5
"""Repetitions of the least squares fit, each with the loops that the last one explains."""

SMALL_ERROR_RATIO = 1.15
"""Largest gain, or inverse of a gain, that is an error of wheels or of a gyro."""

GAIN_SD, PER_M_SD_RAD = 0.03, 0.005
"""Standard deviations of the systematic errors of odometry in general, as prior. 0.005 rad/m are
0.2 % difference between wheels that are 0.4 m apart."""

PER_M_GRID_RAD = PER_M_SD_RAD * 0.5 * np.arange(-6.0, 7.0)
"""(13,) turns per metre that are tried, in rad/m."""

INDEPENDENT_LOOPS_COUNT = 10.0
"""The evidence of more loops is scaled down to that of so many. Loops of one route share the
errors of the route, which further laps do not average out."""

# Turns in an unknown unit

WHOLE_TURNS = np.array([0.7, 0.2, 0.1])
"""Prior of the number of whole turns of a loop, 1 to 3. A loop from one visit of a place to the
next one rarely contains another loop."""

RELATIVE_SDS = np.array([0.04, 0.08, 0.12, 0.18])
"""Standard deviations of measured turns, relative to them, that are tried."""

OUTLIER_RANGE = math.log(20.0)
"""Range of the logarithm of a turn about which nothing is known."""


class Estimate(NamedTuple):
    """A correction, the number of loops that it explains, and their share of all loops."""

    correction: TurnCorrection
    loops: int
    share: float


def is_small_error(ratio: float) -> bool:
    """Return whether a gain, relative to the expected one, is an error of wheels or of a gyro."""
    return 1.0 / SMALL_ERROR_RATIO < ratio < SMALL_ERROR_RATIO


def systematic_errors(
    turns_rad: Floats, lengths_m: Floats, differences_rad: Floats, expected: float = 1.0
) -> Estimate | None:
    """Estimate the systematic errors of turns in a known unit from closed loops.

    The gain and turn per metre of the highest posterior density are refined by least squares. They
    are searched together: on long loops, one error without the other suits another number of whole
    turns. The residuals of true loops are normally distributed, those of false ones uniformly.

    Args:
        turns_rad: (n,) turn of each loop as measured, not wrapped.
        lengths_m: (n,) length of each loop as measured, negative if driven backwards.
        differences_rad: (n,) heading at the end of the loop minus heading at its start, as seen.
        expected: the gain that the errors are relative to.

    Returns:
        The estimate, None if there are too few loops, if they contradict each other, or if the
        error is too large for wheels or a gyro.
    """
    n = len(turns_rad)
    steps = math.ceil(math.log(SMALL_ERROR_RATIO) / math.log(GRID_RATIO))
    gains = np.array([expected * GRID_RATIO**k for k in range(-steps, steps + 1)])
    evidence = _evidence_of_errors(turns_rad, lengths_m, differences_rad, gains, PER_M_GRID_RAD)
    density = (
        evidence - 0.5 * ((gains / expected - 1.0) / GAIN_SD)[:, None] ** 2
        - 0.5 * (PER_M_GRID_RAD / PER_M_SD_RAD) ** 2
    )
    at, per_m_at = np.unravel_index(int(density.argmax()), density.shape)
    if evidence[at, per_m_at] < MIN_EVIDENCE:
        return None
    gain, per_m_rad, loops = _least_squares(
        turns_rad, lengths_m, differences_rad, float(gains[at]),
        float(PER_M_GRID_RAD[per_m_at]), expected,
    )
    if loops < MIN_SHARE * n or not is_small_error(gain / expected):
        return None
    return Estimate(TurnCorrection(gain, per_m_rad), loops, loops / n)


def scale_of_turns(turns_rad: Floats, low: float, high: float) -> Estimate | None:
    """Estimate the unit of turns from closed loops.

    A loop turns by 360 k degrees. Several gains explain the same loops, with other k; that of the
    highest likelihood is returned. The likelihood of a turn is a mixture over k = 1 to 3 and false
    loops, whose turns may have any size. The noise of a turn is proportional to it, and is
    estimated as well.

    Args:
        turns_rad: (n,) turn of each loop as measured, not wrapped. The robot faces the same way at
            both ends.
        low, high: range of the gain.

    Returns:
        The estimate, without a turn per metre. None if there are too few loops, if they contradict
        each other, or if the likelihood grows towards an end of the range.
    """
    turns = np.abs(turns_rad)
    turns = turns[turns * high > math.pi]  # With any gain, k is 0 for the others.
    count = math.ceil(math.log(high / low) / math.log(GRID_RATIO)) + 1
    # NumPy's powers depend on its version and on the processor.
    gains = np.array([low * (high / low) ** (k / (count - 1)) for k in range(count)])
    evidence = _evidence_of_scale(turns, gains, RELATIVE_SDS, WHOLE_TURNS)
    at_sd, best = np.unravel_index(int(evidence.argmax()), evidence.shape)
    if evidence[at_sd, best] < MIN_EVIDENCE or best in (0, count - 1):
        return None
    gain, sd = float(gains[best]), RELATIVE_SDS[at_sd]
    whole = np.clip(np.rint(gain * turns / math.tau), 1, len(WHOLE_TURNS))
    agree = np.abs(gain * turns - math.tau * whole) < CONSISTENT_SD * sd * math.tau * whole
    loops = int(agree.sum())
    if loops < MIN_SHARE * len(turns):
        return None
    return Estimate(TurnCorrection(gain, 0.0), loops, loops / len(turns))


@compiled
def _residual(corrected: float, difference: float) -> tuple[float, float, float]:
    """Return k, the residual of a corrected turn, and its variance, in rad and rad^2."""
    k = round((corrected - difference) / math.tau)
    sd = TURN_SD_RATIO * math.tau
    variance = HEADING_SD_RAD * HEADING_SD_RAD + sd * sd * abs(corrected) / math.tau
    return k, corrected - difference - math.tau * k, variance


@compiled
def _evidence_of_errors(
    turns: Floats, lengths: Floats, differences: Floats, gains: Floats, per_m: Floats
) -> Floats:
    """Return the sum of the log likelihood ratios of all loops, (gains, turns per metre)."""
    evidence = np.zeros((gains.shape[0], per_m.shape[0]))
    for i in range(gains.shape[0]):
        for k in range(per_m.shape[0]):
            for j in range(turns.shape[0]):
                corrected = gains[i] * turns[j] + per_m[k] * lengths[j]
                _, residual, variance = _residual(corrected, differences[j])
                normal = math.exp(-0.5 * residual * residual / variance)
                normal *= math.sqrt(math.tau / variance)
                evidence[i, k] += math.log((1.0 - OUTLIER_SHARE) * normal + OUTLIER_SHARE)
    return evidence


@compiled
def _evidence_of_scale(turns: Floats, gains: Floats, sds: Floats, prior: Floats) -> Floats:
    """Return the sum of the log likelihood ratios of all loops, for each deviation and gain."""
    evidence = np.zeros((sds.shape[0], gains.shape[0]))
    for s in range(sds.shape[0]):
        for i in range(gains.shape[0]):
            for j in range(turns.shape[0]):
                ratio = OUTLIER_SHARE
                turned = gains[i] * turns[j] / math.tau
                for n in range(prior.shape[0]):
                    z = (turned / (n + 1) - 1.0) / sds[s]
                    density = math.exp(-0.5 * z * z) / (math.sqrt(math.tau) * sds[s] * (n + 1))
                    # Per turn that is unknown by its logarithm: d turn = turn d log turn.
                    ratio += (1.0 - OUTLIER_SHARE) * prior[n] * density * turned * OUTLIER_RANGE
                evidence[s, i] += math.log(ratio)
    return evidence


@compiled
def _least_squares(
    turns: Floats, lengths: Floats, differences: Floats, gain: float, per_m: float,
    expected: float,
) -> tuple[float, float, int]:
    """Refine a gain and a turn per metre by least squares with prior.

    Returns:
        The gain, the turn per metre and the number of loops that they explain.
    """
    loops = 0
    for _ in range(ITERATIONS):
        a = b = c = right_a = right_b = 0.0
        loops = 0
        for j in range(turns.shape[0]):
            corrected = gain * turns[j] + per_m * lengths[j]
            k, residual, variance = _residual(corrected, differences[j])
            if residual * residual <= CONSISTENT_SD * CONSISTENT_SD * variance:
                error = math.tau * k + differences[j] - expected * turns[j]
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
