# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hebbian links between templates and pose cells: a view may be linked to several places.

Milford et al. (2005), section II.C. The weights of the template that is seen approach the present
activity,

    w(t + 1) = (1 - rate) w(t) + rate P(t),

so that a view that several places share is linked to all of them, each by the share of the recent
times that it was seen there. The paper gives the rate and says what it trades: a high one
relocalises quickly, and forgets ambiguous views. The equation is ours.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.saved import MAX_COUNT, MAX_ID, Field, Saved
from ratslam_ros.core.common.state import State

LEAST_SHARE = 0.01
"""Weights below this share of the largest one of their template are dropped, which bounds their
number: a packet has some hundred cells."""

_Weights = tuple[NDArray[np.int64], NDArray[np.float64]]
"""(n,) numbers of cells, ascending, and (n,) weights, above 0."""


def links_fit(links: State, pose_cells: State) -> bool:
    """Return whether saved links lead to pose cells, and each belongs to a template."""
    cells = links['cells']
    return bool(sum(links['counts']) == len(cells)) and (
        len(cells) == 0 or bool(cells.max() < math.prod(pose_cells['dims']))
    )


class HebbianLinks(Saved):
    """Weights of the links between templates and pose cells."""

    SAVED = (
        Field('templates', '', 'i8', ('templates',), 0, MAX_ID,
              save=lambda own: list(own._weights)),
        Field('counts', '', 'i8', ('templates',), 0, MAX_COUNT,
              save=lambda own: [len(cells) for cells, _ in own._weights.values()]),
        Field('cells', '', 'i8', ('links',), 0, MAX_COUNT, save=lambda own: np.concatenate(
            [np.empty(0, np.int64), *(cells for cells, _ in own._weights.values())]
        )),
        Field('weights', '', 'f8', ('links',), 0.0, 1.0, save=lambda own: np.concatenate(
            [np.empty(0), *(weights for _, weights in own._weights.values())]
        )),
    )

    def __init__(self, dims: tuple[int, int, int], rate: float) -> None:
        """Start without links.

        Args:
            dims: numbers of cells along theta, y and x.
            rate: learning rate, at most 1; with 0 nothing is learned.
        """
        self._dims = dims
        self._rate = rate
        self.is_used = rate > 0.0
        """Whether links are learned."""
        self._weights: dict[int, _Weights] = {}

    def learn(
        self, template_id: int, turn_planes: float, cells: NDArray[np.int64],
        activity: NDArray[np.float64],
    ) -> None:
        """Strengthen the links of a template to the active cells, and weaken its others.

        Args:
            template_id: the template that is seen.
            turn_planes: heading of the robot minus heading of the template, in heading planes.
            cells: (n, 3) theta, y and x of the active cells.
            activity: (n,) their activity.
        """
        numbers = self._turned(np.ravel_multi_index(tuple(cells.T), self._dims), -turn_planes)
        before, weights = self._weights.get(template_id, (numbers[:0], activity[:0]))
        found, rows = np.unique(np.concatenate([before, numbers]), return_inverse=True)
        both = np.concatenate([(1.0 - self._rate) * weights, self._rate * activity])
        sums = np.bincount(rows, both)
        kept = sums >= LEAST_SHARE * sums.max()
        self._weights[template_id] = found[kept], sums[kept]

    def recalled(
        self, template_id: int, turn_planes: float
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the cells that a template is linked to: (n, 3) theta, y and x, and weights."""
        numbers, weights = self._weights[template_id]
        turned = self._turned(numbers, turn_planes)
        return np.stack(np.unravel_index(turned, self._dims), axis=1), weights

    def __contains__(self, template_id: int) -> bool:
        return template_id in self._weights

    def forget(self, template_ids: Collection[int] | None = None) -> None:
        """Remove the links of some templates; None: of all."""
        for template_id in list(self._weights if template_ids is None else template_ids):
            self._weights.pop(template_id, None)

    def _restored(self, state: State) -> None:
        if not self.is_used:
            return
        ends = np.cumsum(state['counts'])[:-1]
        cells, weights = (np.split(state[key], ends) for key in ('cells', 'weights'))
        ids = np.asarray(state['templates']).tolist()
        self._weights = dict(zip(ids, zip(cells, weights, strict=False), strict=False))

    def _turned(self, numbers: NDArray[np.int64], planes: float) -> NDArray[np.int64]:
        """Return the numbers of cells that are some heading planes further, to the nearest one."""
        plane = self._dims[1] * self._dims[2]
        return (numbers + round(planes) * plane) % (self._dims[0] * plane)
