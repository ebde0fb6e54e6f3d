# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Loop-closure gate: reject transitions that exceed the possible drift of the map.

One false match must not deform the map. The covariance of the relative pose of two places follows
from the path between them. A transition that displaces the robot beyond the chi-square bound is
rejected until closures along about two metres of driving agree; then the robot has been
relocated. It is also rejected if the laser scan fits an experience that was created long before
near the present pose. Not in the papers; off by default.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.saved import Field, Saved, count
from ratslam_ros.core.mapping.pose_covariance import (
    CHI_SQUARE_3,
    Matrix,
    OdometryVariance,
    compound,
    largest_variance,
    squared_distance,
)

SPOT_COUNT, REQUIRED_COUNT = 8, 6
"""Number of most recent spots considered, and number of them that must support a relocation."""

LOST_COUNT = 3
"""Number of spots with agreeing closures from which on they contradict the pose on the map."""

SPOT_SPACING_M = 0.3
"""Distance between spots; a robot that turns in place gives one spot, not many."""

AGREEMENT_M = 1.0
"""Largest distance between the robot positions that two agreeing closures imply, in m."""

CONTRADICTING_VIEW_COUNT = 2
"""Number of views of other places that contradict a relocation that scans have proven, or a pose
from the operator. A single view is no evidence."""

LONG_KNOWN_M = 60.0
"""Distance to be driven after an experience was created before it can confirm the robot's pose.

Experiences created later may lie at the place that the robot was relocated to.
"""

NEARBY_M, NEARBY_RAD = 0.7, math.radians(45.0)
"""Largest distance and rotation to an experience that may confirm the robot's pose."""


class Spot(NamedTuple):
    """Position where a spot begins, and the last closure there that exceeded the drift, if any.

    ``here``, ``claimed``: pose of the robot on the map, before the closure and according to it.
    """

    x_m: float
    y_m: float
    here: Pose | None = None
    claimed: Pose | None = None


Outcome = Literal['closed', 'rejected', 'relocated']


class Excess(NamedTuple):
    """Displacement and rotation by a closure, and the standard deviations expected of them.

    ``deviation_m`` is that in the worst direction.
    """

    displacement_m: float
    deviation_m: float
    rotation_rad: float
    deviation_rad: float

    def __str__(self) -> str:
        return (
            f'moves the robot by {self.displacement_m:.1f} m and turns it by '
            f'{math.degrees(self.rotation_rad):.0f} degrees; expected standard deviations of '
            f'{self.deviation_m:.1f} m and {math.degrees(self.deviation_rad):.0f} degrees'
        )

    @classmethod
    def of(cls, here: Pose, claimed: Pose, covariance: Matrix) -> Excess | None:
        """Return the excess of a closure; None if it is within the bound.

        Args:
            here, claimed: poses of the robot before and after the closure.
            covariance: that of their difference, in the frame of ``here``.
        """
        if squared_distance(here, claimed, covariance) <= CHI_SQUARE_3:
            return None
        turned_rad = abs(wrap(claimed.heading_rad - here.heading_rad))
        deviation_m = math.sqrt(largest_variance(covariance))
        return cls(
            math.dist(here[:2], claimed[:2]), deviation_m, turned_rad, math.sqrt(covariance[2, 2])
        )


class ClosureEvent(NamedTuple):
    """A loop closure, or its rejection, or a relocation of the robot.

    ``outcome``: `closed`: a link connects two known experiences from now on; `rejected`: the
    robot stays at the source; `relocated`: the robot is at the target, without a link. ``reason``
    explains a rejection or relocation.
    """

    outcome: Outcome
    source_id: int
    target_id: int
    reason: str = ''


class LoopClosureGate(Saved):
    """Recent evidence for and against a relocation of the robot."""

    SAVED = (
        Field('spots', '_spots', list, save=lambda spots: [
            [x_m, y_m, here and list(here), claimed and list(claimed)]
            for x_m, y_m, here, claimed in spots
        ], load=lambda rows: [
            Spot(x_m, y_m, here and Pose(*here), claimed and Pose(*claimed))
            for x_m, y_m, here, claimed in rows
        ]),
        Field('lost', 'accepts_next', bool), Field('doubting', 'rejecting', bool),
        count('refused', 'rejected_count'), count('believed', 'relocation_count'),
        count('agreeing', 'agreeing_count'),
    )

    def __init__(self) -> None:
        self._spots: deque[Spot] = deque(maxlen=SPOT_COUNT)
        self.accepts_next = False
        """Whether the next relocation is accepted at once, as after ``restart``."""
        self.rejecting = False
        """Whether the last closure was rejected, so that map and pose cells disagree."""
        self.rejected_count = 0
        """Number of rejected closures."""
        self.relocation_count = 0
        """Number of accepted relocations."""
        self.agreeing_count = 0
        """Number of recent closures that agreed with the last one, itself included."""

    def restart(self) -> None:
        """Accept the next relocation at once: the robot may have been carried unobserved."""
        self._spots.clear()
        self.accepts_next = True

    def discard_path(self) -> None:
        """Discard the evidence: the robot's motion since it was recorded is unknown."""
        self._spots.clear()
        self.rejecting = False

    def record_new_place(self, here: Pose) -> None:
        """Record that a new place was learned; an earlier closure at this spot still counts."""
        self.rejecting = False
        if not self._is_last(here.x_m, here.y_m):
            self._spots.append(Spot(here.x_m, here.y_m))

    def record_agreement(self, here: Pose) -> None:
        """Record a recognition that agrees with the present pose estimate."""
        self.rejecting = self.accepts_next = False
        self._record(Spot(here.x_m, here.y_m))

    def record_closure(
        self, here: Pose, claimed: Pose, by_views: bool = True,
        required_count: int = REQUIRED_COUNT,
    ) -> bool:
        """Record a closure that contradicts the pose, and return whether it is accepted.

        Args:
            here: pose of the robot on the map before the closure.
            claimed: pose of the robot on the map according to the closure.
            by_views: whether views can relocate the robot; if not, every closure is rejected.
            required_count: number of closures that must agree.
        """
        self._record(Spot(here.x_m, here.y_m, here, claimed))
        self.agreeing_count = sum(
            math.dist(composed(claim, composed(inverse(there), here))[:2], claimed[:2])
            < AGREEMENT_M
            for _, _, there, claim in self._spots if there is not None and claim is not None
        )
        enough = self.agreeing_count >= required_count or self.accepts_next
        self.rejecting = not (enough and by_views)
        if self.rejecting:
            self.rejected_count += 1
            return False
        self.relocation_count += 1
        self.accepts_next = False
        self._spots.clear()
        return True

    def offer_proven(self, claimed: Pose, views: Sequence[Pose]) -> bool:
        """Return whether a relocation that scans have proven is accepted: views may contradict it.

        Args:
            claimed: pose of the robot on the map according to the scans.
            views: poses according to the views recognised since the robot is lost, carried along
                by odometry. A single view is no evidence.
        """
        agreeing = sum(math.dist(view[:2], claimed[:2]) < AGREEMENT_M for view in views)
        contradicting = len(views) - agreeing
        if contradicting >= CONTRADICTING_VIEW_COUNT and contradicting > agreeing:
            self.rejected_count += 1
            return False
        self.relocation_count += 1
        self.accepts_next = False
        self.rejecting = True  # until the pose cells arrive there as well
        self._spots.clear()
        return True

    def reject_by_scan(self, here: Pose) -> None:
        """Reject a closure because the scan confirms the present pose estimate."""
        self._record(Spot(here.x_m, here.y_m))
        self.rejecting = True
        self.rejected_count += 1

    def _is_last(self, x_m: float, y_m: float) -> bool:
        return bool(self._spots) and math.dist(self._spots[-1][:2], (x_m, y_m)) < SPOT_SPACING_M

    def _record(self, spot: Spot) -> None:
        """Append a spot, or replace the evidence of the last one if the robot is still there."""
        if self._is_last(spot.x_m, spot.y_m):
            last = self._spots.pop()
            spot = spot._replace(x_m=last.x_m, y_m=last.y_m)
        self._spots.append(spot)


def long_known_experience(
    poses: NDArray[np.float64], created_at_m: NDArray[np.float64], odometer_m: float, here: Pose
) -> int | None:
    """Return the id of the nearest long-known experience close to a pose, None if there is none.

    Args:
        poses: (n, 3) x, y in m and heading in rad of the experiences.
        created_at_m: (n,) odometer reading in m at which each experience was created.
        odometer_m: present odometer reading in m.
        here: pose of the robot on the map.
    """
    x_m, y_m = poses[:, 0] - here.x_m, poses[:, 1] - here.y_m
    known = created_at_m <= odometer_m - LONG_KNOWN_M
    near = np.flatnonzero((np.abs(x_m) < NEARBY_M) & (np.abs(y_m) < NEARBY_M) & known)
    turned_rad = np.abs((poses[near, 2] - here.heading_rad + np.pi) % math.tau - np.pi)
    away_m = np.where(turned_rad > NEARBY_RAD, math.inf, np.hypot(x_m[near], y_m[near]))
    nearest = int(away_m.argmin()) if len(near) else -1
    return int(near[nearest]) if nearest >= 0 and away_m[nearest] < NEARBY_M else None


def path_covariance(
    poses: NDArray[np.float64], ends: NDArray[np.int64], lengths_m: NDArray[np.float64],
    source_id: int, target_id: int, noise: OdometryVariance,
) -> Matrix | None:
    """Return the covariance of an experience's pose relative to another one, in its frame.

    It is compounded along the shortest path over links, so it is at most too large. None if no
    links connect them: then the map contains no estimate of their relative pose.

    Args:
        poses: (n, 3) x, y in m and heading in rad of the experiences.
        ends: (links, 2) source and target.
        lengths_m: (links,) length of each link in m.
        source_id: the experience.
        target_id: the other one.
        noise: variances that driving adds.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    count = len(poses)
    pairs = ends.T.astype(np.int32)  # SciPy before 1.15 requires 32-bit indices
    graph = coo_array((np.maximum(lengths_m, 1e-9), pairs), shape=(count, count)).tocsr()
    reached_m, came_from = dijkstra(
        graph, directed=False, indices=target_id, return_predecessors=True
    )
    if not math.isfinite(reached_m[source_id]):
        return None
    path = [source_id]
    while path[-1] != target_id:
        path.append(int(came_from[path[-1]]))
    covariance = np.zeros((3, 3))
    for before, after in itertools.pairwise(reversed(path)):
        step = composed(inverse(Pose(*poses[before].tolist())), Pose(*poses[after].tolist()))
        compound(covariance, *step, float(reached_m[after] - reached_m[before]), *noise)
    return covariance
