# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Time by step, cheap enough to be always on and of constant size."""

from __future__ import annotations

import math
import time

BINS_PER_OCTAVE = 16  # a bin is 4.4 % wide


class Histogram:
    """Durations in bins of equal ratio, from 2^-30 s (1 ns) on."""

    def __init__(self) -> None:
        self.count = 0
        self._bins = [0] * (BINS_PER_OCTAVE * 45)

    def add(self, duration_s: float) -> None:
        """Count one duration."""
        self.count += 1
        octave = math.log2(max(duration_s, 2.0**-30)) + 30.0
        self._bins[min(int(octave * BINS_PER_OCTAVE), len(self._bins) - 1)] += 1

    def quantile_s(self, share: float) -> float:
        """Return the middle of the bin that a share of the durations does not exceed."""
        rank = share * self.count
        seen = 0
        for index, count in enumerate(self._bins):
            seen += count
            if count and seen >= rank:
                return math.exp2((index + 0.5) / BINS_PER_OCTAVE - 30.0)
        return 0.0


class _Watch:
    """Adds the time from entering to leaving to a histogram."""

    __slots__ = ('_histogram', '_start_s')

    def __init__(self, histogram: Histogram) -> None:
        self._histogram = histogram
        self._start_s = 0.0

    def __enter__(self) -> None:
        self._start_s = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._histogram.add(time.perf_counter() - self._start_s)


class StepTimes:
    """A histogram a step; call with a step's name and enter what is returned."""

    def __init__(self) -> None:
        self._watches: dict[str, tuple[Histogram, _Watch]] = {}

    def __call__(self, name: str) -> _Watch:
        """Return the step's stopwatch."""
        known = self._watches.get(name)
        if known is None:
            histogram = Histogram()
            known = self._watches[name] = histogram, _Watch(histogram)
        return known[1]

    def summary_ms(self) -> dict[str, dict[str, float]]:
        """Return ``{step: {count, median, p99}}``, times in ms."""
        return {
            name: {
                'count': histogram.count,
                'median': round(histogram.quantile_s(0.5) * 1e3, 4),
                'p99': round(histogram.quantile_s(0.99) * 1e3, 4),
            }
            for name, (histogram, _) in sorted(self._watches.items())
        }
