# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Predict when the next message of a regular stream, such as odometry, comes."""

from __future__ import annotations

import math
from collections import deque

from ratslam_ros.core.common.saved import Field, Saved, count

STEP_COUNT = 20
"""Number of latest steps of a regular stream by which its next stamp is predicted: 0.4 s of
odometry at 50 Hz, so that a stream that has changed its rate is followed within a second."""

MIN_STEP_RATIO = 2 / 3
"""Smallest next step of an irregular stream, relative to the shortest of the latest steps. In a
real recording with jitter (steps of 35 to 350 ms) no step was shorter, and 0.2 % were below 3/4.
"""


class Rhythm(Saved):
    """Prediction of the next stamp of a regular stream from its latest steps.

    A message that comes earlier than predicted is ordered as if its stamp were the predicted one.
    The order is therefore independent of arrival times, although other streams do not wait.

    The prediction is used once successive messages of the last stream had no message of the same
    stamp in the regular stream. Otherwise both have one source, such as odometry from the camera,
    and messages of equal stamps belong together.
    """

    SAVED = (
        Field('reached_ns', 'reached_ns', int, nullable=True), Field('last_ns', '_last_ns', int),
        Field('steps_ns', '_steps_ns', int, ('',)), count('apart_count', '_apart_count'),
    )

    def __init__(self) -> None:
        """Start without steps: nothing is predicted yet."""
        self._apart_count = 0
        self.reached_ns: int | None = None
        """All further messages of the stream are ordered after this stamp."""
        self._last_ns = 0
        self._steps_ns: deque[int] = deque(maxlen=STEP_COUNT)

    @property
    def is_used(self) -> bool:
        """Whether other streams rely on the prediction."""
        return self._apart_count >= STEP_COUNT

    def see(self, is_apart: bool) -> None:
        """Count a released message of the last stream, until the prediction is used."""
        if not self.is_used:
            self._apart_count = self._apart_count + 1 if is_apart else 0

    def place_ns(self, stamp_ns: int) -> int:
        """Return the stamp by which the next message of the stream is ordered."""
        place_ns = stamp_ns
        if self.reached_ns is not None:
            place_ns = max(stamp_ns, self.reached_ns + 1)
            self._steps_ns.append(stamp_ns - self._last_ns)
        self._last_ns = stamp_ns
        self.reached_ns = place_ns
        if len(self._steps_ns) == STEP_COUNT:
            self.reached_ns = max(place_ns, stamp_ns + self._least_step_ns() - 1)
        return place_ns

    def _least_step_ns(self) -> int:
        """Return a step that the next one is not expected to be shorter than.

        The steps of a precise clock differ by little: the next one may be shorter than the
        shortest by as much as they differ. A message that comes exactly then keeps its stamp.
        """
        shortest, longest = min(self._steps_ns), max(self._steps_ns)
        return max(math.ceil(MIN_STEP_RATIO * shortest), 2 * shortest - longest)
