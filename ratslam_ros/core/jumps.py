# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Jumps: recognitions that would carry the robot across the map -> which of them are believed.

One view that looks like another must not fold the map. How far the map may be wrong between two
places grows with the way between them. What would move the robot further is doubted until what it
sees has said the same for some metres: then it has been carried. Not in the papers; off by
default.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.angles import wrap
from ratslam_ros.core.odometry import Pose, composed, inverse
from ratslam_ros.core.state import State

LEAST_M, LEAST_RAD = 1.0, 0.6
"""What moves the robot no further, and turns it no more, is no jump."""

CLAIMS, WITNESSES = 8, 6
"""Of so many places in a row, so many must have been recognised where a jump leads."""

SPACING_M = 0.3
"""Places nearer to each other count as one: a robot that turns there sees one corner."""

AGREE_M = 1.0
"""Jumps that put the robot this close together agree."""


class Claim(NamedTuple):
    """Where the robot was on the map, and where a view put it; None where it put it nowhere."""

    here: Pose
    claimed: Pose | None


class Jumps:
    """What was claimed of late, and whether that suffices to believe a jump."""

    def __init__(self) -> None:
        self._claims: deque[Claim] = deque(maxlen=CLAIMS)
        self.refused = 0
        """Jumps that were not believed."""
        self.believed = 0
        """Jumps that were: the robot has been carried so often."""

    def state(self) -> State:
        """Return what was claimed, for ``restore``."""
        return {
            'claims': [[list(here), claimed and list(claimed)] for here, claimed in self._claims],
            'refused': self.refused, 'believed': self.believed,
        }  # fmt: skip

    def restore(self, state: State) -> None:
        """Take what ``state`` gave."""
        self.refused, self.believed = state['refused'], state['believed']
        self._claims.extend(
            Claim(Pose(*here), claimed and Pose(*claimed)) for here, claimed in state['claims']
        )

    @property
    def doubting(self) -> bool:
        """Whether the last one was refused: the robot is elsewhere than the pose cells have it."""
        return bool(self._claims) and self._claims[-1].claimed is not None

    def stayed(self, here: Pose) -> None:
        """Take note that the robot is where it believed to be, or where nothing is known."""
        self._take(Claim(here, None))

    def claim(self, here: Pose, claimed: Pose) -> bool:
        """Take a jump from one pose on the map to another; return whether it is believed."""
        self._take(Claim(here, claimed))
        agreeing = sum(
            math.dist(composed(claim, composed(inverse(there), here))[:2], claimed[:2]) < AGREE_M
            for there, claim in self._claims if claim is not None
        )  # fmt: skip
        if agreeing < WITNESSES:
            self.refused += 1
            return False
        self.believed += 1
        self._claims.clear()
        return True

    def _take(self, claim: Claim) -> None:
        """Keep a claim, in place of the last one if that was made at the same place."""
        if self._claims and math.dist(self._claims[-1].here[:2], claim.here[:2]) < SPACING_M:
            claim = Claim(self._claims.pop().here, claim.claimed)
        self._claims.append(claim)


def is_jump(
    here: Pose, claimed: Pose, drift: float, ends: NDArray[np.int64], ways_m: NDArray[np.float64],
    source_id: int, target_id: int,
) -> bool:  # fmt: skip
    """Return whether a transition moves the robot further than the map may be wrong.

    Args:
        here, claimed: poses on the map before and after it.
        drift: metres that the map may be wrong, for each metre of way between two places.
        ends: (links, 2) source and target.
        ways_m: (links,) their lengths.
        source_id, target_id: the experiences; where no links join them the map cannot tell.
    """
    away_m = math.dist(here[:2], claimed[:2])
    turned = abs(wrap(claimed.heading_rad - here.heading_rad)) > LEAST_RAD
    if away_m <= LEAST_M and not turned:
        return False
    limit_m = math.inf if turned else (away_m - LEAST_M) / drift
    return _are_joined(ends, ways_m, source_id, target_id, limit_m)


def _are_joined(
    ends: NDArray[np.int64], ways_m: NDArray[np.float64], source_id: int, target_id: int,
    most_m: float,
) -> bool:  # fmt: skip
    """Return whether links lead from one experience to another within a way."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    count = 1 + int(max(ends.max(initial=0), source_id, target_id))
    graph = coo_array((np.maximum(ways_m, 1e-9), ends.T), shape=(count, count)).tocsr()
    reached_m = dijkstra(graph, directed=False, indices=source_id, limit=most_m)
    return bool(np.isfinite(reached_m[target_id]))
