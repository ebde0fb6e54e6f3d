# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Similarity of views of different places, known to be different by odometry.

An environment may contain places that look alike, such as offices with the same furniture. Images
alone cannot show this: a view that matches an old one is a revisit or a look-alike. Over a path
that leads away from its start, odometry can: its errors are small compared to the displacement.
Systematic errors of turns are not, over a lap. Two places are known to differ only if the path
leads away from its start whatever error of wheels or a gyro the turns have.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.rotation_gain import SMALL_ERROR_RATIO
from ratslam_ros.core.common.rows import KeyedRows
from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.vision.encoder import Layout, View
from ratslam_ros.core.vision.match_threshold import RELATED_RATIO
from ratslam_ros.core.vision.template_memory import Search, TemplateMemory

SAMPLE_PERIOD_S = 0.2
"""Shortest time between two views that are compared, at first."""

MAX_VIEW_COUNT = 900
"""Number of compared views. When it is reached, every second one is dropped, and the period is
doubled, so that the views are evenly spaced in time."""

DIRECTNESS = 0.4
"""Smallest ratio of displacement to path at which odometry shows that two places differ. A return
to the same place would need an odometry error of this share of the path."""

UNRELATED_LAGS = 3.0
"""Smallest displacement between unrelated views, in distances after which the view has changed."""

LOOK_ALIKE_RATE = 0.02
"""Share of the views that may match one of an unrelated place, if places look alike."""

TURN_GAINS = 1.0, 1.0 / SMALL_ERROR_RATIO, SMALL_ERROR_RATIO
"""Gains of the turns with which the path is followed: as measured, and the largest errors."""

ODOMETRY_ERROR_RATE, CERTAIN_SD = 0.1, 2.0
"""Places look alike if more than this share of the views are related to one of another place, by
so many standard deviations of their number; one is added to its variance for few views. If fewer
are, the odometry is wrong for them. In the demo, where offices have the same furniture, the share
is 0.2 to 0.3. On real recordings it is at most 0.09 after the first views, also if turns are 20 %
wrong."""

_SAMPLES_PER_VIEW, _MAX_SAMPLE_COUNT = 8, 1024
"""Differences to earlier views whose median is that between unrelated views, as few are related:
number for each view, and number of latest ones that are kept."""


_CHANGED_M, _NEAREST, _BENT = 4, 5, slice(6, 10)
_PLACE = [0, 1, 2, 3, 6, 7, 8, 9]
"""Columns of the table of compared views. The place is the position by odometry, the distance
driven before, the number of odometry gaps before, and the positions with the other gains of turns.
The others are the distance driven since the latest view that is unrelated, and the smallest
difference to a view of another place, relative to the median between unrelated views; they are NaN
if there is no such view."""


class LookAlikes(Saved):
    """Estimate of how similar views of different places can be, while driving."""

    SAVED = (
        Field('views', '', 'u1', ('views', '', ''), save=lambda own: own._memory.views(),
              is_fixed=True),
        Field('samples', '', 'f8', ('views', _NEAREST + 1), -math.inf,
              save=lambda own: own._table[: own._count, : _NEAREST + 1]),
        Field('differences', '_differences', 'i8', ('',), 0),
        Field('template_ids', '', 'i8', ('places',), 0, save=lambda own: own._places.values[:, 0]),
        Field('templates', '', 'f8', ('places', 4), save=lambda own: own._places.values[:, 1:5]),
        Field('now', '', 'f8', (8,), save=lambda own: (
            *own._poses[0], own._path_m, own._part, own._time_s, own._period_s, own._due_s
        )),
        Field('seen_at_m', '_seen_at_m', optional=True),
        Field('bent/samples', '', 'f8', ('views', 4), optional=True,
              save=lambda own: own._table[: own._count, _BENT]),
        Field('bent/templates', '', 'f8', ('places', 4), optional=True,
              save=lambda own: own._places.values[:, 5:]),
        Field('bent/now', '', 'f8', (2, 3), optional=True, save=lambda own: own._poses[1:]),
    )

    def __init__(self, layout: Layout) -> None:
        """Prepare the estimate for views of a layout."""
        self._layout = layout
        self._memory = TemplateMemory(layout)
        self._table = np.empty((MAX_VIEW_COUNT, _BENT.stop))
        self._count = 0
        self._differences = np.empty(0, np.int64)
        self._places = KeyedRows(1, 9)  # by template
        self._poses = [Pose(0.0, 0.0, 0.0) for _ in TURN_GAINS]
        self._path_m, self._part, self._time_s = 0.0, 0, 0.0
        self._seen_at_m = 0.0
        self._period_s, self._due_s = SAMPLE_PERIOD_S, 0.0
        self._lag_m = math.inf
        self.ratio = RELATED_RATIO
        """Difference that few views fall below to a view of another place, relative to the median
        between unrelated views; that of related views if no places look alike."""
        self.evidence_count = 0
        """Number of views for which there are views of places known to be different."""

    @property
    def exist(self) -> bool:
        """Whether places are known to look alike."""
        return self.ratio < RELATED_RATIO

    @property
    def is_due(self) -> bool:
        """Whether the next view will be compared: the robot has moved, and time has passed."""
        return self._path_m > self._seen_at_m and self._time_s >= self._due_s

    def move(self, motion: Motion) -> None:
        """Follow the robot."""
        self._time_s += motion.dt_s
        self._poses = [
            moved(pose, replace(motion, turn_rad=gain * motion.turn_rad))
            for pose, gain in zip(self._poses, TURN_GAINS, strict=True)
        ]
        self._path_m += abs(motion.distance_m)
        self._part += not motion.is_known

    def relocated(self) -> None:
        """Continue after the robot may have been moved unobserved."""
        self._part += 1

    def see(self, view: View) -> None:
        """Compare a view with the earlier ones, if it is due."""
        if not self.is_due:
            return
        self._due_s = self._time_s + self._period_s
        self._seen_at_m = self._path_m
        changed_m, nearest = math.nan, math.nan
        if self._count:
            search = self._memory.search(view)
            median = self._median(search)
            changed_m = self._changed_m(search, median)
            nearest = self._nearest(search, median)
        self._memory.append(view)
        row = self._table[self._count]
        row[_PLACE] = self._place
        row[[_CHANGED_M, _NEAREST]] = changed_m, nearest
        self._count += 1
        if self._count == MAX_VIEW_COUNT:
            self._thin()
        self._estimate()

    def learned(self, template_id: int) -> None:
        """Remember where a template is learned."""
        self._places.put((template_id,), self._place)

    def forget(self, template_id: int) -> None:
        """Forget where a template was learned."""
        if (template_id,) in self._places:
            self._places.drop(template_id)

    def contradicts(self, template_id: int) -> bool:
        """Return whether odometry shows that the robot is not where a template was learned."""
        return (template_id,) in self._places and bool(
            self._are_apart(self._places.get(template_id))
        )

    def _restored(self, state: State) -> None:
        views = state['views']
        self._memory.restore(views, np.arange(len(views)), len(views))
        samples, places = state['samples'], state['templates']
        x_m, y_m, heading_rad, path_m, part, time_s, period_s, due_s = map(float, state['now'])
        pose, self._path_m, self._part = Pose(x_m, y_m, heading_rad), path_m, int(part)
        bent = state.get('bent') or {  # merged, or of an earlier version
            'samples': np.tile(samples[:, :2], 2), 'templates': np.tile(places[:, :2], 2),
            'now': [pose, pose],
        }
        self._count = len(samples)
        self._table[: self._count] = np.hstack([samples, bent['samples']])
        self._places.replace(np.column_stack([state['template_ids'], places, bent['templates']]))
        self._poses = [pose, *(Pose(*map(float, one)) for one in bent['now'])]
        self._time_s, self._period_s, self._due_s = time_s, period_s, due_s
        self._estimate()
        if 'seen_at_m' not in state:  # merged
            self._seen_at_m = float(self._table[self._count - 1, 2]) if self._count else 0.0
            self.relocated()

    @property
    def _place(self) -> tuple[float, ...]:
        straight, *bent = ((x_m, y_m) for x_m, y_m, _ in self._poses)
        return *straight, self._path_m, float(self._part), *bent[0], *bent[1]

    def _are_apart(self, places: Iterable[Any]) -> Any:
        """Return whether odometry shows that the robot is not at a place.

        Args:
            places: the values of a place, or of (n,) places, in the order of ``_place``.
        """
        x_m, y_m, path_m, part, *bent = places
        away_m2 = np.minimum.reduce([
            (x_m - pose.x_m) ** 2 + (y_m - pose.y_m) ** 2 for pose, x_m, y_m in zip(
                self._poses, (x_m, *bent[::2]), (y_m, *bent[1::2]), strict=True
            )
        ])
        driven_m = self._path_m - path_m
        least_m = np.maximum(DIRECTNESS * driven_m, UNRELATED_LAGS * self._lag_m)
        return (away_m2 > least_m * least_m) & (part == self._part)

    def _median(self, search: Search) -> float:
        number = min(_SAMPLES_PER_VIEW, self._count)
        sads = search.sads([k * self._count // number for k in range(number)])
        self._differences = np.append(self._differences, sads)[-_MAX_SAMPLE_COUNT:]
        middle = len(self._differences) // 2
        return float(np.partition(self._differences, middle)[middle])

    def _changed_m(self, search: Search, median: float) -> float:
        for earlier in range(self._count - 1, -1, -1):
            if search.sad(earlier) > RELATED_RATIO * median:
                return self._path_m - float(self._table[earlier, 2])
        return math.nan

    def _nearest(self, search: Search, median: float) -> float:
        apart = np.flatnonzero(self._are_apart(self._table[: self._count, _PLACE].T))
        return search.sads(apart).min() / median if len(apart) and median > 0.0 else math.nan

    def _thin(self) -> None:
        memory = TemplateMemory(self._layout)
        for kept in range(0, self._count, 2):
            memory.append(self._memory.view(kept))
        rows = self._table[: self._count : 2].copy()
        self._memory, self._count = memory, len(rows)
        self._table[: self._count] = rows
        self._period_s *= 2.0

    def _estimate(self) -> None:
        lags_m = _sorted(self._table[: self._count, _CHANGED_M])
        if len(lags_m):
            self._lag_m = float(lags_m[len(lags_m) // 2])
        nearest = _sorted(self._table[: self._count, _NEAREST])
        self.evidence_count = len(nearest)
        if len(nearest):
            related, wrong = nearest < RELATED_RATIO, ODOMETRY_ERROR_RATE * len(nearest)
            exist = related.sum() > wrong + CERTAIN_SD * math.sqrt(wrong + 1.0)
            rare = nearest[int(LOOK_ALIKE_RATE * len(nearest))]
            self.ratio = float(rare) if exist else RELATED_RATIO


def _sorted(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values that are not NaN, in order."""
    ordered: NDArray[np.float64] = np.sort(values[~np.isnan(values)])
    return ordered
