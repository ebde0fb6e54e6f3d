# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Agreement: gate recognitions by their consistency with other recent recognitions.

A single false recognition must not move the activity packet, and several consistent ones must,
for a wide range of injection energies. Each recognised view adds a pose hypothesis, which follows
the odometry like a particle in a particle filter. Hypotheses of correct recognitions therefore
stay together, those of false ones scatter. Views recorded a few centimetres apart have correlated
errors, so hypotheses count separately only if the robot has moved between them.

Hypotheses of another component than the robot's correct nothing before they join the two, so
drift separates them: the odometry of two visits differs, most after its scale was corrected. The
distance at which they agree therefore grows with the square root of the distance driven between
them, as the error of a random walk does, up to a few view spacings.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.rows import Rows
from ratslam_ros.core.common.state import State
from ratslam_ros.core.pose_cells.injection_weights import EqualWeights, Row
from ratslam_ros.core.pose_cells.lengths import AGREE_SPACINGS, MAX_AGREE_SPACINGS, Lengths
from ratslam_ros.core.pose_cells.torus import Place, Torus

MAX_HYPOTHESES_COUNT = 64
"""Maximum number of hypotheses; it bounds the cost of a step if the robot drives slowly."""

WIDEST_SPACINGS = MAX_AGREE_SPACINGS / AGREE_SPACINGS
"""Largest distance at which hypotheses of another component agree, in spacings, unless the radius
is larger: where most recognitions are false, a wider one would let them agree."""

_MADE_AT, _SLOT, _COMPONENT = 3, 5, 6
"""Columns of the table of hypotheses."""

RECENT_COUNT = 8
"""Number of recognised views, a spacing apart, that are kept for counting agreement. With fewer,
correct recognitions among wrong ones are lost; with more, repetitive places agree by chance."""


class Agreement(EqualWeights):
    """Pose hypotheses of the most recently recognised views, and the weights they justify.

    Hypotheses made within one spacing share a slot.
    """

    def __init__(self, torus: Torus, lengths: Lengths, views: float) -> None:
        super().__init__(torus, lengths, views)
        # Hypotheses, oldest first: place now, travelled distance at the recognition, recognised
        # template, slot and component of the place.
        self._made = Rows(7)

    def _rows(self) -> list[Row]:
        return [
            [int(template_id), x, y, theta, made_at, int(slot), *([int(part)] if part else [])]
            for x, y, theta, made_at, template_id, slot, part in self._made.values.tolist()
        ]

    def _restored(self, state: State) -> None:
        self._made.clear()
        for template_id, x, y, theta, made_at, slot, *component in state['claims']:
            self._made.append((x, y, theta, made_at, template_id, slot, *(component or [0])))

    def discard(self, component: int | None = None) -> None:
        """Remove the hypotheses of one component, or all if the motion since then is unknown."""
        self._made.keep(self._made.values[:, _COMPONENT] != (
            self._made.values[:, _COMPONENT] if component is None else component
        ))

    def integrate(
        self, chord_cells: float, turn_planes: float, course_planes: float = 0.0
    ) -> None:
        """Move all hypotheses by one motion of the robot."""
        super().integrate(chord_cells, turn_planes, course_planes)
        _propagate(
            self._made.values, chord_cells, turn_planes, course_planes, self._torus.planes_per_rad
        )

    def weigh(
        self, template_id: int, place: Place, estimate: Place | None, component: int = 0
    ) -> float:
        """Add the hypothesis of a recognised view and compute its weight.

        The weight is ((n - m) / views)^4. n is the number of hypotheses that agree with the new
        one, including itself; m is the number that agree with the current pose estimate, if the
        new hypothesis does not. A view that is recognised repeatedly without another one
        in between makes one hypothesis, at its first recognition. With the power of 4 the number
        of views decides which place wins, not the energy, over energies that differ by a factor
        of 20.

        Args:
            template_id: recognised template.
            place: pose that the recognition implies.
            estimate: current pose estimate; None if it is in another component than the place,
                so that the two cannot contradict each other.
            component: component of the place. Places in different components never agree.

        Returns:
            Factor for the energy to inject.
        """
        latest = self._latest_of(template_id, component)
        if latest is None:
            self._add(template_id, place, component)
            latest = len(self._made) - 1
        hypothesis = Place(*self._made[latest][:3])
        support = self._support(hypothesis, component, drifts=estimate is None)
        radius, scale = self._lengths.agree
        if estimate is not None and self._torus.distance(hypothesis, estimate, scale) > radius:
            support -= self._support(estimate, component)
        share: float = max(support, 0) / self._views
        return share * share * share * share

    def share(self, template_id: int, component: int = 0) -> float:
        """Return how many hypotheses agree with that of the latest view, itself included.

        Unlike in ``weigh``, those that agree with the present estimate do not count against it.

        Args:
            template_id: template of the view.
            component: component of the hypotheses.

        Returns:
            Their share of the required number, at most 1; 0 if the template has no hypothesis.
        """
        latest = self._latest_of(template_id, component)
        if latest is None:
            return 0.0
        support = self._support(Place(*self._made[latest][:3]), component)
        return min(support / self._views, 1.0)

    def _latest_of(self, template_id: int, component: int) -> int | None:
        """Return the latest hypothesis if it is of this template; one view adds several.

        A view adds one hypothesis for each component in which its template has a place.
        """
        for i in range(len(self._made) - 1, -1, -1):
            *_, own_id, _, own_component = self._made[i]
            if own_id != template_id:
                return None
            if own_component == component:
                return i
        return None

    def _add(self, template_id: int, place: Place, component: int) -> None:
        if self._travelled - self._slot_start >= self._lengths.agree_spacing.limit:
            self._slot += 1
            self._slot_start = self._travelled
        made = self._made
        if len(made) == MAX_HYPOTHESES_COUNT:
            made.keep(np.arange(MAX_HYPOTHESES_COUNT) > 0)
        made.append((*place, self._travelled, template_id, self._slot, component))
        if made[0][_SLOT] <= self._slot - RECENT_COUNT:
            made.keep(made.values[:, _SLOT] > self._slot - RECENT_COUNT)
        if self._lengths.is_automatic:
            self._measure_scatter()

    def _measure_scatter(self) -> None:
        """Measure the distances of the newest hypothesis to earlier ones, a spacing apart."""
        # Lists, because single elements of arrays take several times as long to read.
        *rows, last = self._made.values.tolist()
        spacing, last_at = self._lengths.agree_spacing.limit, last[_MADE_AT]
        distances = []
        for row in reversed(rows):
            if row[_COMPONENT] == last[_COMPONENT] and last_at - row[_MADE_AT] >= spacing:
                last_at = row[_MADE_AT]
                x, y = self._torus.displaced((0.0, 0.0), Place(*row[:3]), Place(*last[:3]))
                distances.append(math.hypot(x, y))
        if distances:
            self._lengths.add_pairs(distances)

    def _support(self, place: Place, component: int, drifts: bool = False) -> int:
        """Count the hypotheses that agree on a place and were made at least a spacing apart.

        Args:
            place: the place.
            component: its component.
            drifts: whether hypotheses agree at distances that grow with the distance driven.
        """
        torus, lengths = self._torus, self._lengths
        spacing, widest = lengths.agree_spacing.limit, lengths.agree.limit
        if drifts:
            widest = max(widest, WIDEST_SPACINGS * spacing)
        count = _support(
            self._made.values, (float(place.x), float(place.y), float(place.theta)), component,
            (torus.n_x, torus.n_y, torus.n_theta), *lengths.agree, widest, spacing,
        )
        return int(count)


@compiled
def _propagate(
    made: NDArray[np.float64], chord: float, turn: float, course: float, planes_per_rad: float
) -> None:
    """Move the places along the chord of an arc, in place; theta is not wrapped."""
    for i in range(made.shape[0]):
        direction = (made[i, 2] + 0.5 * turn + course) / planes_per_rad
        made[i, 0] += chord * math.cos(direction)
        made[i, 1] += chord * math.sin(direction)
        made[i, 2] += turn


@compiled
def _support(
    made: NDArray[np.float64], place: tuple[float, float, float], component: int,
    sizes: tuple[int, int, int], radius: float, planes_per_cell: float, widest: float,
    spacing: float,
) -> int:
    """Count the places of a component near a place that were made a spacing apart, newest first.

    The radius grows with the distance driven since a place was made, up to ``widest``.
    """
    found, last_at = 0, math.inf
    for i in range(made.shape[0] - 1, -1, -1):
        made_at = made[i, _MADE_AT]
        if made[i, _COMPONENT] != component or last_at - made_at < spacing:
            continue
        reach, driven = radius, made[-1, _MADE_AT] - made_at
        if driven > spacing > 0.0:
            reach = min(radius * math.sqrt(driven / spacing), widest)
        if _apart(made[i, 0], made[i, 1], made[i, 2], place, sizes, planes_per_cell) <= reach:
            found += 1
            last_at = made_at
    return found


@compiled
def _apart(
    x: float, y: float, theta: float, place: tuple[float, float, float],
    sizes: tuple[int, int, int], planes_per_cell: float,
) -> float:
    """Return the distance of two places, that of ``Torus.distance``."""
    d_x, d_y = abs(x - place[0]) % sizes[0], abs(y - place[1]) % sizes[1]
    d_theta = abs(theta - place[2]) % sizes[2]
    d_x = min(d_x, sizes[0] - d_x) * planes_per_cell
    d_y = min(d_y, sizes[1] - d_y) * planes_per_cell
    d_theta = min(d_theta, sizes[2] - d_theta)
    return math.sqrt(d_x * d_x + d_y * d_y + d_theta * d_theta)
