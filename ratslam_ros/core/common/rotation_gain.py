# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The unit of turns of a camera whose field of view is unknown, estimated from closed loops.

On the way from a place back to the same place, facing the same way, a robot turns by a multiple of
360 degrees. If T is the measured turn of the loop, the gain g satisfies g T = 360 k for an integer
k. Small errors, also of wheels and gyros, are left to relaxation (core/mapping/relaxation.py).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled

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

CONSISTENT_SD = 2.0
"""Largest residual of a loop that an estimate explains, in standard deviations."""

SMALL_ERROR_RATIO = 1.15
"""Largest gain, or inverse of a gain, that relaxation finds by itself, as an error of wheels or of
a gyro."""

WHOLE_TURNS = np.array([0.7, 0.2, 0.1])
"""Prior of the number of whole turns of a loop, 1 to 3. A loop from one visit of a place to the
next one rarely contains another loop."""

RELATIVE_SDS = np.array([0.04, 0.08, 0.12, 0.18])
"""Standard deviations of measured turns, relative to them, that are tried."""

OUTLIER_RANGE = math.log(20.0)
"""Range of the logarithm of a turn about which nothing is known."""


class Estimate(NamedTuple):
    """A gain, and the number of loops that it explains."""

    gain: float
    loops: int


def is_small_error(ratio: float) -> bool:
    """Return whether a gain, relative to the expected one, is left to relaxation."""
    return 1.0 / SMALL_ERROR_RATIO < ratio < SMALL_ERROR_RATIO


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
        The estimate. None if there are too few loops, if they contradict each other, or if the
        likelihood grows towards an end of the range.
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
    return Estimate(gain, loops)


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
