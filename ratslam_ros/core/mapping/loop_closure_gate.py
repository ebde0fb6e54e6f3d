# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Jumps: recognitions that would carry the robot across the map -> which of them are believed.

One view that looks like another must not fold the map. How far the map may be wrong between two
places grows with the way between them. What would move the robot further is doubted until what it
sees has said the same for two metres: then it has been carried. Where scans fit the places that
it knew there long before, it has not. Not in the papers; off by default.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.state import State

LEAST_M, LEAST_RAD = 1.0, 0.6
"""What moves the robot no further, and turns it no more, is no jump."""

SPOTS, WITNESSES = 8, 6
"""Of so many spots in a row, so many must have been recognised where a jump leads."""

SPACING_M = 0.3
"""Places nearer to each other are one spot: a robot that turns there sees one corner."""

AGREE_M = 1.0
"""Jumps that put the robot this close together agree."""

BEFORE_M = 60.0
"""Places that were made at least so far back on the robot's way tell whether it is still where it
believes to be. Had it been carried since, newer ones would be of where it was carried to."""

NEAR_M, NEAR_RAD = 0.7, math.radians(45.0)
"""And they are asked where they are this near."""


class Spot(NamedTuple):
    """Where a spot begins; of its last claim, where the robot was and where a view put it."""

    x_m: float
    y_m: float
    here: Pose | None = None
    claimed: Pose | None = None


class LoopClosureGate:
    """What was claimed of late, and whether that suffices to believe a jump."""

    def __init__(self) -> None:
        self._spots: deque[Spot] = deque(maxlen=SPOTS)
        self.lost = False
        """Whether the next jump is believed, as after ``restart``."""
        self.doubting = False
        """Whether the last one was refused: the robot is elsewhere than the pose cells have it."""
        self.refused = 0
        """Jumps that were not believed."""
        self.believed = 0
        """Jumps that were: the robot has been carried so often."""

    def state(self) -> State:
        """Return what was claimed, for ``restore``."""
        return {
            'spots': [
                [x_m, y_m, here and list(here), claimed and list(claimed)]
                for x_m, y_m, here, claimed in self._spots
            ],
            'lost': self.lost, 'doubting': self.doubting,
            'refused': self.refused, 'believed': self.believed,
        }  # fmt: skip

    def restore(self, state: State) -> None:
        """Take what ``state`` gave."""
        self.lost, self.doubting = state['lost'], state['doubting']
        self.refused, self.believed = state['refused'], state['believed']
        self._spots.extend(
            Spot(x_m, y_m, here and Pose(*here), claimed and Pose(*claimed))
            for x_m, y_m, here, claimed in state['spots']
        )

    def restart(self) -> None:
        """Believe the next jump: nobody knows where the robot is, it may have been carried."""
        self._spots.clear()
        self.lost = True

    def passed(self, here: Pose) -> None:
        """Take note that nothing was recognised where the robot is; what was there counts on."""
        self.doubting = False
        if not self._is_last(here.x_m, here.y_m):
            self._spots.append(Spot(here.x_m, here.y_m))

    def stayed(self, here: Pose) -> None:
        """Take note that the robot was recognised where it believed to be."""
        self.doubting = self.lost = False
        self._note(Spot(here.x_m, here.y_m))

    def claim(self, here: Pose, claimed: Pose) -> bool:
        """Take a jump from one pose on the map to another; return whether it is believed."""
        self._note(Spot(here.x_m, here.y_m, here, claimed))
        agreeing = sum(
            math.dist(composed(claim, composed(inverse(there), here))[:2], claimed[:2]) < AGREE_M
            for _, _, there, claim in self._spots if there is not None and claim is not None
        )  # fmt: skip
        self.doubting = agreeing < WITNESSES and not self.lost
        if self.doubting:
            self.refused += 1
            return False
        self.believed += 1
        self.lost = False
        self._spots.clear()
        return True

    def deny(self, here: Pose) -> None:
        """Refuse a jump: what is seen is what was seen before where the robot believes to be."""
        self._note(Spot(here.x_m, here.y_m))
        self.doubting = True
        self.refused += 1

    def _is_last(self, x_m: float, y_m: float) -> bool:
        return bool(self._spots) and math.dist(self._spots[-1][:2], (x_m, y_m)) < SPACING_M

    def _note(self, spot: Spot) -> None:
        """Keep a spot; where it is the last one, its place stays and the rest is new."""
        if self._is_last(spot.x_m, spot.y_m):
            last = self._spots.pop()
            spot = spot._replace(x_m=last.x_m, y_m=last.y_m)
        self._spots.append(spot)


def known_before(
    poses: NDArray[np.float64], made_m: NDArray[np.float64], odometer_m: float, here: Pose
) -> int | None:
    """Return the nearest experience at a pose of those that were not made of late, if one is near.

    Args:
        poses: (n, 3) m, m, rad.
        made_m: (n,) how far the robot had come when it made each.
        odometer_m: how far it has come now.
        here: where the map has it.
    """
    away_m = np.hypot(poses[:, 0] - here.x_m, poses[:, 1] - here.y_m)
    turned_rad = np.abs((poses[:, 2] - here.heading_rad + np.pi) % math.tau - np.pi)
    away_m[(made_m > odometer_m - BEFORE_M) | (turned_rad > NEAR_RAD)] = math.inf
    near = np.flatnonzero(away_m < NEAR_M)
    return int(near[away_m[near].argmin()]) if len(near) else None


def is_jump(
    here: Pose, claimed: Pose, drift: float, ends: NDArray[np.int64], ways_m: NDArray[np.float64],
    source_id: int, target_id: int, driven_m: float = 0.0,
) -> bool:  # fmt: skip
    """Return whether a transition moves the robot further than the map may be wrong.

    Args:
        here, claimed: poses on the map before and after it.
        drift: metres that the map may be wrong, for each metre of way between two places.
        ends: (links, 2) source and target.
        ways_m: (links,) their lengths.
        source_id, target_id: the experiences; where no links join them the map cannot tell.
        driven_m: way since the first of them.
    """
    away_m = math.dist(here[:2], claimed[:2])
    # A heading that is wrong all the way by so many rad leads astray by as many m for each m.
    turned_rad = abs(wrap(claimed.heading_rad - here.heading_rad))
    if turned_rad > LEAST_RAD + 2.0 * drift:
        return _are_joined(ends, ways_m, source_id, target_id, math.inf)
    most_m = (away_m - LEAST_M) / drift - driven_m
    return most_m > 0.0 and _are_joined(ends, ways_m, source_id, target_id, most_m)


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
