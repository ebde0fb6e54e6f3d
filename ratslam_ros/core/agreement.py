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

from collections import deque
from dataclasses import dataclass

from ratslam_ros.core.state import State
from ratslam_ros.core.torus import Place, Torus

MOST_CLAIMS = 64
"""However slowly the robot drives, no more are remembered; it bounds the work of a step."""


TURN_WEIGHT = 0.25
"""Way, in cells, that a turn by one plane stands for: a look-alike corner is one place, however
many views it takes to turn there, but a robot that turns on the spot sees different places."""


@dataclass(slots=True)
class _Claim:
    template_id: int
    place: Place
    travelled: float
    slot: int


class Agreement:
    """The claims of the most recently recognised views."""

    def __init__(
        self, torus: Torus, views: float, radius_cells: float, spacing_cells: float, recent: int
    ) -> None:
        """Prepare without claims.

        Args:
            torus: where places are.
            views: how many views must agree for a claim to count fully; 0: each always does.
            radius_cells: claims this close agree.
            spacing_cells: way of the robot between claims that count as two.
            recent: how many claims, at least a spacing apart, are remembered.
        """
        self._torus = torus
        self._views = views
        self._radius = radius_cells
        self._spacing = spacing_cells
        self._recent = recent
        self._slot = 0
        self._slot_began = 0.0
        self._travelled = 0.0
        self._claims: deque[_Claim] = deque(maxlen=MOST_CLAIMS)

    def state(self) -> State:
        """Return all claims, for ``restore``."""
        return {
            'slot': self._slot,
            'slot_began': self._slot_began,
            'travelled': self._travelled,
            'claims': [[c.template_id, *c.place, c.travelled, c.slot] for c in self._claims],
        }

    def restore(self, state: State) -> None:
        """Take what ``state`` gave."""
        self._slot = state['slot']
        self._slot_began = state['slot_began']
        self._travelled = state['travelled']
        self._claims.clear()
        for template_id, x, y, theta, travelled, slot in state['claims']:
            self._claims.append(_Claim(template_id, Place(x, y, theta), travelled, slot))

    def integrate(self, chord_cells: float, turn_planes: float) -> None:
        """Carry all claims along with one motion of the robot."""
        self._travelled += abs(chord_cells) + TURN_WEIGHT * abs(turn_planes)
        for claim in self._claims:
            claim.place = self._torus.moved(claim.place, chord_cells, turn_planes)

    def weigh(self, template_id: int, place: Place, believed: Place) -> float:
        """Take a recognised view's claim; return the factor for the energy that it injects.

        The factor is ((n - m) / views)^4, where n views agree with the claim, itself included,
        and m agree with the believed place instead. A view seen on end claims once, from where
        it was first recognised. The power decides over which range of energies the number of
        views, and not the energy, is what lets a place win: 4 covers a factor of 20.
        """
        if self._views == 0.0:
            return 1.0
        if not self._claims or self._claims[-1].template_id != template_id:
            self._remember(template_id, place)
        claimed = self._claims[-1].place
        support = self._supporters(claimed)
        if self._torus.distance(claimed, believed) > self._radius:
            support -= self._supporters(believed)
        share: float = max(support, 0) / self._views
        return share * share * share * share

    def _remember(self, template_id: int, place: Place) -> None:
        if self._travelled - self._slot_began >= self._spacing:
            self._slot += 1
            self._slot_began = self._travelled
        self._claims.append(_Claim(template_id, place, self._travelled, self._slot))
        while self._claims[0].slot <= self._slot - self._recent:
            self._claims.popleft()

    def _supporters(self, place: Place) -> int:
        """Return how many claims lie near a place, made at least a spacing apart."""
        count = 0
        last = -self._spacing
        for claim in self._claims:
            if (
                claim.travelled - last >= self._spacing
                and self._torus.distance(claim.place, place) <= self._radius
            ):
                count += 1
                last = claim.travelled
        return count
