# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of memories with a limit, whose items are forgotten by their freshness."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.common.freshness import Freshness
from ratslam_ros.core.config.parameter import Section, parameter


@dataclass(frozen=True)
class Forgetting(Section):
    """Selection of the item that is removed when a memory has reached its limit."""

    forget_share: float = parameter(
        0.5, 'probability', 0.0, 1.0,
        'Probability that a new item fades. At the limit, faded items are removed first, so that '
        'about the rest of the map of regions not seen for long is kept.',
        'recent regions should be kept in detail', 'old regions should be kept in detail',
    )  # fmt: skip
    forget_after_s: float = parameter(
        300.0, 's', 0.1, 1e8,
        'Time after the last observation at which an item counts as faded or old, and may be '
        'removed if the limit is reached.',
        'the robot returns to a region after a longer time',
        'the regions of this period do not fit within the limit',
    )  # fmt: skip
    forget_robust_visits: int = parameter(
        3, 'visits', 1, 1_000_000,
        'Number of visits after which an item does not fade any more. An observation counts as a '
        'visit if the item was not observed for a tenth of forget_after_s.',
        'the environment changes, so that many items are outdated',
        'places on frequent routes are forgotten',
    )  # fmt: skip

    def freshness(self, seed: int = 0) -> Freshness:
        """Return a memory of freshness values with these parameters and no items."""
        return Freshness(self.forget_share, self.forget_after_s, self.forget_robust_visits, seed)
