# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Match threshold: the largest difference at which a view is recognised.

An automatic threshold follows from the differences between unrelated views, which depend on the
scene, the camera and the descriptor. They differ from view to view as well: a view with much
structure differs more from all others than a plain one. Each view is therefore compared with some
old templates first, and the median is its typical difference, few templates being related to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import AUTOMATIC, LocalViewParameters

RELATED_RATIO = 0.67
"""Difference up to which views are related, relative to the median between unrelated views."""

SAMPLE_COUNT = 33
"""Number of old templates that each view is compared with."""

MIN_SAMPLE_COUNT = 12
"""With fewer old templates, their median may be that of related ones. The typical difference of
the views before is used then."""

MAX_SAMPLE_COUNT = 128
"""Number of latest views whose typical difference is kept."""

PRIOR_VIEW_COUNT = 2
"""Weight of the descriptor's typical difference, in views, before differences were measured."""


class MatchThreshold(Saved):
    """Limits of the SAD of a match: for all templates, and for the newest ones."""

    SAVED = (
        Field('samples', '_samples', 'i8', ('',), 0, load=lambda samples: samples.tolist()),
    )

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
        self._fixed = parameters.vt_match_threshold
        self._prior = math.floor(typical * full_sum)
        self._samples: list[int] = []
        self._pooled = self._typical = self._prior

    def reconfigure(self, parameters: LocalViewParameters) -> None:
        """Continue with other values of the parameters; what was measured is kept."""
        self._recent = parameters.vt_recent_threshold
        if parameters.vt_match_ratio != AUTOMATIC:
            self._ratio = parameters.vt_match_ratio
        self.is_automatic = parameters.vt_match_threshold == AUTOMATIC
        self._fixed = parameters.vt_match_threshold

    @property
    def value(self) -> float:
        """Largest mean difference of a match, from 0 to 1."""
        if not self.is_automatic:
            return self._fixed
        return self._ratio * self._typical / self._full_sum

    @property
    def limit(self) -> int:
        """Largest SAD of a match."""
        return math.floor(self.value * self._full_sum)

    @property
    def recent_limit(self) -> int:
        """Largest SAD of a match with one of the newest templates."""
        return math.floor(self._recent * (self.value * self._full_sum))

    @property
    def related_limit(self) -> int:
        """Largest SAD of views between which the scene has changed only in part."""
        return math.floor(RELATED_RATIO * self._pooled)

    def use_ratio(self, ratio: float) -> None:
        """Limit an automatic threshold to this share of the median between unrelated views."""
        self._ratio = ratio

    def adapt(
        self, unrelated: int, sads_of: Callable[[Sequence[int]], NDArray[np.int64]], learn: bool
    ) -> None:
        """Measure the typical difference of a view, which an automatic threshold follows.

        Args:
            unrelated: number of oldest templates that are unrelated to the view.
            sads_of: function from numbers of templates, the oldest first, to their SADs.
            learn: whether to use the difference for views with few unrelated templates as well.
        """
        if not self.estimates:
            return
        count = min(SAMPLE_COUNT, unrelated)
        if count > 0:
            sads = sads_of([(2 * k + 1) * unrelated // (2 * count) for k in range(count)])
            self._typical = int(np.partition(sads, count // 2)[count // 2])
            if learn:
                self._samples.append(self._typical)
                del self._samples[:-MAX_SAMPLE_COUNT]
                self._pool()
        if count < MIN_SAMPLE_COUNT:
            self._typical = self._pooled

    def _restored(self, state: State) -> None:
        self._pool()
        self._typical = self._pooled

    def _pool(self) -> None:
        missing = max(PRIOR_VIEW_COUNT - len(self._samples), 0)
        ordered = sorted([*self._samples, *[self._prior] * missing])
        self._pooled = ordered[len(ordered) // 2]
