# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Weights of the energies that recognised views inject: all are equal, as in the papers."""

from __future__ import annotations

from ratslam_ros.core.common.saved import MAX_ID, Field, Saved
from ratslam_ros.core.pose_cells.lengths import Lengths
from ratslam_ros.core.pose_cells.torus import Place, Torus

TURN_WEIGHT_CELLS_PER_PLANE = 0.25
"""Travelled distance that a turn by one heading plane counts as. The weight is low because many
views while turning in one ambiguous corner are not independent, and not zero because a robot that
turns on the spot does see different parts of its surroundings."""

Row = list[float]
"""Template, place, travelled distance, slot and, unless it is 0, component of a hypothesis."""


class EqualWeights(Saved):
    """Weights of recognitions: 1. ``Agreement`` makes them depend on other recognitions."""

    SAVED = (
        Field('slot', '_slot', int, (), -1, MAX_ID), Field('slot_began', '_slot_start'),
        Field('travelled', '_travelled'),
        Field('claims', '', list, save=lambda own: own._rows(), fits=(
            'rows of 6 or 7 numbers',
            lambda rows, _: all(
                6 <= len(row) <= 7 and max(map(abs, row)) <= MAX_ID for row in rows
            ),
        )),
    )

    def __init__(self, torus: Torus, lengths: Lengths, views: float) -> None:
        """Start without hypotheses.

        Args:
            torus: extents of the pose cells.
            lengths: ``agree``: maximum distance between hypotheses that agree. ``agree_spacing``:
                minimum travelled distance between hypotheses that count separately. Distances
                between hypotheses are added to its measurements.
            views: number of agreeing views at which the weight is 1; 0 makes every weight 1.
        """
        self._torus = torus
        self._lengths = lengths
        self._views = views
        self._slot = 0
        self._slot_start = self._travelled = 0.0

    def integrate(
        self, chord_cells: float, turn_planes: float, course_planes: float = 0.0
    ) -> None:
        """Add one motion of the robot to the travelled distance."""
        cells = abs(chord_cells) * self._lengths.agree_spacing.planes_per_cell
        self._travelled += cells + TURN_WEIGHT_CELLS_PER_PLANE * abs(turn_planes)

    def weigh(
        self, template_id: int, place: Place, estimate: Place | None, component: int = 0
    ) -> float:
        """Return the factor for the energy of a recognised view."""
        return 1.0

    def share(self, template_id: int, component: int = 0) -> float:
        """Return the share of the required recognitions that agree with the latest view."""
        return 1.0

    def discard(self, component: int | None = None) -> None:
        """Remove the hypotheses of one component; None: of all."""

    def _rows(self) -> list[Row]:
        return []
