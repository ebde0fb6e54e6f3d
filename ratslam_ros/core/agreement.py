# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Agreement: what recent views say of where the robot is, and how much to believe one of them.

One wrong recognition must not move the packet, and several that agree must, over a wide range of
injection energies (algorithm.md, Robustness). Every recognised view claims a place; the claim is
carried along with the odometry, so that claims of one visit fall together and chance ones do not.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from ratslam_ros.core.torus import Place, Torus


@dataclass(slots=True)
class _Claim:
    template_id: int
    place: Place


class Agreement:
    """The claims of the most recently recognised views."""

    def __init__(self, torus: Torus, views: float, radius_cells: float, recent: int) -> None:
        """Prepare without claims.

        Args:
            torus: where places are.
            views: how many views must agree for a claim to count fully; 0: each always does.
            radius_cells: claims this close agree.
            recent: number of recognised views that are remembered.
        """
        self._torus = torus
        self._views = views
        self._radius = radius_cells
        self._claims: deque[_Claim] = deque(maxlen=recent)

    def integrate(self, chord_cells: float, turn_planes: float) -> None:
        """Carry all claims along with one motion of the robot."""
        for claim in self._claims:
            claim.place = self._torus.moved(claim.place, chord_cells, turn_planes)

    def weigh(self, template_id: int, place: Place, believed: Place) -> float:
        """Take a recognised view's claim; return the factor for the energy that it injects.

        The factor is ((n - m) / views) squared, where n views agree with the claim, itself
        included, and m agree with the believed place instead. A view seen on end claims once,
        from where it was first recognised.
        """
        if self._views == 0.0:
            return 1.0
        if not self._claims or self._claims[-1].template_id != template_id:
            self._claims.append(_Claim(template_id, place))
        claimed = self._claims[-1].place
        support = self._supporters(claimed)
        if self._torus.distance(claimed, believed) > self._radius:
            support -= self._supporters(believed)
        return (max(support, 0) / self._views) ** 2

    def _supporters(self, place: Place) -> int:
        """Return the number of different views whose claim lies near a place."""
        return len(
            {
                claim.template_id
                for claim in self._claims
                if self._torus.distance(claim.place, place) <= self._radius
            }
        )
