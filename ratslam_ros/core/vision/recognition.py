# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which template a view is recognised as: the one of the smallest difference, within a threshold.

As in OpenRatSLAM, apart from a stricter threshold for the newest templates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from ratslam_ros.core.common.odometry import MotionFromOdometry, Odometry
from ratslam_ros.core.config import InputParameters, LocalViewParameters
from ratslam_ros.core.vision.encoder import Layout, View
from ratslam_ros.core.vision.template_memory import Match, Search, TemplateMemory

FIXED_THRESHOLD = -1.0
"""Threshold of a match if it is the one of the configuration."""


class Recognised(NamedTuple):
    """The match of a view within its threshold, if any.

    Attributes:
        match: the match.
        min_sad: smallest SAD to all templates; None if there are none.
        related_count: number of newest templates that show the same scene as the view.
    """

    match: Match | None
    min_sad: int | None
    related_count: int


class Recognition:
    """Recognition with a threshold that is configured."""

    threshold: Any = None
    sequence: Any = None
    look_alikes: Any = None
    estimated_threshold = FIXED_THRESHOLD
    """Largest mean difference of a match, from 0 to 1; -1 if it is fixed."""

    def __init__(
        self, parameters: LocalViewParameters, memory: TemplateMemory, layout: Layout,
        inputs: InputParameters,
    ) -> None:
        self._p, self._memory = parameters, memory
        self.motion = MotionFromOdometry(
            inputs.odom_source, inputs.max_odom_gap_s, inputs.turn_correction
        )

    def reconfigure(self, parameters: LocalViewParameters) -> None:
        """Continue with other values of the parameters; what was measured is kept."""
        self._p = parameters

    def follow(self, odometry: Odometry) -> None:
        """Follow the robot."""

    def relocated(self) -> None:
        """Continue after the robot may have been moved unobserved."""
        self.motion.restart()

    def learned(self, template_id: int, removed: Sequence[int]) -> None:
        """Record a new template, and those that were removed before."""

    def of(self, view: View, learn: bool) -> Recognised:
        """Recognise a view; ``learn``: whether it is learned otherwise."""
        search, count = self._memory.search(view), len(self._memory)
        first_recent = max(count - self._p.vt_recent_templates, 0)
        full_sum = self._p.vt_match_threshold * self._memory.full_sum
        limits = math.floor(full_sum), math.floor(self._p.vt_recent_threshold * full_sum)
        return Recognised(*self._best(search, first_recent, *limits), 0)

    def _best(
        self, search: Search, first_recent: int, limit: int, recent_limit: int
    ) -> tuple[Match | None, int | None]:
        """Return the match within its limit, if any, and the smallest SAD, if computed.

        Args:
            search: the comparison of the view.
            first_recent: number of templates that are not among the newest ones.
            limit: largest SAD of a match.
            recent_limit: largest SAD of a match with one of the newest templates.
        """
        best = search.best()
        if best is None:
            return None, None
        if best.template_id < self._memory.nth_id(first_recent):
            return best if best.sad <= limit else None, best.sad
        if best.sad <= recent_limit:
            return best, best.sad
        return search.best(first_recent, limit), best.sad
