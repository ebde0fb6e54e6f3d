# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Automatic lengths of the pose cells: estimated while driving, because they depend on the scene.

Two properties of the scene are measured. The view spacing is the distance after which a view of
unknown surroundings is new. The scatter is the distance between pose hypotheses of the same
visit: the error of a recognition, plus the drift of the odometry between two of them. All
automatic lengths are multiples of the two, so a world that is k times as large gives the same
decisions. Not in the papers.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from ratslam_ros.core.common.saved import Field, Saved, count
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import AUTOMATIC, PoseCellsParameters
from ratslam_ros.core.pose_cells.lengths import (
    AGREE_SPACINGS,
    DELTA_SPACINGS,
    MAX_AGREE_SPACINGS,
    Lengths,
    Reach,
)

MIN_GAPS_COUNT = 10
"""Number of distances between new views that give the first estimate of the view spacing. The
newest templates inject nothing, so the estimate exists before the first recognition counts."""

MIN_PAIRS_COUNT = 16
"""Number of distances between hypotheses that give the first estimate of the scatter."""

UNIT_SPACINGS = 2.0 / 3.0
"""Length, in view spacings, that counts as one heading plane when places are compared. It is also
the automatic size of a cell."""

SCATTERS = 2.0
"""Automatic ``pc_vt_agree_cells``, in scatters."""

MIN_AGREE_SPACINGS, FIRST_AGREE_SPACINGS = 1.0, 2.0
"""Lower bound of ``pc_vt_agree_cells`` if it is automatic, and its value before the scatter is
known, in view spacings."""

BINS_PER_OCTAVE = 8
"""Resolution of the histograms: a bin is 9 % wide."""

PROVISIONAL_CELL_M = 1.0
"""Automatic cell size before the view spacing is known. Until then places come from odometry
alone, and the network only turns; afterwards all places are rescaled."""


class LogHistogram(Saved):
    """Weighted histogram of positive values with bins of equal ratio."""

    SAVED = (
        count('count', 'count'), Field('unit', '_unit'),
        Field('bins', '_weights', float, ('', 2), save=lambda weights: sorted(weights.items()),
              load=lambda rows: {int(at): float(weight) for at, weight in rows}),
    )

    def __init__(self) -> None:
        self._unit = 0.0
        self._weights: dict[int, float] = {}
        self.count = 0
        """Number of values."""

    def add(self, value: float, weight: float = 1.0) -> None:
        """Add a value; zero has no bin and is ignored."""
        if value > 0.0 and weight > 0.0:
            self._unit = self._unit or value  # bins relative to a value do not depend on its unit
            at = round(BINS_PER_OCTAVE * math.log2(value / self._unit))
            self._weights[at] = self._weights.get(at, 0.0) + weight
            self.count += 1

    def median(self) -> float:
        """Return the centre of the bin at which half of the weight is reached; 0 if empty."""
        bins = sorted(self._weights)
        half = 0.5 * sum([self._weights[at] for at in bins])
        reached = 0.0
        for at in bins:
            reached += self._weights[at]
            if reached >= half:
                return self._unit * math.exp2(at / BINS_PER_OCTAVE)
        return 0.0


@dataclass
class _Gap:
    """Motion since the newest template was learned.

    ``is_clean``: only the newest templates were seen since then.
    """

    length_m: float = 0.0
    is_clean: bool = False


MAX_GAPS_COUNT = 256
"""Number of latest gaps that are kept, to add them up to the distance to an unrelated template."""


class AutomaticLengths(Lengths):
    """The lengths in force, and the measurements that the automatic ones are derived from."""

    SAVED = (
        Field('cell_m', 'cell_m', low=0.0), Field('spacing_m', 'spacing_m', low=0.0),
        Field('scatter_m', 'scatter_m', low=0.0),
        Field('gap', '_gap', float, (2,), make=_Gap,
              save=lambda gap: (gap.length_m, gap.is_clean)),
        Field('latest', '_latest_m', float, ('',)),
        Field('gaps', '_gaps', LogHistogram), Field('pairs', '_pairs', LogHistogram),
    )

    is_automatic = True

    def __init__(self, parameters: PoseCellsParameters) -> None:
        self.spacing_m = 0.0
        """View spacing in m, 0 before it is known."""
        self.scatter_m = 0.0
        """Scatter of hypotheses in m, 0 before it is known."""
        self._gap = _Gap()
        self._latest_m: deque[float] = deque(maxlen=MAX_GAPS_COUNT)
        self._gaps, self._pairs = LogHistogram(), LogHistogram()
        super().__init__(parameters)
        if parameters.pc_cell_x_size == AUTOMATIC:
            self.cell_m = PROVISIONAL_CELL_M
        self._derive()

    def report(self) -> dict[str, float]:
        """Return the estimates in m, by name."""
        return {
            'view_spacing_m': self.spacing_m, 'scatter_m': self.scatter_m, 'cell_m': self.cell_m
        }

    # Measurements

    def integrate(self, distance_m: float) -> None:
        """Add the length of one motion."""
        if self.is_learning:
            self._gap.length_m += abs(distance_m)

    def interrupt(self) -> None:
        """Discard the distance since the last new view: a motion is unknown."""
        self._gap = _Gap()
        self._latest_m.clear()

    def observe(self, is_new: bool, is_recent: bool, related_count: int = 0) -> float:
        """Measure the distance to the last view of another scene; see ``Lengths``."""
        if not self.is_learning:
            return 1.0
        gap = self._gap
        if not is_new:
            gap.is_clean = gap.is_clean and is_recent
            return 1.0
        if gap.is_clean:
            self._latest_m.append(gap.length_m)
            if related_count < len(self._latest_m):
                spacing_m = sum(list(self._latest_m)[-1 - related_count :])
                # Weighted by length: half of the way is driven in longer gaps.
                self._gaps.add(spacing_m, gap.length_m)
        else:
            self._latest_m.clear()
        self._gap = _Gap(0.0, True)
        if self._gaps.count < MIN_GAPS_COUNT:
            return 1.0
        was_known = self.spacing_m > 0.0
        self.spacing_m, before_m = self._gaps.median(), self.cell_m
        if not was_known and self.parameters.pc_cell_x_size == AUTOMATIC:
            self.cell_m = UNIT_SPACINGS * self.spacing_m
        self._derive()
        return before_m / self.cell_m

    def add_pairs(self, distances_cells: Iterable[float]) -> None:
        """Add distances between pairs of hypotheses."""
        if not self.is_learning:
            return
        for distance_cells in distances_cells:
            self._pairs.add(distance_cells * self.cell_m)
        if self._pairs.count >= MIN_PAIRS_COUNT:
            self.scatter_m = self._pairs.median()
            self._derive()

    # Lengths

    def _derive(self) -> None:
        """Compute the lengths in force from the parameters and estimates."""
        p = self.parameters
        self.are_known = self.spacing_m > 0.0
        self.is_cell_known = self.are_known or p.pc_cell_x_size != AUTOMATIC
        self.scale_m = self.spacing_m
        self.delta = self._reach(p.exp_delta_pc_threshold, DELTA_SPACINGS)
        spacings = FIRST_AGREE_SPACINGS
        if self.scatter_m > 0.0 and self.spacing_m > 0.0:
            spacings = SCATTERS * self.scatter_m / self.spacing_m
            spacings = min(max(spacings, MIN_AGREE_SPACINGS), MAX_AGREE_SPACINGS)
        self.agree = self._reach(p.pc_vt_agree_cells, spacings)
        self.agree_spacing = self._reach(p.pc_vt_agree_spacing, AGREE_SPACINGS)

    def _reach(self, value: float, spacings: float) -> Reach:
        if value != AUTOMATIC:
            return Reach(value, 1.0)
        if self.spacing_m == 0.0:
            return Reach(math.inf, 1.0)
        return Reach(
            spacings / UNIT_SPACINGS, self.cell_m / (UNIT_SPACINGS * self.spacing_m)
        )

    def _restored(self, state: State) -> None:
        if self.parameters.pc_cell_x_size != AUTOMATIC:  # explicit parameters keep their values
            self.cell_m = self.parameters.pc_cell_x_size
        self._derive()
