# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Similarity of views of different places, known to be different by odometry.

An environment may contain places that look alike, such as offices with the same furniture. Images
alone cannot show this: a view that matches an old one is a revisit or a look-alike. Over a path
that leads away from its start, odometry can: its errors are small compared to the displacement.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.state import State
from ratslam_ros.core.vision.encoder import Layout, View
from ratslam_ros.core.vision.match_threshold import RELATED_RATIO
from ratslam_ros.core.vision.template_memory import Search, TemplateMemory

SAMPLE_PERIOD_S = 0.2
"""Shortest time between two views that are compared, at first."""

MAX_VIEW_COUNT = 900
"""Number of compared views. When it is reached, every second one is dropped, and the period is
doubled, so that the views are evenly spaced in time."""

MIN_VIEW_COUNT = 100
"""With fewer views that have unrelated ones, no look-alikes can be measured."""

SETTLED_VIEW_COUNT = 300
"""Number of views, a minute of driving, before the estimate is used while driving. The rarest
look-alikes decide: in the first rooms of an office, few views have any."""

START_RATIO = 0.15
"""Difference up to which views match until then: only nearly the same view. Later templates could
make up for recognitions that are missed at first, but not for false ones."""

DIRECTNESS = 0.5
"""Smallest ratio of displacement to path at which odometry shows that two places differ. A return
to the same place would need an odometry error of half the path."""

UNRELATED_LAGS = 3.0
"""Smallest displacement between unrelated views, in distances after which the view has changed."""

LOOK_ALIKE_RATE = 0.02
"""Share of the views that may match one of an unrelated place."""

_SAMPLES_PER_VIEW = 8
_MAX_SAMPLE_COUNT = 1024
"""Differences to earlier views, any of them, whose median is that between unrelated views."""


class _Sample(NamedTuple):
    """A compared view: where it was seen, and what it resembles.

    part: number of odometry gaps before. changed_m: distance driven since the latest view that is
    unrelated. nearest: smallest difference to a view of another place, relative to the median
    between unrelated views. Both are NaN if there is no such view.
    """

    x_m: float
    y_m: float
    path_m: float
    part: float
    changed_m: float
    nearest: float


class LookAlikes:
    """Estimate of how similar views of different places can be, while driving."""

    def __init__(self, layout: Layout) -> None:
        """Prepare the estimate for views of a layout."""
        self._layout = layout
        self._memory = TemplateMemory(layout)
        self._samples: list[_Sample] = []
        self._differences: list[int] = []
        self._pose = Pose(0.0, 0.0, 0.0)
        self._path_m, self._part, self._time_s = 0.0, 0, 0.0
        self._period_s, self._due_s = SAMPLE_PERIOD_S, 0.0
        self._ratio: float | None = None

    @property
    def view_count(self) -> int:
        """Number of compared views."""
        return len(self._samples)

    @property
    def is_due(self) -> bool:
        """Whether the next view will be compared: the robot has moved, and time has passed."""
        has_moved = self._path_m > (self._samples[-1].path_m if self._samples else 0.0)
        return has_moved and self._time_s >= self._due_s

    @property
    def ratio(self) -> float | None:
        """Difference that few views fall below to a view of another place.

        It is relative to the median between unrelated views. None if too few views were seen of
        places that odometry shows to be different.
        """
        return self._ratio

    @property
    def match_ratio(self) -> float:
        """Largest difference of a match, relative to the median between unrelated views."""
        if 0 < len(self._samples) < SETTLED_VIEW_COUNT:
            return START_RATIO
        return RELATED_RATIO if self._ratio is None else min(self._ratio, RELATED_RATIO)

    def move(self, motion: Motion) -> None:
        """Follow the robot."""
        self._time_s += motion.dt_s
        self._pose = moved(self._pose, motion)
        self._path_m += abs(motion.distance_m)
        self._part += not motion.is_known

    def relocated(self) -> None:
        """Continue after the robot may have been moved unobserved."""
        self._part += 1

    def see(self, view: View) -> None:
        """Compare a view with the earlier ones, if it is due and the robot has moved."""
        if not self.is_due:
            return
        self._due_s = self._time_s + self._period_s
        search = self._memory.search(view)
        changed_m, nearest = math.nan, math.nan
        if self._samples:
            median = self._median(search)
            table = np.array(self._samples, np.float64)
            changed_m = self._changed_m(search, median, table)
            nearest = self._nearest(search, median, table)
        self._memory.append(view)
        x_m, y_m, _ = self._pose
        self._samples.append(
            _Sample(x_m, y_m, self._path_m, float(self._part), changed_m, nearest)
        )
        if len(self._samples) >= MAX_VIEW_COUNT:
            self._thin()
        self._estimate()

    def state(self) -> State:
        """Return the estimate and what it is based on, for ``restore``."""
        return {
            'views': self._memory.views(),
            'samples': np.array(self._samples, np.float64).reshape(-1, len(_Sample._fields)),
            'differences': np.array(self._differences, np.int64),
            'now': np.array(
                [*self._pose, self._path_m, self._part, self._time_s, self._period_s, self._due_s]
            ),
        }

    def restore(self, state: State) -> None:
        """Restore what ``state`` returned; the robot may have been carried since."""
        self._memory = TemplateMemory(self._layout)
        for view in state['views']:
            self._memory.append(view)
        self._samples = [_Sample(*map(float, row)) for row in state['samples']]
        self._differences = [int(value) for value in state['differences']]
        x_m, y_m, heading_rad, path_m, part, time_s, period_s, due_s = map(float, state['now'])
        self._pose, self._path_m, self._part = Pose(x_m, y_m, heading_rad), path_m, int(part)
        self._time_s, self._period_s, self._due_s = time_s, period_s, due_s
        self._estimate()
        self.relocated()

    def _median(self, search: Search) -> float:
        """Sample differences to earlier views, few of which are related; return the median."""
        count = len(self._samples)
        number = min(_SAMPLES_PER_VIEW, count)
        self._differences += [search.sad(k * count // number) for k in range(number)]
        del self._differences[:-_MAX_SAMPLE_COUNT]
        return float(sorted(self._differences)[len(self._differences) // 2])

    def _changed_m(self, search: Search, median: float, table: NDArray[np.float64]) -> float:
        for earlier in range(len(table) - 1, -1, -1):
            if search.sad(earlier) > RELATED_RATIO * median:
                return float(self._path_m - table[earlier, 2])
        return math.nan

    def _nearest(self, search: Search, median: float, table: NDArray[np.float64]) -> float:
        lags_m = table[np.isfinite(table[:, 4]), 4]
        if not len(lags_m) or median <= 0.0:
            return math.nan
        lag_m = float(np.median(lags_m))
        x_m, y_m, path_m, part = table[:, :4].T
        dx_m, dy_m = x_m - self._pose.x_m, y_m - self._pose.y_m
        least_m = np.maximum(DIRECTNESS * (self._path_m - path_m), UNRELATED_LAGS * lag_m)
        apart = (dx_m * dx_m + dy_m * dy_m > least_m * least_m) & (part == self._part)
        nearest = search.nearest(apart)
        return math.nan if nearest is None else nearest / median

    def _thin(self) -> None:
        memory = TemplateMemory(self._layout)
        for kept in range(0, len(self._samples), 2):
            memory.append(self._memory.view(kept))
        self._memory, self._samples = memory, self._samples[::2]
        self._period_s *= 2.0

    def _estimate(self) -> None:
        found = sorted(s.nearest for s in self._samples if math.isfinite(s.nearest))
        if len(found) < MIN_VIEW_COUNT:
            self._ratio = None
        else:
            self._ratio = found[int(LOOK_ALIKE_RATE * len(found))]
