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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.saved import MAX_ID, Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.pose_cells.lengths import AGREE_SPACINGS, MAX_AGREE_SPACINGS, Lengths
from ratslam_ros.core.pose_cells.torus import Place, Torus

MAX_HYPOTHESES_COUNT = 64
"""Maximum number of hypotheses; it bounds the cost of a step if the robot drives slowly."""

TURN_WEIGHT_CELLS_PER_PLANE = 0.25
"""Travelled distance that a turn by one heading plane counts as. The weight is low because many
views while turning in one ambiguous corner are not independent, and not zero because a robot that
turns on the spot does see different parts of its surroundings."""

WIDEST_SPACINGS = MAX_AGREE_SPACINGS / AGREE_SPACINGS
"""Largest distance at which hypotheses of another component agree, in spacings, unless the radius
is larger: where most recognitions are false, a wider one would let them agree."""

RECENT_COUNT = 8
"""Number of recognised views, a spacing apart, that are kept for counting agreement. With fewer,
correct recognitions among wrong ones are lost; with more, repetitive places agree by chance."""


class Agreement(Saved):
    """Pose hypotheses of the most recently recognised views, and the weights they justify."""

    SAVED = (
        Field('slot', '_slot', int, (), -1, MAX_ID), Field('slot_began', '_slot_start'),
        Field('travelled', '_travelled'),
        # Template, place, travelled distance, slot, and component, which is left out if it is 0.
        Field('claims', '', list, save=lambda agreement: agreement._rows(), fits=(
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
        # Hypotheses made within one spacing share a slot.
        self._slot = 0
        self._slot_start = 0.0
        self._travelled = 0.0
        # Arrays of the hypotheses, oldest first: place now, travelled distance at the recognition,
        # recognised template, slot and component of the place.
        self._places = np.empty((MAX_HYPOTHESES_COUNT, 3))
        self._made_at = np.empty(MAX_HYPOTHESES_COUNT)
        self._template_ids = np.empty(MAX_HYPOTHESES_COUNT, np.int64)
        self._slots = np.empty(MAX_HYPOTHESES_COUNT, np.int64)
        self._components = np.empty(MAX_HYPOTHESES_COUNT, np.int64)
        self._count = 0

    def reconfigure(self, views: float) -> None:
        """Continue with another number of views; see the constructor."""
        self._views = views

    def _rows(self) -> list[list[float]]:
        return [
            [int(self._template_ids[i]), *self._places[i].tolist(), float(self._made_at[i]),
             int(self._slots[i]), *([int(self._components[i])] if self._components[i] else [])]
            for i in range(self._count)
        ]

    def _restored(self, state: State) -> None:
        self._count = 0
        for template_id, x, y, theta, travelled, slot, *component in state['claims']:
            self._append(template_id, Place(x, y, theta), travelled, slot, *component)

    def discard(self, component: int | None = None) -> None:
        """Remove the hypotheses of one component, or all if the motion since then is unknown."""
        kept = np.zeros(0, np.int64)
        if component is not None:
            kept = np.flatnonzero(self._components[: self._count] != component)
        for column in self._columns:
            column[: len(kept)] = column[kept]
        self._count = len(kept)

    def integrate(
        self, chord_cells: float, turn_planes: float, course_planes: float = 0.0
    ) -> None:
        """Move all hypotheses by one motion of the robot."""
        cells = abs(chord_cells) * self._lengths.agree_spacing.planes_per_cell
        self._travelled += cells + TURN_WEIGHT_CELLS_PER_PLANE * abs(turn_planes)
        _propagate(
            self._places, self._count, chord_cells, turn_planes, course_planes,
            self._torus.planes_per_rad,
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
        if self._views == 0.0:
            return 1.0
        latest = self._latest_of(template_id, component)
        if latest is None:
            self._add(template_id, place, component)
            latest = self._count - 1
        hypothesis = Place(*self._places[latest].tolist())
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
        if self._views == 0.0:
            return 1.0
        latest = self._latest_of(template_id, component)
        if latest is None:
            return 0.0
        support = self._support(Place(*self._places[latest].tolist()), component)
        return min(support / self._views, 1.0)

    def _latest_of(self, template_id: int, component: int) -> int | None:
        """Return the latest hypothesis if it is of this template; one view adds several.

        A view adds one hypothesis for each component in which its template has a place.
        """
        for i in range(self._count - 1, -1, -1):
            if self._template_ids[i] != template_id:
                return None
            if self._components[i] == component:
                return i
        return None

    def _add(self, template_id: int, place: Place, component: int) -> None:
        if self._travelled - self._slot_start >= self._lengths.agree_spacing.limit:
            self._slot += 1
            self._slot_start = self._travelled
        self._append(template_id, place, self._travelled, self._slot, component)
        while self._slots[0] <= self._slot - RECENT_COUNT:
            self._remove_oldest()
        if self._lengths.is_automatic:
            self._measure_scatter()

    def _measure_scatter(self) -> None:
        """Measure the distances of the newest hypothesis to earlier ones, a spacing apart."""
        count = self._count
        # Lists, because single elements of arrays take several times as long to read.
        places, made_at = self._places[:count].tolist(), self._made_at[:count].tolist()
        components = self._components[:count].tolist()
        spacing, component = self._lengths.agree_spacing.limit, components[-1]
        newest, last_at = Place(*places[-1]), made_at[-1]
        distances = []
        for i in range(count - 2, -1, -1):
            if components[i] == component and last_at - made_at[i] >= spacing:
                last_at = made_at[i]
                x, y = self._torus.displaced((0.0, 0.0), Place(*places[i]), newest)
                distances.append(math.hypot(x, y))
        if distances:
            self._lengths.add_pairs(distances)

    def _append(
        self, template_id: int, place: Place, travelled: float, slot: int, component: int = 0
    ) -> None:
        if self._count == MAX_HYPOTHESES_COUNT:
            self._remove_oldest()
        i = self._count
        self._places[i] = place
        self._made_at[i] = travelled
        self._template_ids[i] = template_id
        self._slots[i] = slot
        self._components[i] = component
        self._count += 1

    def _remove_oldest(self) -> None:
        for column in self._columns:
            column[: self._count - 1] = column[1 : self._count]
        self._count -= 1

    @property
    def _columns(self) -> tuple[NDArray[Any], ...]:
        return self._places, self._made_at, self._template_ids, self._slots, self._components

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
            self._places, self._made_at, self._components, self._count,
            (float(place.x), float(place.y), float(place.theta)), component,
            (torus.n_x, torus.n_y, torus.n_theta), *lengths.agree, widest, spacing,
        )
        return int(count)


@compiled
def _propagate(
    places: NDArray[np.float64], count: int, chord: float, turn: float, course: float,
    planes_per_rad: float,
) -> None:
    """Move the first ``count`` places along the chord of an arc, in place; theta not wrapped."""
    for i in range(count):
        direction = (places[i, 2] + 0.5 * turn + course) / planes_per_rad
        places[i, 0] += chord * math.cos(direction)
        places[i, 1] += chord * math.sin(direction)
        places[i, 2] += turn


@compiled
def _support(
    places: NDArray[np.float64], made_at: NDArray[np.float64], components: NDArray[np.int64],
    count: int, place: tuple[float, float, float], component: int, sizes: tuple[int, int, int],
    radius: float, planes_per_cell: float, widest: float, spacing: float,
) -> int:
    """Count the places of a component near a place that were made a spacing apart, newest first.

    The radius grows with the distance driven since a place was made, up to ``widest``.
    """
    found, last_at = 0, math.inf
    for i in range(count - 1, -1, -1):
        if components[i] != component or last_at - made_at[i] < spacing:
            continue
        reach, driven = radius, made_at[count - 1] - made_at[i]
        if driven > spacing > 0.0:
            reach = min(radius * math.sqrt(driven / spacing), widest)
        x, y, theta = places[i]
        if _apart(x, y, theta, place, sizes, planes_per_cell) <= reach:
            found += 1
            last_at = made_at[i]
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
