# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lengths of the pose cells: the size of a cell, and thresholds of distances between places."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from ratslam_ros.core.common.saved import Saved
from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.config.additions import AUTOMATIC_LENGTHS

DELTA_SPACINGS = 0.5
"""Automatic ``exp_delta_pc_threshold``, in view spacings."""

AGREE_SPACINGS, MAX_AGREE_SPACINGS = 0.75, 4.0
"""Automatic ``pc_vt_agree_spacing`` and largest automatic ``pc_vt_agree_cells``, in view spacings.
The first is below 1, so that neighbouring views count separately although distances vary. The
second is for surroundings in which most recognitions are false."""


class Reach(NamedTuple):
    """A length to compare distances of places with.

    Attributes:
        limit: the length, in heading planes.
        planes_per_cell: number of heading planes that a distance of one cell counts as.
    """

    limit: float
    planes_per_cell: float


class Lengths(Saved):
    """Lengths that the parameters give, in cells; a cell counts as a heading plane."""

    is_automatic = False
    """Whether any length is estimated."""
    are_known = True
    """Whether all lengths have a value; before that, recognised views inject nothing."""
    is_cell_known = True
    """Whether the size of the cells is final."""

    def __init__(self, parameters: PoseCellsParameters) -> None:
        self.parameters = parameters
        self.is_learning = True
        """Whether estimates follow what is seen; they stay while the map is only used."""
        self.cell_m = parameters.pc_cell_x_size
        """Size of a cell in m."""
        self._derive()

    def reconfigure(self, parameters: PoseCellsParameters) -> None:
        """Continue with other explicit lengths."""
        self.parameters = parameters
        self._derive()

    def _derive(self) -> None:
        """Compute the lengths in force."""
        p = self.parameters
        self.delta = Reach(p.exp_delta_pc_threshold, 1.0)
        """Distance at which another experience is created or becomes current."""
        self.agree = Reach(p.pc_vt_agree_cells, 1.0)
        """Largest distance between hypotheses that agree."""
        self.agree_spacing = Reach(p.pc_vt_agree_spacing, 1.0)
        """Smallest motion between two hypotheses that count separately."""
        self.scale_m = p.exp_delta_pc_threshold * self.cell_m / DELTA_SPACINGS
        """View spacing in m; if it is not estimated, the one that ``delta`` would follow from."""

    def report(self) -> dict[str, float]:
        """Return the estimates in m, by name."""
        return {}

    # Measurements

    def integrate(self, distance_m: float) -> None:
        """Add the length of one motion."""

    def interrupt(self) -> None:
        """Discard the distance since the last new view: a motion is unknown."""

    def observe(self, is_new: bool, is_recent: bool, related_count: int = 0) -> float:
        """Measure the distance to the last view of another scene, if all was unknown since then.

        Args:
            is_new: whether the present view was not known before.
            is_recent: whether it is new, or one of the newest templates was recognised.
            related_count: number of newest templates that show the same scene as the view.

        Returns:
            Factor by which all places in cells have to be multiplied, because the size of the
            cells has just been determined; otherwise 1.
        """
        return 1.0

    def add_pairs(self, distances_cells: Iterable[float]) -> None:
        """Add distances between pairs of hypotheses."""


def lengths_of(parameters: PoseCellsParameters) -> Lengths:
    """Return the lengths for the parameters, automatic ones included."""
    return AUTOMATIC_LENGTHS.instead_of(Lengths, parameters)(parameters)
