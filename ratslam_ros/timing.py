# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Durations of processing steps, measured with low overhead in little memory."""

from __future__ import annotations

import math
import time
from collections import Counter, defaultdict

BINS_PER_OCTAVE = 16
"""Histogram bins per factor of 2 in duration; each bin is 4.4 % wide."""

SHORTEST_S = 2.0**-30
"""Shorter durations (below about 1 ns) are counted as this one."""


class Histogram:
    """Histogram of durations with logarithmic bins; counts the time inside of a ``with`` block."""

    __slots__ = ('_bins', '_start_s')

    def __init__(self) -> None:
        self._bins: Counter[int] = Counter()
        self._start_s = 0.0

    def __enter__(self) -> None:
        self._start_s = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self.add(time.perf_counter() - self._start_s)

    @property
    def count(self) -> int:
        """Number of counted durations."""
        return self._bins.total()

    def add(self, duration_s: float) -> None:
        """Count one duration, in seconds."""
        self._bins[math.floor(math.log2(max(duration_s, SHORTEST_S)) * BINS_PER_OCTAVE)] += 1

    def quantile_s(self, share: float) -> float:
        """Return a quantile in seconds, as the geometric centre of its bin; 0 if empty.

        Args:
            share: 0 to 1; 0.5 gives the median.
        """
        rank = share * self.count
        cumulative_count = 0
        for number, count in sorted(self._bins.items()):
            cumulative_count += count
            if cumulative_count >= rank:
                return math.exp2((number + 0.5) / BINS_PER_OCTAVE)
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
