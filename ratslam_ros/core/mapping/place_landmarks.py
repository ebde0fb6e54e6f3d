# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmarks of the map, each stored relative to the experience that observed it first.

They follow the experiences when the map is corrected or pruned. A landmark that is observed again
is counted, not stored again, so that their number is that of the corners of the environment and
not that of the experiences.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.common.rows import Rows
from ratslam_ros.core.common.saved import MAX_COUNT, Field, Saved
from ratslam_ros.core.landmarks.features import BAR_SIZE, Features

MAX_LANDMARK_COUNT = 4000
"""Largest number of landmarks; at the limit, a new one replaces the one observed least often."""

MIN_VISIT_COUNT = 2
"""Number of experiences that must have observed a landmark before it is used: people walk away."""

SAME_M, SAME_RAD, SAME_LENGTH_M = 0.3, 0.4, 0.3
"""Largest differences of position, direction and length between observations of one landmark."""

VARIANCES = np.array([0.06, 0.06, 0.06, 0.05]) ** 2
"""Variances of x, y in m^2, direction in rad^2 and length in m^2 of a landmark relative to others
within the range of a scan: of the laser, the extraction, and nearby experiences on the map."""


Shape = tuple[float, float, float, float]
"""x, y in m, direction in rad, length in m."""


class PlaceLandmarks(Saved):
    """The landmarks that experiences observed."""

    SAVED = (
        Field('owners', '_owners', 'i8', ('landmarks',), 0, 'experiences'),
        Field('shapes', '_shapes', 'f8', ('landmarks', BAR_SIZE)),
        Field('visits', '_visits', 'i8', ('landmarks',), 0, MAX_COUNT),
    )

    def __init__(self) -> None:
        self._owners, self._visits = Rows(None, np.int64), Rows(None, np.int64)
        self._shapes = Rows(BAR_SIZE)

    def __len__(self) -> int:
        """Return the number of landmarks."""
        return len(self._owners)

    def add(
        self, experience_id: int, offset: Pose, seen: NDArray[np.float64],
        poses: NDArray[np.float64],
    ) -> None:
        """Add what an experience observes; landmarks that are known already are counted.

        Args:
            experience_id: the experience, which is new.
            offset: pose of the robot in the frame of the experience.
            seen: (n, 4) x, y in m, direction in rad and length in m, in the robot's frame.
            poses: (m, 3) poses of all experiences.
        """
        known = self._placed(poses)
        for row in seen.tolist():
            self._count(experience_id, moved_landmark(offset, row), 1, poses, known)

    def add_counted(
        self, experience_id: int, shape: Shape, visits: int, poses: NDArray[np.float64],
    ) -> None:
        """Add a landmark of another map; one that is known already gets its observations.

        Args:
            experience_id: the experience that it is stored with.
            shape: in the frame of that experience.
            visits: number of experiences that observed it.
            poses: (m, 3) poses of all experiences.
        """
        self._count(experience_id, shape, visits, poses, self._placed(poses))

    def remove_owned(self, experience_ids: Collection[int]) -> None:
        """Remove the landmarks that some experiences observed first."""
        self._keep(~np.isin(self._owners.values, np.array(sorted(experience_ids), np.int64)))

    def hand_over(self, experience_id: int, stand_in_id: int, pose: Pose) -> None:
        """Store the landmarks of an experience that is pruned with its stand-in.

        Args:
            experience_id: the pruned experience.
            stand_in_id: the experience that represents it; -1: its landmarks are removed.
            pose: of the pruned experience in the frame of the stand-in.
        """
        for row in np.flatnonzero(self._owners.values == experience_id).tolist():
            self._shapes[row] = moved_landmark(pose, self._shapes[row])
            self._owners[row] = stand_in_id
        self._keep(self._owners.values >= 0)

    def on_map(
        self, poses: NDArray[np.float64], excluded: Collection[int] = ()
    ) -> NDArray[np.float64]:
        """Return the (n, 4) landmarks in the frame of the map that several experiences observed.

        Args:
            poses: (m, 3) poses of all experiences.
            excluded: experiences whose landmarks are left out.
        """
        unused = np.isin(self._owners.values, np.array(sorted(excluded), np.int64))
        return self._placed(poses)[(self._visits.values >= MIN_VISIT_COUNT) & ~unused]

    def _count(
        self, experience_id: int, shape: Shape, visits: int, poses: NDArray[np.float64],
        known: NDArray[np.float64],
    ) -> None:
        """Add the visits to a known landmark, or insert the landmark."""
        on_map = moved_landmark(Pose(*poses[experience_id].tolist()), shape)
        same = nearest_same(known, *on_map)
        if same >= 0:
            self._visits[same] += visits
            return
        row = len(self)
        if row >= MAX_LANDMARK_COUNT:
            row = int(self._visits.values.argmin())
        self._owners[row], self._shapes[row], self._visits[row] = experience_id, shape, visits

    def _keep(self, rows: NDArray[np.bool_]) -> None:
        for column in (self._owners, self._shapes, self._visits):
            column.keep(rows)

    def _placed(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (n, 4) landmarks in the frame of the map."""
        placed: NDArray[np.float64] = _placed(self._shapes.values, poses[self._owners.values])
        return placed


def features_of(
    shapes: NDArray[np.float64], drift_m2: float | NDArray[np.float64] = 0.0
) -> Features:
    """Return landmarks with independent errors of the variances ``VARIANCES``.

    Args:
        shapes: (n, 4) x, y in m, direction in rad, length in m.
        drift_m2: variance of the position in addition, of all or (n, 1) of each.
    """
    n = len(shapes)
    variances = np.tile(VARIANCES, (n, 1))
    variances[:, :2] += drift_m2
    return Features(
        np.arange(n), BAR_SIZE * np.arange(n + 1), shapes.ravel(), np.diag(variances.ravel())
    )


def moved_landmark(base: Pose, shape: Sequence[float]) -> Shape:
    """Return a landmark that is given in the frame of a pose in the parent frame of the pose."""
    x, y, direction, length = shape
    return *composed(base, Pose(x, y, direction)), length


@compiled
def _placed(shapes: NDArray[np.float64], poses: NDArray[np.float64]) -> NDArray[np.float64]:
    placed = np.empty_like(shapes)
    for i in range(len(shapes)):
        c, s = math.cos(poses[i, 2]), math.sin(poses[i, 2])
        placed[i, 0] = poses[i, 0] + c * shapes[i, 0] - s * shapes[i, 1]
        placed[i, 1] = poses[i, 1] + s * shapes[i, 0] + c * shapes[i, 1]
        placed[i, 2] = wrap(poses[i, 2] + shapes[i, 2])
        placed[i, 3] = shapes[i, 3]
    return placed


@compiled
def nearest_same(
    known: NDArray[np.float64], x: float, y: float, direction: float, length: float
) -> int:
    """Return the row of the nearest landmark that may be the same, -1 if there is none.

    Args:
        known: (n, 4) landmarks.
        x, y, direction, length: an observation in the same frame.
    """
    nearest, least = -1, SAME_M
    for i in range(len(known)):
        away = math.hypot(known[i, 0] - x, known[i, 1] - y)
        if (
            away <= least and abs(wrap(known[i, 2] - direction)) <= SAME_RAD
            and abs(known[i, 3] - length) <= SAME_LENGTH_M
        ):
            nearest, least = i, away
    return nearest
