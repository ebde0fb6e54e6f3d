# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Durations of processing steps, measured with low overhead in constant memory."""

from __future__ import annotations

import math
import time
from collections import defaultdict

BINS_PER_OCTAVE = 16
"""Histogram bins per factor of 2 in duration; each bin is 4.4 % wide."""

_OCTAVES_BELOW_1_S = 30.0
_MIN_DURATION_S = 2.0**-30
"""Shorter durations (below about 1 ns) are counted in the first bin."""

_OCTAVE_COUNT = 45
"""Durations above 2^15 s (9 hours) are counted in the last bin."""

_BIN_COUNT = BINS_PER_OCTAVE * _OCTAVE_COUNT


class Histogram:
    """Histogram of durations with logarithmic bins; counts the time inside of a ``with`` block."""

    __slots__ = ('_bins', '_start_s', 'count')

    def __init__(self) -> None:
        self.count = 0
        self._bins = [0] * _BIN_COUNT
        self._start_s = 0.0

    def __enter__(self) -> None:
        self._start_s = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self.add(time.perf_counter() - self._start_s)

    def add(self, duration_s: float) -> None:
        """Count one duration, in seconds."""
        self.count += 1
        if duration_s < _MIN_DURATION_S:
            self._bins[0] += 1
            return
        number = int((math.log2(duration_s) + _OCTAVES_BELOW_1_S) * BINS_PER_OCTAVE)
        self._bins[number if number < _BIN_COUNT else -1] += 1

    def quantile_s(self, share: float) -> float:
        """Return a quantile in seconds, as the geometric centre of its bin; 0 if empty.

        Args:
            share: 0 to 1; 0.5 gives the median.
        """
        rank = share * self.count
        cumulative_count = 0
        for index, count in enumerate(self._bins):
            cumulative_count += count
            if count and cumulative_count >= rank:
                return math.exp2((index + 0.5) / BINS_PER_OCTAVE - _OCTAVES_BELOW_1_S)
        return 0.0


class StepTimes:
    """Durations by step; use as ``with times('step'): ...``."""

    def __init__(self) -> None:
        self._histograms: defaultdict[str, Histogram] = defaultdict(Histogram)

    def __call__(self, name: str) -> Histogram:
        """Return the context manager that measures a step."""
        return self._histograms[name]

    def summary_ms(self) -> dict[str, dict[str, float]]:
        """Return ``{step: {count, median, p99}}``, sorted by step, with times in milliseconds."""
        return {
            name: {
                'count': histogram.count,
                'median': round(histogram.quantile_s(0.5) * 1e3, 4),
                'p99': round(histogram.quantile_s(0.99) * 1e3, 4),
            }
            for name, histogram in sorted(self._histograms.items())
        }
