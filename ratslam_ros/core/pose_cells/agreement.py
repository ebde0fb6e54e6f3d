# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Agreement: what recent views say of where the robot is, and how much to believe one of them.

One wrong recognition must not move the packet, and several that agree must, over a wide range of
injection energies (algorithm.md, Robustness). Every recognised view claims a place; the claim is
carried along with the odometry, so that claims of one visit fall together and chance ones do not.
Views a few centimetres apart err together, so claims only count as several when the robot has
moved between them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.state import State
from ratslam_ros.core.pose_cells.torus import Place, Torus

MOST_CLAIMS = 64
"""However slowly the robot drives, no more are remembered; it bounds the work of a step."""


FEWEST = 2.0
"""Views that must agree on a place close by: odometry alone says that the robot is not far off."""

TURN_WEIGHT = 0.25
"""Way, in cells, that a turn by one plane stands for: a look-alike corner is one place, however
many views it takes to turn there, but a robot that turns on the spot sees different places."""


class Agreement:
    """The claims of the most recently recognised views."""

    def __init__(
        self, torus: Torus, views: float, radius_cells: float, spacing_cells: float, recent: int,
        near_cells: float = 0.0,
    ) -> None:  # fmt: skip
        """Prepare without claims.

        Args:
            torus: where places are.
            views: how many views must agree for a claim to count fully; 0: each always does.
            radius_cells: claims this close agree.
            spacing_cells: way of the robot between claims that count as two.
            recent: how many claims, at least a spacing apart, are remembered.
            near_cells: claims nearer than this to the believed place need fewer views, down to
                FEWEST; 0: as many as any.
        """
        self._torus = torus
        self._views = views
        self._radius = radius_cells
        self._spacing = spacing_cells
        self._recent = recent
        self._near = near_cells
        self._slot = 0
        self._slot_began = 0.0
        self._travelled = 0.0
        # The oldest first: where each claims to be, how far the robot had travelled, and of which
        # view and slot it is.
        self._places = np.empty((MOST_CLAIMS, 3))
        self._made_at = np.empty(MOST_CLAIMS)
        self._template_ids = np.empty(MOST_CLAIMS, np.int64)
        self._slots = np.empty(MOST_CLAIMS, np.int64)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def state(self) -> State:
        """Return all claims, for ``restore``."""
        return {
            'slot': self._slot,
            'slot_began': self._slot_began,
            'travelled': self._travelled,
            'claims': [
                [int(self._template_ids[i]), *self._places[i].tolist(),
                 float(self._made_at[i]), int(self._slots[i])]
                for i in range(self._count)
            ],
        }

    def restore(self, state: State) -> None:
        """Take what ``state`` gave."""
        self._slot = state['slot']
        self._slot_began = state['slot_began']
        self._travelled = state['travelled']
        self._count = 0
        for template_id, x, y, theta, travelled, slot in state['claims']:
            self._append(template_id, Place(x, y, theta), travelled, slot)

    def integrate(self, chord_cells: float, turn_planes: float) -> None:
        """Carry all claims along with one motion of the robot."""
        self._travelled += abs(chord_cells) + TURN_WEIGHT * abs(turn_planes)
        _carry(
            self._places, self._count, chord_cells, turn_planes, self._torus.planes_per_rad
        )

    def weigh(
        self, template_id: int, place: Place, believed: Place, off_cells: float = math.inf
    ) -> float:
        """Take a recognised view's claim; return the factor for the energy that it injects.

        The factor is ((n - m) / views)^4, where n views agree with the claim, itself included,
        and m agree with the believed place instead. A view seen on end claims once, from where
        it was first recognised. The power decides over which range of energies the number of
        views, and not the energy, is what lets a place win: 4 covers a factor of 20.

        ``off_cells``: how far the claimed place is from the believed one in cells that never
        end; what is close by needs fewer views.
        """
        if self._views == 0.0:
            return 1.0
        if self._count == 0 or self._template_ids[self._count - 1] != template_id:
            self._remember(template_id, place)
        claimed = Place(*self._places[self._count - 1].tolist())
        support = self._supporters(claimed)
        if self._torus.distance(claimed, believed) > self._radius:
            support -= self._supporters(believed)
        views = self._views
        if off_cells < self._near:
            views = max(views * off_cells / self._near, min(views, FEWEST))
            support = min(support, int(2 * views))
        share: float = max(support, 0) / views
        return share * share * share * share

    def _remember(self, template_id: int, place: Place) -> None:
        if self._travelled - self._slot_began >= self._spacing:
            self._slot += 1
            self._slot_began = self._travelled
        self._append(template_id, place, self._travelled, self._slot)
        while self._slots[0] <= self._slot - self._recent:
            self._forget_oldest()

    def _append(self, template_id: int, place: Place, travelled: float, slot: int) -> None:
        if self._count == MOST_CLAIMS:
            self._forget_oldest()
        i = self._count
        self._places[i] = place
        self._made_at[i] = travelled
        self._template_ids[i] = template_id
        self._slots[i] = slot
        self._count += 1

    def _forget_oldest(self) -> None:
        for of_claims in (self._places, self._made_at, self._template_ids, self._slots):
            of_claims[: self._count - 1] = of_claims[1 : self._count]
        self._count -= 1

    def _supporters(self, place: Place) -> int:
        """Return how many claims lie near a place, made at least a spacing apart."""
        torus = self._torus
        count = _supporters(
            self._places, self._made_at, self._count, place.x, place.y, place.theta,
            torus.n_x, torus.n_y, torus.n_theta, self._radius, self._spacing,
        )  # fmt: skip
        return int(count)


@compiled
def _carry(
    places: NDArray[np.float64], count: int, chord: float, turn: float, planes_per_rad: float
) -> None:
    """Move places as ``Torus.moved`` does."""
    for i in range(count):
        direction = (places[i, 2] + 0.5 * turn) / planes_per_rad
        places[i, 0] += chord * math.cos(direction)
        places[i, 1] += chord * math.sin(direction)
        places[i, 2] += turn


@compiled
def _supporters(
    places: NDArray[np.float64], made_at: NDArray[np.float64], count: int,
    x: float, y: float, theta: float, n_x: int, n_y: int, n_theta: int,
    radius: float, spacing: float,
) -> int:  # fmt: skip
    """Count claims within a radius, as ``Torus.distance`` has it, made a spacing apart."""
    found = 0
    last = -spacing
    for i in range(count):
        if made_at[i] - last < spacing:
            continue
        d_x = abs(places[i, 0] - x) % n_x
        d_y = abs(places[i, 1] - y) % n_y
        d_theta = abs(places[i, 2] - theta) % n_theta
        d_x = min(d_x, n_x - d_x)
        d_y = min(d_y, n_y - d_y)
        d_theta = min(d_theta, n_theta - d_theta)
        if math.sqrt(d_x * d_x + d_y * d_y + d_theta * d_theta) <= radius:
            found += 1
            last = made_at[i]
    return found
