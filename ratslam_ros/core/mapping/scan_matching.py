# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scan alignment: laser scans, map actions -> where in an experience's frame the robot is.

A view is recognised up to a metre from where it was learned, and all that the camera then
tells is which one it is. Two scans taken there say how the robot stands to that place. Not in the
papers; off by default.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.scan import Scan, points_of
from ratslam_ros.core.common.state import State
from ratslam_ros.core.pose_cells.map_action import MapAction

REMEMBERED_NS = 2_000_000_000
"""Scans and poses are kept for so long, until the actions of their time have come."""

FRESH_NS = 300_000_000
"""A scan that was taken longer before an action says nothing about it."""

FURTHEST_M = 8.0
"""Points further away are left out: there beams are too far apart."""

ROUNDS = 15
REACH_M = (0.8, 0.15)
"""Points are compared with the nearest line within this, at first and in the end."""

POINT_SD_M, GUESS_SD_RAD = 0.05, math.radians(6.0)
VIEW_SD_M, MOTION_SD_M = 0.4, 0.05
"""What is known beforehand: how exact beams are, how far from a place its view is known, and how
far off the odometry is between two experiences. Along a bare corridor nothing else decides."""

MAP_SD_M, DRIFT_M2_PER_M = 0.1, 0.003
"""How far off two places nearby are on the map, and the variance that each metre of way adds."""

SURPRISE_SD = 3.0
"""Where view and map differ by more of their standard deviations the map is wrong."""

ALIKE = 30.0
"""Beams err alike where a wall is rough or somebody stands: so many count as one."""

FIT_M, LEAST_SHARE, LEAST_POINTS = 0.1, 0.7, 40
"""So close to a line so many of the points must lie in the end, or it is another place."""

SURE_M, SAME_M = 0.1, 0.5
"""So exactly scans must tell where the robot is, and so near to where it believes to be, to say
that it is there. Along a bare corridor they cannot."""

LINE_M = 0.5
"""Neighbouring points no further apart make a line."""


class ScanMatch(NamedTuple):
    """Where the robot is in the frames of two experiences, None where motion or view tell best."""

    from_current: Pose | None = None
    from_target: Pose | None = None
    fits: Callable[[int, Pose], bool] | None = None
    """Whether the robot stands so to an experience; None: there was no scan to tell."""


class ScanMatcher:
    """Keeps the scan of each experience; aligns later ones with it."""

    def __init__(self) -> None:
        self._scans: deque[tuple[int, NDArray[np.float64]]] = deque()
        self._track: deque[tuple[int, Pose]] = deque()
        self._here = Pose(0.0, 0.0, 0.0)
        self._kept: dict[int, NDArray[np.float32]] = {}
        self._variance_m2 = self._variance_before_m2 = math.inf
        """Of where the robot is on the map, in the direction that is known least; and the same
        before the last action."""

    def scan(self, scan: Scan) -> None:
        """Take one scan; where stamps jump back those before are forgotten."""
        if self._scans and scan.stamp_ns < self._scans[-1][0]:
            self.restart()
        self._scans.append((scan.stamp_ns, points_of(scan)))
        while self._scans[-1][0] - self._scans[0][0] > REMEMBERED_NS:
            self._scans.popleft()

    def integrate(self, stamp_ns: int, motion: Motion) -> None:
        """Take one motion; ``stamp_ns``: of its end."""
        self._here = moved(self._here, motion)
        self._variance_m2 += DRIFT_M2_PER_M * abs(motion.distance_m)
        self._track.append((stamp_ns, self._here))
        while self._track[-1][0] - self._track[0][0] > REMEMBERED_NS:
            self._track.popleft()

    def restart(self) -> None:
        """Forget what was seen of late, where the robot has been carried; places are kept."""
        self._scans.clear()
        self._track.clear()
        self._variance_m2 = self._variance_before_m2 = math.inf

    def refused(self) -> None:
        """Take note that the map did not believe the last action: the robot is where it was."""
        self._variance_m2 = self._variance_before_m2

    def locate(
        self, stamp_ns: int, action: MapAction, current_id: int, offset: Pose,
        expected: Pose | None = None,
    ) -> ScanMatch:  # fmt: skip
        """Tell how the robot stands to the experience that it comes from, and to the action's.

        The scan at a new experience is kept.

        Args:
            stamp_ns: of the action.
            action: what the map is about to do.
            current_id, offset: where the map has the robot.
            expected: the same, in the frame of the action's experience; None: the map cannot tell.
        """
        if action.action == 'none':
            return ScanMatch()
        points = self._seen_at(stamp_ns)
        before, there = self._kept.get(current_id), self._kept.get(action.target_id)
        view = Pose(0.0, 0.0, action.relative_rad)
        if action.action == 'create':
            there = None
            self._kept.pop(action.target_id, None)
            if points is not None:
                self._kept[action.target_id] = _placed(points, view).astype(np.float32)
        self._variance_before_m2 = self._variance_m2
        if points is None:  # then the map does what it does without a laser
            if action.action != 'create':
                self._variance_m2 = VIEW_SD_M**2
            return ScanMatch()
        return ScanMatch(
            None if before is None else align(before, points, offset, MOTION_SD_M),
            None if action.action == 'create'
            else self._recognised(there, points, view, expected),
            partial(self._fits, points),
        )  # fmt: skip

    def _fits(self, points: NDArray[np.float64], experience_id: int, pose: Pose) -> bool:
        """Return whether points tell, in every direction, that they are seen from a pose."""
        place = self._kept.get(experience_id)
        found = None if place is None else _aligned(place, points, pose, VIEW_SD_M)
        if found is None:
            return False
        at, variance_m2 = found
        return (
            variance_m2 < SURE_M**2 and math.dist(at[:2], pose[:2]) < SAME_M
            and abs(wrap(at.heading_rad - pose.heading_rad)) < GUESS_SD_RAD * SURPRISE_SD
        )  # fmt: skip

    def _recognised(
        self, place: NDArray[np.float32] | None, points: NDArray[np.float64], view: Pose,
        expected: Pose | None,
    ) -> Pose | None:  # fmt: skip
        """Return where at a recognised place the robot is; None: nothing but the view tells.

        What scans leave open, as along a bare corridor, view and map tell together: a view is
        known from afar, but where the robot was at a known place a moment ago it still knows.
        """
        guess, variance = view, VIEW_SD_M**2
        known: Pose | None = None
        if expected is not None:
            of_map = MAP_SD_M**2 + self._variance_m2
            away_m = math.hypot(expected.x_m, expected.y_m)
            turned_rad = wrap(expected.heading_rad - view.heading_rad)
            near = away_m < SURPRISE_SD * math.sqrt(of_map + variance) < math.inf
            if near:
                share = variance / (of_map + variance)
                x_m, y_m = share * expected.x_m, share * expected.y_m
                guess = Pose(x_m, y_m, view.heading_rad)
                variance *= 1.0 - share
                if abs(turned_rad) < SURPRISE_SD * GUESS_SD_RAD:
                    known = Pose(x_m, y_m, wrap(view.heading_rad + share * turned_rad))
        if place is not None:
            found = _aligned(place, points, guess, math.sqrt(variance))
            if found is not None:
                pose, self._variance_m2 = found
                return pose
        self._variance_m2 = VIEW_SD_M**2 if known is None else variance
        return known

    def state(self) -> State:
        """Return the scans of all experiences, for ``restore``."""
        scans = list(self._kept.values())
        return {
            'ids': np.array(list(self._kept), np.int64),
            'sizes': np.array([len(points) for points in scans], np.int64),
            'points': np.concatenate(scans) if scans else np.empty((0, 2), np.float32),
        }

    def restore(self, state: State) -> None:
        """Take what ``state`` gave in place of all that is kept."""
        ends = np.cumsum(state['sizes'])
        scans = np.split(state['points'], ends[:-1]) if len(ends) else []
        self._kept = dict(zip(state['ids'].tolist(), scans, strict=True))
        self.restart()

    def _seen_at(self, stamp_ns: int) -> NDArray[np.float64] | None:
        """Return the points of the last scan before an action, as seen from there."""
        scan = next((s for s in reversed(self._scans) if s[0] <= stamp_ns), None)
        if scan is None or stamp_ns - scan[0] > FRESH_NS:
            return None
        then, now = self._pose_at(scan[0]), self._pose_at(stamp_ns)
        if then is None or now is None:
            return None
        points = scan[1]
        near = points[np.hypot(points[:, 0], points[:, 1]) < FURTHEST_M]
        return _placed(near, composed(inverse(now), then))

    def _pose_at(self, stamp_ns: int) -> Pose | None:
        """Return where the robot was; between two messages it moved evenly."""
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


def _placed(points: NDArray[np.float64], pose: Pose) -> NDArray[np.float64]:
    """Return points, seen from a pose, in the frame that the pose is in."""
    c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    x, y = points.T
    return np.stack([c * x - s * y + pose.x_m, s * x + c * y + pose.y_m], axis=1)


def align(
    place: NDArray[np.floating[Any]], points: NDArray[np.float64], guess: Pose, sd_m: float
) -> Pose | None:
    """Return the pose from which points are seen in another scan's frame.

    Each point is brought onto the line through the nearest of the other scan; what no line tells
    stays as guessed.

    Args:
        place: (n, 2) m, a scan in the order of its beams.
        points: (m, 2) m, the other one, in its robot's frame.
        guess: about the pose.
        sd_m: how far off that may be.

    Returns:
        None where the scans do not fit.
    """
    found = _aligned(place, points, guess, sd_m)
    return None if found is None else found[0]


def _aligned(
    place: NDArray[np.floating[Any]], points: NDArray[np.float64], guess: Pose, sd_m: float
) -> tuple[Pose, float] | None:
    """Return what ``align`` does, and the variance of where that is, along the worse axis."""
    known = np.asarray(place, np.float64)
    x, y, heading, share, variance_m2 = _align(known, points, *guess, sd_m)
    return (Pose(x, y, wrap(heading)), variance_m2) if share >= LEAST_SHARE else None


@compiled
def _align(
    place: NDArray[np.float64], points: NDArray[np.float64], x0: float, y0: float, t0: float,
    sd_m: float,
) -> tuple[float, float, float, float, float]:
    n, m = len(place), len(points)
    if n < LEAST_POINTS or m < LEAST_POINTS:
        return x0, y0, t0, 0.0, sd_m**2
    # The line through each point and its neighbour: its normal, and how far it is from the origin.
    normals = np.zeros((n, 3))
    for k in range(n):
        a, b = max(k - 1, 0), min(k + 1, n - 1)
        d_x, d_y = place[b, 0] - place[a, 0], place[b, 1] - place[a, 1]
        length = math.hypot(d_x, d_y)
        if 0.0 < length < 2 * LINE_M:
            normals[k, 0], normals[k, 1] = -d_y / length, d_x / length
            normals[k, 2] = normals[k, 0] * place[k, 0] + normals[k, 1] * place[k, 1]
    x, y, t = x0, y0, t0
    share = 0.0
    h = np.zeros((3, 3))
    for turn in range(ROUNDS):
        part = turn / (ROUNDS - 1)
        reach = REACH_M[0] * (REACH_M[1] / REACH_M[0]) ** part
        c, s = math.cos(t), math.sin(t)
        # Normal equations of x, y and t, with the guess as a measurement.
        h = np.zeros((3, 3))
        g = np.zeros(3)
        h[0, 0] = h[1, 1] = ALIKE * (POINT_SD_M / sd_m) ** 2
        h[2, 2] = ALIKE * (POINT_SD_M / GUESS_SD_RAD) ** 2
        g[0], g[1], g[2] = h[0, 0] * (x - x0), h[1, 1] * (y - y0), h[2, 2] * (t - t0)
        fitting = 0
        for i in range(m):
            r_x, r_y = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
            p_x, p_y = r_x + x, r_y + y
            nearest, least = -1, reach * reach
            for k in range(n):
                e_x, e_y = place[k, 0] - p_x, place[k, 1] - p_y
                away = e_x * e_x + e_y * e_y
                if away < least:
                    nearest, least = k, away
            if nearest < 0 or (normals[nearest, 0] == 0.0 and normals[nearest, 1] == 0.0):
                continue
            n_x, n_y = normals[nearest, 0], normals[nearest, 1]
            e = n_x * p_x + n_y * p_y - normals[nearest, 2]
            if abs(e) < FIT_M:
                fitting += 1
            weight = 1.0 / (1.0 + (e / POINT_SD_M) ** 2 * 0.25)
            turning = n_x * -r_y + n_y * r_x
            row = (n_x, n_y, turning)
            for a in range(3):
                g[a] += weight * row[a] * e
                for b in range(3):
                    h[a, b] += weight * row[a] * row[b]
        step = np.linalg.solve(h, g)
        x, y, t = x - step[0], y - step[1], t - step[2]
        share = fitting / m
    spread = ALIKE * POINT_SD_M**2 * np.linalg.inv(h)
    middle = 0.5 * (spread[0, 0] + spread[1, 1])
    off = math.hypot(0.5 * (spread[0, 0] - spread[1, 1]), spread[0, 1])
    return x, y, t, share, middle + off
