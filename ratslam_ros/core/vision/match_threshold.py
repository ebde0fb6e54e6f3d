# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Match threshold: the largest difference at which a view is recognised.

An automatic threshold follows from the differences between unrelated views, which depend on the
scene, the camera and the descriptor. Templates are unrelated if the view changed completely
between them. Each learned template is compared with some of them. The distribution of these
differences has few outliers, because templates of one place are rare among all pairs, and its
median and spread are robust to them.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import AUTOMATIC, LocalViewParameters

RELATED_RATIO = 0.655
"""Difference up to which views are related, relative to the median between unrelated views."""

FALSE_MATCH_RATE = 0.01
"""Bound on the probability that a view matches any unrelated template, if views differ in
independent, normally distributed components."""

SAMPLES_PER_TEMPLATE = 8
"""Number of unrelated templates that each new template is compared with."""

MAX_SAMPLE_COUNT = 1024
"""Number of latest differences between unrelated views that are kept."""

PRIOR_SAMPLE_COUNT = 16
"""Weight of the descriptor's typical difference, in samples, before differences were measured."""

_ABOVE_MEDIAN = 0.8413
"""Probability of a normal variable below its mean plus one standard deviation. The half above the
median is not affected by pairs of templates that do show the same place."""


class MatchThreshold:
    """Limits of the SAD of a match: for all templates, and for the newest ones."""

    def __init__(self, parameters: LocalViewParameters, full_sum: int, typical: float) -> None:
        """Prepare the limits.

        Args:
            parameters: ``vt_match_threshold`` and ``vt_recent_threshold``.
            full_sum: largest possible SAD.
            typical: typical difference between unrelated views, from 0 to 1, which an automatic
                threshold starts with.
        """
        self._recent = parameters.vt_recent_threshold
        fixed = parameters.vt_match_ratio
        self._ratio = RELATED_RATIO if fixed == AUTOMATIC else fixed
        self._full_sum = full_sum
        self.is_automatic = parameters.vt_match_threshold == AUTOMATIC
        """Whether the threshold is estimated from the views."""
        self.estimates = self.is_automatic
        """Whether differences of views are measured: also after the threshold has been set."""
        self._threshold = parameters.vt_match_threshold
        self._prior = math.floor(typical * full_sum)
        self._samples: list[int] = []
        self._template_count = 0
        self.related_limit = 0
        """Largest SAD of views between which the scene has changed only in part."""
        if self.estimates:
            self._estimate()

    def reconfigure(self, parameters: LocalViewParameters) -> None:
        """Continue with other values of the parameters; what was measured is kept."""
        self._recent = parameters.vt_recent_threshold
        if parameters.vt_match_ratio != AUTOMATIC:
            self._ratio = parameters.vt_match_ratio
        self.is_automatic = parameters.vt_match_threshold == AUTOMATIC
        if not self.is_automatic:
            self._threshold = parameters.vt_match_threshold
        if self.estimates:
            self._estimate()

    @property
    def value(self) -> float:
        """Largest mean difference of a match, from 0 to 1."""
        return self._threshold

    @property
    def limit(self) -> int:
        """Largest SAD of a match."""
        return math.floor(self._threshold * self._full_sum)

    @property
    def recent_limit(self) -> int:
        """Largest SAD of a match with one of the newest templates."""
        return math.floor(self._recent * (self._threshold * self._full_sum))

    def use_ratio(self, ratio: float) -> None:
        """Limit an automatic threshold to this share of the median between unrelated views."""
        if ratio != self._ratio:
            self._ratio = ratio
            self._estimate()

    def state(self) -> State:
        """Return the samples, for ``restore``."""
        return {'samples': np.array(self._samples, np.int64)}

    def restore(self, state: State, template_count: int) -> None:
        """Restore the samples that ``state`` returned."""
        self._samples = [int(sample) for sample in state['samples']]
        self._template_count = template_count
        if self.estimates:
            self._estimate()

    def learn(
        self, template_id: int, template_count: int, unrelated: int, sad_of: Callable[[int], int]
    ) -> None:
        """Sample differences of a new template, and update an automatic threshold.

        Args:
            template_id: id of the new template.
            template_count: number of templates, the new one included.
            unrelated: number of oldest templates that are unrelated to it.
            sad_of: function from the number of a template, the oldest first, to its SAD.
        """
        if not self.estimates:
            return
        count = min(SAMPLES_PER_TEMPLATE, unrelated)
        # Evenly spaced over the unrelated templates, with another offset for each template.
        self._samples += [
            sad_of(((2 * k + template_id % 2) * unrelated) // (2 * count)) for k in range(count)
        ]
        del self._samples[:-MAX_SAMPLE_COUNT]
        self._template_count = template_count
        self._estimate()

    def _estimate(self) -> None:
        missing = max(PRIOR_SAMPLE_COUNT - len(self._samples), 0)
        ordered = sorted([*self._samples, *[self._prior] * missing])
        median = ordered[len(ordered) // 2]
        spread = ordered[int(_ABOVE_MEDIAN * len(ordered))] / max(median, 1) - 1.0
        ratio = _ratio_of_chance(FALSE_MATCH_RATE / max(self._template_count, 1), spread)
        self.related_limit = math.floor(RELATED_RATIO * median)
        if self.is_automatic:
            self._threshold = min(self._ratio, ratio) * median / self._full_sum


def _ratio_of_chance(probability: float, spread: float) -> float:
    """Return the difference, relative to the median, that unrelated views fall below by chance.

    The difference between views of k independent components follows a chi distribution. Its
    relative standard deviation is 1 / sqrt(2 k), and below the median its tail is about
    0.5 (t exp(1 - t))^(k / 2), where t is the square of the ratio (Chernoff's bound, normalised
    at the median).

    Args:
        probability: probability of a smaller difference, below 0.5.
        spread: relative standard deviation of the differences.
    """
    exponent = 4.0 * spread * spread * math.log(2.0 * probability)  # 2 / k * log
    low, high = 0.0, 1.0
    for _ in range(50):
        t = 0.5 * (low + high)
        if math.log(t) + 1.0 - t < exponent:
            low = t
        else:
            high = t
    return math.sqrt(high)
