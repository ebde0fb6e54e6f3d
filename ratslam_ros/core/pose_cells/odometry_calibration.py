# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of turns in an unknown unit, while the robot drives.

Each return to an experience closes a loop. From the loops follows the field of view of the camera
that measures the turns (core/common/rotation_gain.py). Experiences are recognised by several views
that agree, so that few of these loops are false. Wheels and gyros measure turns in a known unit;
their small errors are found by relaxation (core/mapping/relaxation.py).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.rotation_gain import is_small_error, scale_of_turns
from ratslam_ros.core.common.rows import KeyedRows
from ratslam_ros.core.common.saved import MAX_COUNT, Field, Saved, count
from ratslam_ros.core.common.turn_correction import UNCORRECTED, TurnCorrection
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, Extension, MapAction, Viewed

MAX_LOOPS_COUNT = 128
"""Number of loops that are kept for the estimate. When it is reached, every second one is dropped,
and of those that follow twice as many are left out. So they are of the whole run: the latest ones
may all be of one stretch, whose length or false recognitions suit another correction."""

LOOPS_PER_ESTIMATE = 8
"""Number of new loops after which the estimate is renewed. The first loops may suffice earlier."""

LEAST_GAIN, LARGEST_GAIN = 0.6, 4.0
"""Range of the gain of a camera whose field of view is unknown, relative to the configured one: 30
to 200 degrees, if 50 are assumed."""

LEAST_AGREEMENT = 0.5
"""Smallest agreement of recognitions that closes a loop, relative to the required one. It is
measured with the odometry that is to be corrected."""

FACING_RAD = math.radians(20.0)
"""Difference of headings from which the robot does not face the same way at both ends of a loop:
twice the standard deviation of the headings at which a robot passes a place."""

NEWEST_VISITS_COUNT = 10
"""A return to one of the experiences visited last is no loop: the robot is still near them."""


class _Visit(NamedTuple):
    """The last visit of an experience.

    ``turn_rad``: sum of all turns before it, as measured. ``relative_rad``: heading of the robot
    minus heading of the view. ``number``: visits before it.
    """

    turn_rad: float
    relative_rad: float
    number: float


class OdometryCalibration(Extension, Saved):
    """Closed loops of the robot's path, and the correction of turns that they result in."""

    SAVED = (
        Field('correction', 'correction', float, (2,), make=TurnCorrection),
        count('loops', 'loops'),
        Field('turned_rad', '_turned_rad', optional=True),
        Field('visited', '_visits', 'f8', ('', 4), optional=True),
        Field('visit_counts', '_visit_count _loop_count', int, (2,), 0, MAX_COUNT, optional=True),
        Field('loop_turns_rad', '_loop_turns_rad', float, ('',), optional=True),
        Field('scale_known', '_scale_known', bool, optional=True),
    )

    def __init__(self, correction: TurnCorrection) -> None:
        """Start without loops, at the configured correction."""
        self._configured = correction
        self.correction = correction
        """Correction for the odometry after the last view."""
        self.loops = 0
        """Number of loops that the correction explains, 0 before the first estimate."""
        self._turned_rad = 0.0
        self._visits = KeyedRows(1, 4)  # by experience
        self._visit_count = self._loop_count = 0
        self._loop_turns_rad: list[float] = []
        self._scale_known = True
        """Whether the last motion was measured in a known unit."""

    def restart(self) -> None:
        """Forget where the robot was after an unknown motion, through which no loop leads."""
        self._visits.clear()

    def integrate(self, motion: Motion) -> None:
        """Add a motion, whose turn was corrected by ``correction``."""
        self._scale_known = motion.scale_known
        if not self._scale_known:
            self._turned_rad += self.correction.measured(motion.turn_rad, motion.distance_m)

    def extended(self, action: MapAction, view: Viewed) -> MapAction:
        """Return an action with the correction, which is renewed if it is due."""
        if view.is_learning and not self._scale_known:
            self._observe(action, view.is_again)
        return replace(action, correction=self.correction)

    def _observe(self, action: MapAction, is_again: bool) -> None:
        """Record the places that an action leads to and recognises."""
        target_id, recognised_id = action.target_id, action.recognised_id
        if action.action != 'none':
            self.visit(target_id, action.relative_rad, action.action == 'create')
        # Look-alikes rarely agree as often as is required.
        if action.agreement >= LEAST_AGREEMENT and not is_again and (
            recognised_id not in (NO_EXPERIENCE, target_id)
        ):
            self.visit(recognised_id, action.relative_rad, created=False)

    def visit(self, experience_id: int, relative_rad: float, created: bool) -> None:
        """Record that an experience became current, and renew the estimate if it is due."""
        number = self._visit_count
        self._visit_count += 1
        is_known = (experience_id,) in self._visits
        here = _Visit(self._turned_rad, relative_rad, number)
        last = _Visit(*self._visits.get(experience_id)) if is_known else here
        self._visits.put((experience_id,), here)
        apart_rad = abs(wrap(relative_rad - last.relative_rad))
        if created or number - last.number <= NEWEST_VISITS_COUNT or apart_rad >= FACING_RAD:
            return
        if self._loop_count == MAX_LOOPS_COUNT * self._stride:
            del self._loop_turns_rad[1::2]
        self._loop_count += 1
        if (self._loop_count - 1) % self._stride == 0:
            self._loop_turns_rad.append(here.turn_rad - last.turn_rad)
        is_early = self.loops == 0 and self._loop_count <= 2 * LOOPS_PER_ESTIMATE
        if is_early or self._loop_count % LOOPS_PER_ESTIMATE == 0:
            self._estimate()

    @property
    def _stride(self) -> int:
        """One of so many loops is kept: the least power of two for which there is room."""
        return 1 << (max(self._loop_count - 1, 0) // MAX_LOOPS_COUNT).bit_length()

    def _estimate(self) -> None:
        configured = self._configured.gain
        estimate = scale_of_turns(
            np.array(self._loop_turns_rad), LEAST_GAIN * configured, LARGEST_GAIN * configured
        )
        # Small changes only follow the noise of the latest loops, unless there are more now.
        if estimate is None or (
            estimate.loops < 2 * self.loops
            and is_small_error(estimate.gain / self.correction.gain)
        ):
            return
        self.correction = TurnCorrection(estimate.gain)
        self.loops = estimate.loops

    def summary(self, turns: TurnCorrection = UNCORRECTED) -> dict[str, float]:
        """Return the correction and the number of loops, for summary.json and diagnostics.

        Args:
            turns: correction by the map that follows.
        """
        gain, per_m_rad = turns.after(self.correction)
        return {
            'rotation_gain': round(gain, 4),
            'turn_per_m_rad': round(per_m_rad, 5),
            'calibration_loops': self.loops,
        }
