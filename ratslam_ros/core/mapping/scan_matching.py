# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scan matching: laser scans that locate the robot relative to experiences.

A view is recognised up to a metre from where it was learned, and the view does not measure that
offset. Aligning the scans of both visits does. Not in the papers; off by default.
"""

from __future__ import annotations

import math
from collections import deque
from functools import partial
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.saved import Field, Saved, count
from ratslam_ros.core.common.scan import (
    MAX_BEAM_COUNT,
    Scan,
    points_of,
    scan_from_state,
    scan_state,
)
from ratslam_ros.core.common.state import State
from ratslam_ros.core.mapping.icp import PRIOR_SD_RAD, Alignment, align
from ratslam_ros.core.mapping.pose_covariance import (
    PoseCovariance,
    isotropic,
    largest_variance,
    turned,
)
from ratslam_ros.core.mapping.scan_match import TURN_M_PER_RAD, VIEW_SD_M, ScanMatch
from ratslam_ros.core.pose_cells.map_action import MapAction

BUFFER_NS = 2_000_000_000
"""Time for which scans and odometry poses are buffered for an action with an earlier stamp."""

MAX_SCAN_AGE_NS = 300_000_000
"""Largest age of a scan, at the stamp of an action, that is used for the action."""

MAX_RANGE_M = 8.0
"""Range beyond which points are ignored, because neighbouring beams are too far apart there."""

MOTION_SD_M = 0.05
"""Standard deviation of the distance that odometry measures between two experiences."""

MAP_SD_M = 0.1
"""Standard deviation of the relative position of two nearby experiences on the map."""

FUSION_GATE_SD = 3.0
"""Largest difference between two estimates, in standard deviations, at which they agree."""

CONFIRMING_SD_M, CONFIRMING_OFFSET_M = 0.1, 0.5
"""Largest standard deviation and offset of an alignment that confirms the robot's pose. Along a
bare corridor the standard deviation exceeds it."""


SAVED_TOGETHER = 64
"""Number of experiences whose scans are saved in one array. A new scan has its array built anew,
all others are handed out again: 20,000 scans are tens of megabytes."""


class Observed(NamedTuple):
    """The last scan of each laser before a stamp.

    ``points``: (n, 2) m, of all lasers, in the robot's frame at the stamp. ``odometry``: pose of
    the robot by odometry at the stamp. ``scans``: each scan, with the pose of the robot at its
    stamp in the frame of the robot at the stamp.
    """

    points: NDArray[np.float64]
    odometry: Pose
    scans: list[tuple[Scan, Pose]]

    @property
    def driven_m(self) -> float:
        """Distance driven since the oldest scan; turns count as ``TURN_M_PER_RAD`` says."""
        return max(math.hypot(*at[:2]) + TURN_M_PER_RAD * abs(at[2]) for _, at in self.scans)


def _all_points(saved: Any) -> NDArray[np.float32]:
    """Return the points of all scans; merged maps have them in one array."""
    none: NDArray[np.float32] = np.empty((0, 2), np.float32)
    return np.concatenate([none, *saved]) if isinstance(saved, list) else np.asarray(saved)


class ScanMatcher(Saved):
    """Stores the scan of each experience, and aligns later scans with it."""

    SAVED = (
        Field('present/scans', '_scans', list,
              save=lambda scans: [scan_state(scan) for scan in scans],
              load=lambda scans: [scan_from_state(scan) for scan in scans],
              fits=('scans', lambda scans, _: all(
                  scan['ranges_m'].ndim == 1 and scan['ranges_m'].dtype == np.float64
                  for scan in scans
              ))),
        Field('present/track_ns', '', 'i8', ('track',), 0,
              save=lambda own: [stamp_ns for stamp_ns, _ in own._track]),
        Field('present/track', '', 'f8', ('track', 3),
              save=lambda own: np.array([pose for _, pose in own._track]).reshape(-1, 3)),
        Field('present/odometry', '_odometry_pose', float, (3,), make=Pose),
        count('present/restarts', 'restarts'),
        Field('ids', '', 'i8', ('scans',), 0, 'experiences',
              save=lambda own: sorted(own._references)),
        Field('sizes', '', 'i8', ('scans',), 0, MAX_BEAM_COUNT,
              save=lambda own: [len(own._references[i]) for i in sorted(own._references)]),
        Field('points', '', object, save=lambda own: own._saved_points(),
              fits=('points of all scans', lambda points, state: (
                  _all_points(points).shape == (np.sum(state['sizes'], initial=0), 2)
                  and _all_points(points).dtype == np.float32
              ))),
    )

    def __init__(self) -> None:
        self._scans: deque[Scan] = deque()
        self._track: deque[tuple[int, Pose]] = deque()
        self._odometry_pose = Pose(0.0, 0.0, 0.0)
        self._references: dict[int, NDArray[np.float32]] = {}
        self._saved: dict[int, NDArray[np.float32]] = {}
        """Points of groups of ``SAVED_TOGETHER`` experiences, as they are saved; never changed."""
        self.restarts = 0
        """Number of times the buffers were cleared."""

    def scan(self, scan: Scan) -> None:
        """Buffer one scan; a stamp that jumps back clears the buffers."""
        if self._scans and scan.stamp_ns < self._scans[-1].stamp_ns:
            self.restart()
        self._scans.append(scan)
        while scan.stamp_ns - self._scans[0].stamp_ns > BUFFER_NS:
            self._scans.popleft()

    def integrate(self, stamp_ns: int, motion: Motion) -> None:
        """Add one motion of the odometry that ends at ``stamp_ns``."""
        if not motion.is_known:
            self.restart()
            return
        self._odometry_pose = moved(self._odometry_pose, motion)
        self._track.append((stamp_ns, self._odometry_pose))
        while self._track[-1][0] - self._track[0][0] > BUFFER_NS:
            self._track.popleft()

    def restart(self) -> None:
        """Clear the buffers after the robot was carried; the scans of experiences are kept."""
        self.restarts += 1
        self._scans.clear()
        self._track.clear()

    def reference(self, experience_id: int) -> NDArray[np.float32] | None:
        """Return the (n, 2) points in m of an experience's scan, in its frame; None if unknown."""
        return self._references.get(experience_id)

    def observed(self, stamp_ns: int) -> Observed | None:
        """Return the last scan of each laser at or before a stamp, None if there is none.

        A scan is left out if it is too old, or if no odometry covers it. A laser that fails thus
        leaves the others in use.
        """
        now = self._pose_at(stamp_ns)
        if now is None:
            return None
        latest = {
            scan.laser: scan for scan in self._scans
            if stamp_ns - MAX_SCAN_AGE_NS <= scan.stamp_ns <= stamp_ns
        }
        scans = [
            (scan, composed(inverse(now), then)) for _, scan in sorted(latest.items())
            if (then := self._pose_at(scan.stamp_ns)) is not None
        ]
        if not scans:
            return None
        return Observed(np.concatenate([_near_points(*seen) for seen in scans]), now, scans)

    def locate(
        self, stamp_ns: int, action: MapAction, current_id: int, offset: Pose,
        expected: Pose | None = None, covariance: PoseCovariance | None = None,
    ) -> ScanMatch:
        """Estimate the robot's pose relative to its current experience and to the action's target.

        The scan at a new experience is stored.

        Args:
            stamp_ns: stamp of the action.
            action: the action that the map is about to execute.
            current_id, offset: current experience, and the robot's pose in its frame by odometry.
            expected: the robot's pose in the frame of the action's target; None if unknown.
            covariance: that of the robot's pose on the map; None if unknown.
        """
        if action.action == 'none':
            return ScanMatch()
        observed = self.observed(stamp_ns)
        before, there = self._references.get(current_id), self._references.get(action.target_id)
        view = action.relative_pose
        if action.action == 'create':
            there = None
            self._references.pop(action.target_id, None)
            self._saved.pop(action.target_id // SAVED_TOGETHER, None)
            if observed is not None:
                stored = transformed(observed.points, view).astype(np.float32)
                self._references[action.target_id] = stored
        if observed is None:
            return ScanMatch()
        points, found = observed.points, None
        own = None
        if covariance is not None and covariance.relative is not None:
            own = turned(covariance.relative, offset.heading_rad)
        if action.action != 'create':
            variance_m2 = math.inf
            if covariance is not None and not covariance.reason:
                variance_m2 = largest_variance(covariance.matrix)
            found = _located_in_target(there, points, view, expected, variance_m2)
        from_current = None if before is None else align(before, points, offset, MOTION_SD_M, own)
        return ScanMatch(
            from_current and from_current.pose, found and found.pose, partial(self._fits, points),
            found and turned(found.covariance, -found.pose.heading_rad),
            from_current and turned(from_current.covariance, -from_current.pose.heading_rad),
            observed.driven_m,
        )

    def _fits(self, points: NDArray[np.float64], experience_id: int, pose: Pose) -> bool:
        """Return whether a scan confirms the pose of the robot in the frame of an experience.

        Args:
            points: (n, 2) m, points in the robot's frame.
            experience_id: the experience.
            pose: expected pose. The alignment must be close to it, and constrained in every
                direction.
        """
        reference = self._references.get(experience_id)
        found = None if reference is None else align(reference, points, pose, VIEW_SD_M)
        if found is None:
            return False
        at = found.pose
        return (
            found.unconstrained_m2 < CONFIRMING_SD_M**2
            and math.dist(at[:2], pose[:2]) < CONFIRMING_OFFSET_M
            and abs(wrap(at.heading_rad - pose.heading_rad)) < PRIOR_SD_RAD * FUSION_GATE_SD
        )

    def _saved_points(self) -> list[NDArray[np.float32]]:
        """Return the points of all scans in groups; those are built anew that have changed."""
        for number, ids in groupby(sorted(self._references), lambda i: i // SAVED_TOGETHER):
            if number not in self._saved:
                self._saved[number] = np.concatenate([self._references[i] for i in ids])
        return [self._saved[number] for number in sorted(self._saved)]

    def _restored(self, state: State) -> None:
        ends, points = np.cumsum(state['sizes']), _all_points(state['points'])
        scans = np.split(points, ends)[:-1]
        self._references = dict(zip(state['ids'].tolist(), scans, strict=True))
        if 'present' not in state:  # merged
            self.restart()
            return
        present = state['present']
        poses = [Pose(*pose) for pose in present['track'].tolist()]
        self._track.extend(zip(present['track_ns'].tolist(), poses, strict=True))

    def _pose_at(self, stamp_ns: int) -> Pose | None:
        """Return the odometry pose at a stamp, interpolated between messages; None if unknown."""
        after = None
        for at_ns, pose in reversed(self._track):
            if at_ns <= stamp_ns:
                if after is None or at_ns == stamp_ns:
                    return pose
                share = (stamp_ns - at_ns) / (after[0] - at_ns)
                x, y, heading = composed(inverse(pose), after[1])
                return composed(pose, Pose(share * x, share * y, share * heading))
            after = at_ns, pose
        return None


def _located_in_target(
    reference: NDArray[np.float32] | None, points: NDArray[np.float64], view: Pose,
    expected: Pose | None, variance_m2: float,
) -> Alignment | None:
    """Return the robot's pose in the frame of a recognised experience; None: use the view.

    The prior of the alignment is the pose on the map, which is accurate shortly after another
    recognition, if the view agrees and its variance is larger. The two are not fused, because the
    views of a stretch are all recognised equally far ahead of their places, and the map would
    follow them. Directions that the scans do not constrain keep the prior. Without an alignment
    the result is the pose on the map, if it is the prior and the headings agree as well.

    Args:
        reference: (n, 2) m, scan of the experience; None if there is none.
        points: (m, 2) m, scan in the robot's frame.
        view: pose in the frame of the experience according to the view.
        expected: pose in the frame of the experience according to the map; None if unknown.
        variance_m2: largest variance of the robot's position on the map.
    """
    prior, variance = view, VIEW_SD_M**2
    known: Alignment | None = None
    if expected is not None:
        map_variance = MAP_SD_M**2 + variance_m2
        away_m = math.hypot(expected.x_m, expected.y_m)
        turned_rad = wrap(expected.heading_rad - view.heading_rad)
        near = away_m < FUSION_GATE_SD * math.sqrt(map_variance + variance)
        if near and map_variance < variance:
            prior, variance = expected._replace(heading_rad=view.heading_rad), map_variance
            if abs(turned_rad) < FUSION_GATE_SD * PRIOR_SD_RAD:
                known = Alignment(expected, isotropic(math.sqrt(variance), PRIOR_SD_RAD))
    found = None
    if reference is not None:
        found = align(reference, points, prior, math.sqrt(variance))
    return known if found is None else found


def _near_points(scan: Scan, pose: Pose) -> NDArray[np.float64]:
    """Return the (n, 2) near points in m of a scan, in the parent frame of the robot's pose."""
    points = points_of(scan)
    return transformed(points[np.hypot(points[:, 0], points[:, 1]) < MAX_RANGE_M], pose)


def transformed(points: NDArray[np.float64], pose: Pose) -> NDArray[np.float64]:
    """Transform (n, 2) points from the frame of a pose into the parent frame of that pose."""
    c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    x, y = points.T
    return np.stack([c * x - s * y + pose.x_m, s * x + c * y + pose.y_m], axis=1)
