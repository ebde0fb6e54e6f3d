# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Evidence that the robot was carried: on known ground, its views are not those of the map.

A robot that was carried maps what it sees in the wrong place, recognises that again, and seems to
be localised. But where the map has places of long ago, their views are missing. A cumulative sum
of log-likelihood ratios (Page 1954) over spots of the path tells when that began. If views of
another place agree then, what was learned since is moved there as a whole: its links to the rest
of the map are wrong. Robots with a laser have their scans for this (relocator.py). Not in the
papers; with ``exp_gate_closures``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.mapping.loop_closure_gate import (
    LONG_KNOWN_M,
    SPOT_SPACING_M,
    long_known_experience,
)

SEEN_M = 1.0
"""Distance from the robot to a place of a view within which the view confirms the pose."""

SEEN, ELSEWHERE, NEW = -3.0, 2.7, 1.0
"""Log-likelihood ratios, carried to not carried, of a spot on known ground with a view of a place
there, with views that are known from elsewhere alone, and with neither. Of a robot at its place on
the map, 94 % of the spots have the first, and 1 % the second; of one that was carried, hardly any
and a quarter. A new view counts less than these shares: it is frequent beside a known path."""

LOST, MOST = 12.0, 15.0
"""Sum above which the pose is unknown, and its limit, after which five known views suffice."""

MOVED_M, FAR_M, FAR_RAD = 60.0, 5.0, 1.0
"""Longest path that is moved, and least displacement or rotation by which it is moved. Smaller
ones may be drift, after which the map is right on both sides."""

AGREEING_COUNT = 2
"""Number of views that must agree on the other place."""


class Carried(Saved):
    """The sum, and where it began to rise."""

    SAVED = (
        Field('sum', 'sum', low=0.0, high=MOST), Field('spot_m', '_spot_m'),
        Field('seen_m', '_seen_m'), Field('since_m', 'since_m'), Field('here', '_is_here', bool),
        Field('elsewhere', '_is_elsewhere', bool), Field('lost', 'is_lost', bool),
    )

    def __init__(self) -> None:
        self.sum = 0.0
        """Sum of the log-likelihood ratios, 0 at least."""
        self.is_lost = False
        """Whether the robot seems to have been carried."""
        self.since_m = 0.0
        """Odometer reading, in m, at the last known view before the sum rose."""
        self._spot_m = self._seen_m = 0.0
        self._is_here = self._is_elsewhere = False

    @property
    def has_spots(self) -> bool:
        """Whether views have been compared."""
        return self._spot_m > 0.0

    def view(
        self, template_ids: NDArray[np.int64], poses: NDArray[np.float64],
        created_m: NDArray[np.float64], odometer_m: float, here: Pose, template_id: int,
    ) -> bool:
        """Take a view into account; return whether ``is_lost`` has changed.

        Args:
            template_ids: (n,) template of each experience.
            poses: (n, 3) x, y in m and heading in rad of the experiences.
            created_m: (n,) odometer reading in m at which each experience was created.
            odometer_m: present odometer reading in m.
            here: pose of the robot on the map.
            template_id: that of the view.
        """
        rows = np.flatnonzero(
            (template_ids == template_id) & (created_m < odometer_m - LONG_KNOWN_M)
        )
        if len(rows):
            away_m = np.hypot(poses[rows, 0] - here.x_m, poses[rows, 1] - here.y_m).min()
            self._is_here |= bool(away_m < SEEN_M)
            self._is_elsewhere |= bool(away_m >= SEEN_M)
        if odometer_m - self._spot_m < SPOT_SPACING_M:
            return False
        if self._is_here or long_known_experience(poses, created_m, odometer_m, here) is not None:
            ratio = SEEN if self._is_here else ELSEWHERE if self._is_elsewhere else NEW
            if self.sum == 0.0:
                self.since_m = self._seen_m
            self.sum = min(max(self.sum + ratio, 0.0), MOST)
        if self._is_here:
            self._seen_m = odometer_m
        self._spot_m, self._is_here, self._is_elsewhere = odometer_m, False, False
        before = self.is_lost
        self.is_lost = self.sum > LOST or (before and self.sum > 0.0)
        return self.is_lost != before

    def may_move(self, odometer_m: float, here: Pose, claimed: Pose) -> bool:
        """Return whether what was learned since ``since_m`` moves if views agree on a place.

        Args:
            odometer_m: present odometer reading in m.
            here, claimed: poses of the robot on the map, and according to a view.
        """
        return self.is_lost and odometer_m - self.since_m <= MOVED_M and (
            math.dist(here[:2], claimed[:2]) > FAR_M
            or abs(math.remainder(claimed.heading_rad - here.heading_rad, math.tau)) > FAR_RAD
        )

    def restart(self) -> None:
        """Begin again: the robot is somewhere else, or nothing compares its views any more."""
        self.sum, self.is_lost = 0.0, False
