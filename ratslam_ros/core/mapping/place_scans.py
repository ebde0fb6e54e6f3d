# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stored scans around a pose: alignment of a new scan with them, and agreement.

For the agreement, the stored scans make a small occupancy grid: cells that beams crossed are free,
cells in which they ended are occupied. A beam of another scan matches if it ends near an occupied
cell. It contradicts the place if it crosses an occupied cell, or ends in the middle of free ones.
Beams that end in unseen cells count neither way, so that a robot that looks round a corner
contradicts nothing. Grid and ray model after Moravec and Elfes (1985), without their
probabilities: the scans of one place are few and precise.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.icp import align
from ratslam_ros.core.mapping.scan_matching import ScanMatcher, transformed

AROUND_M, AROUND_COUNT = 2.5, 8
"""Distance and number of the experiences whose scans are expected at a pose."""

SPREAD_M, SPREAD_RAD = 0.4, 0.5
"""Two of these experiences differ by one of these at least."""

VISIT_M, VISIT_COUNT = 30.0, 3
"""Distance driven between two visits to a place, and number of visits that are distinguished."""

KNOWN_SHARE = 0.5
"""Smallest share of beams that end where stored scans saw something, for the rest to count."""

PROVEN_SHARE = 0.9
"""Smallest share of matching beams that proves a pose: 0.9 to 1 at the right one."""

CELL_M = 0.1
"""Side of a cell."""

HALF_CELLS = 100
"""Half of the side of the grid, in cells: the range of scan matching and two metres more."""

TOLERANCE_CELLS = 2
"""Largest distance between the end of a beam and an occupied cell that match."""

CLEARANCE_M = 0.35
"""Part of a beam before its end that neither marks nor crosses cells: beams that touch a wall at
a small angle pass through the cells of the wall."""

_FREE, _OCCUPIED = 1, 2


class Agreement(NamedTuple):
    """Numbers of beams that match a place, contradict it, and end where nothing was seen."""

    matching: int
    contradicting: int
    unknown: int

    @property
    def share(self) -> float:
        """Share of matching beams among those that match or contradict; 1 if there are none."""
        known = self.matching + self.contradicting
        return self.matching / known if known else 1.0

    @property
    def known_share(self) -> float:
        """Share of beams that match or contradict; 0 if there are no beams."""
        known = self.matching + self.contradicting
        return known / (known + self.unknown) if known else 0.0


NO_BEAMS = Agreement(0, 0, 0)
"""Agreement of an empty scan."""


class PlaceGrid:
    """Free and occupied cells around a place."""

    def __init__(
        self, scans: Iterable[tuple[Pose, NDArray[np.floating[Any]]]], x_m: float, y_m: float
    ) -> None:
        """Mark the cells of stored scans.

        Args:
            scans: pose of each scan, and its (n, 2) points in m in the frame of that pose.
            x_m, y_m: centre of the grid.
        """
        self._left_m = x_m - HALF_CELLS * CELL_M
        self._bottom_m = y_m - HALF_CELLS * CELL_M
        self._cells = np.zeros((2 * HALF_CELLS, 2 * HALF_CELLS), np.int8)
        for pose, points in scans:
            seen = np.asarray(points, np.float64)
            _mark(self._cells, seen, *pose, self._left_m, self._bottom_m)

    def agreement(self, points: NDArray[np.float64], pose: Pose) -> Agreement:
        """Compare a scan with the place.

        Args:
            points: (n, 2) m, in the robot's frame.
            pose: of the robot, in the frame of the stored scans' poses.
        """
        return Agreement(*_compared(self._cells, points, *pose, self._left_m, self._bottom_m))


class PlaceScans:
    """Scans of the experiences of one component of the map, by place."""

    def __init__(self, experience_map: ExperienceMap, scan_matcher: ScanMatcher) -> None:
        self._map, self._matcher = experience_map, scan_matcher
        self.component = 0
        """Component of the map whose experiences are used."""
        self.excluded: Collection[int] = ()
        """Experiences that are not used."""

    def aligned(
        self, pose: Pose, points: NDArray[np.float64], sd_m: float
    ) -> tuple[Pose, Agreement] | None:
        """Align a scan with the stored ones around a pose.

        Args:
            pose: expected pose of the robot on the map.
            points: (n, 2) m, in the robot's frame.
            sd_m: standard deviation of the expected position.

        Returns:
            The pose and the agreement of the scan there; None if no alignment is proven.
        """
        for around in self._visits([pose]):
            scans = self._scans(around)
            origin = scans[0][0]
            reference = np.concatenate([
                transformed(scan.astype(np.float64), composed(inverse(origin), at))
                for at, scan in scans
            ])
            found = align(reference, points, composed(inverse(origin), pose), sd_m)
            if found is None:
                continue
            at = composed(origin, found.pose)
            agreement = PlaceGrid(scans, at.x_m, at.y_m).agreement(points, at)
            if is_proven(agreement):
                return at, agreement
        return None

    def agreement(
        self, poses: Sequence[Pose], scans: Sequence[NDArray[np.float64]]
    ) -> Agreement:
        """Compare scans along a path of a few metres with the stored ones.

        If the place was visited several times, the visit that agrees best counts, because their
        scans differ by the drift of the map.

        Args:
            poses: poses of the robot on the map.
            scans: (n, 2) m, points of each scan in the robot's frame.
        """
        best = NO_BEAMS
        middle = poses[len(poses) // 2]
        for around in self._visits([poses[-1], middle, poses[0]]):
            grid = PlaceGrid(self._scans(around), middle.x_m, middle.y_m)
            total = Agreement(*np.sum(list(map(grid.agreement, scans, poses)), axis=0).tolist())
            is_known = total.known_share >= KNOWN_SHARE
            if best == NO_BEAMS or (is_known and (
                best.known_share < KNOWN_SHARE or total.share > best.share
            )):
                best = total
            if is_proven(best):
                break
        return best

    def nearest(self, pose: Pose, most_m: float) -> int | None:
        """Return the nearest experience within a distance of a pose, None if there is none."""
        return next(iter(self._by_distance(pose, most_m)), None)

    def _scans(self, experience_ids: Sequence[int]) -> list[tuple[Pose, NDArray[np.float32]]]:
        return [
            (self._map.pose_of(i), scan) for i in experience_ids
            if (scan := self._matcher.reference(i)) is not None
        ]

    def _visits(self, poses: Sequence[Pose]) -> Iterator[list[int]]:
        """Return the experiences around poses that have scans: all, then those of each visit."""
        graph = self._map
        rank: dict[int, int] = {}
        for pose in dict.fromkeys(poses):
            for i in self._by_distance(pose, AROUND_M):
                if self._matcher.reference(i) is not None:
                    rank.setdefault(i, len(rank))
        if not rank:
            return
        most = AROUND_COUNT * len(set(poses))
        yield self._spread(list(rank), most)
        visits: list[list[int]] = []
        last_m = -math.inf
        for i in sorted(rank, key=graph.created_at_m):
            if graph.created_at_m(i) - last_m > VISIT_M:
                visits.append([])
            visits[-1].append(i)
            last_m = graph.created_at_m(i)
        if len(visits) > 1:
            visits.sort(key=lambda visit: min(map(rank.__getitem__, visit)))
            for visit in visits[:VISIT_COUNT]:
                yield self._spread(sorted(visit, key=rank.__getitem__), most)

    def _spread(self, experience_ids: Sequence[int], most: int) -> list[int]:
        """Return the first experiences of a list, without those close to others before them."""
        chosen: dict[int, Pose] = {}
        for i in experience_ids:
            pose = self._map.pose_of(i)
            if all(
                math.dist(pose[:2], other[:2]) > SPREAD_M
                or abs(wrap(pose.heading_rad - other.heading_rad)) > SPREAD_RAD
                for other in chosen.values()
            ):
                chosen[i] = pose
                if len(chosen) == most:
                    break
        return list(chosen)

    def _by_distance(self, pose: Pose, most_m: float) -> list[int]:
        """Return the experiences near a pose, the nearest first."""
        graph = self._map
        poses = graph.poses
        away_m = np.hypot(poses[:, 0] - pose.x_m, poses[:, 1] - pose.y_m)
        near = np.flatnonzero(away_m < most_m)
        order: list[int] = near[np.argsort(away_m[near], kind='stable')].tolist()
        return [
            i for i in order
            if i not in self.excluded and graph.component_of(i) == self.component
        ]


def is_proven(agreement: Agreement) -> bool:
    """Return whether scans prove a pose."""
    return agreement.share >= PROVEN_SHARE and agreement.known_share >= KNOWN_SHARE


@compiled
def _mark(
    cells: NDArray[np.int8], points: NDArray[np.float64], x: float, y: float, heading: float,
    left_m: float, bottom_m: float,
) -> None:
    """Mark the cells of a scan: those that were ever occupied are occupied."""
    side = len(cells)
    c, s = math.cos(heading), math.sin(heading)
    for i in range(len(points)):
        d_x = c * points[i, 0] - s * points[i, 1]
        d_y = s * points[i, 0] + c * points[i, 1]
        length = math.hypot(d_x, d_y)
        for k in range(int((length - CLEARANCE_M) / (0.5 * CELL_M))):
            part = k * 0.5 * CELL_M / length
            column = math.floor((x + part * d_x - left_m) / CELL_M)
            row = math.floor((y + part * d_y - bottom_m) / CELL_M)
            if 0 <= column < side and 0 <= row < side and cells[row, column] != _OCCUPIED:
                cells[row, column] = _FREE
        column = math.floor((x + c * points[i, 0] - s * points[i, 1] - left_m) / CELL_M)
        row = math.floor((y + s * points[i, 0] + c * points[i, 1] - bottom_m) / CELL_M)
        if 0 <= column < side and 0 <= row < side:
            cells[row, column] = _OCCUPIED


@compiled
def _compared(
    cells: NDArray[np.int8], points: NDArray[np.float64], x: float, y: float, heading: float,
    left_m: float, bottom_m: float,
) -> tuple[int, int, int]:
    """Return the numbers of matching, contradicting and other beams."""
    side = len(cells)
    c, s = math.cos(heading), math.sin(heading)
    matching = contradicting = 0
    for i in range(len(points)):
        d_x = c * points[i, 0] - s * points[i, 1]
        d_y = s * points[i, 0] + c * points[i, 1]
        length = math.hypot(d_x, d_y)
        crosses = False
        for k in range(int((length - CLEARANCE_M) / (0.5 * CELL_M))):
            part = k * 0.5 * CELL_M / length
            column = math.floor((x + part * d_x - left_m) / CELL_M)
            row = math.floor((y + part * d_y - bottom_m) / CELL_M)
            if 0 <= column < side and 0 <= row < side and cells[row, column] == _OCCUPIED:
                crosses = True
                break
        if crosses:
            contradicting += 1
            continue
        column = math.floor((x + d_x - left_m) / CELL_M)
        row = math.floor((y + d_y - bottom_m) / CELL_M)
        if not (0 <= column < side and 0 <= row < side):
            continue
        if _is_near_occupied(cells, row, column):
            matching += 1
        elif cells[row, column] == _FREE:
            contradicting += 1
    return matching, contradicting, len(points) - matching - contradicting


@compiled
def _is_near_occupied(cells: NDArray[np.int8], row: int, column: int) -> bool:
    side = len(cells)
    for i in range(max(row - TOLERANCE_CELLS, 0), min(row + TOLERANCE_CELLS + 1, side)):
        for j in range(max(column - TOLERANCE_CELLS, 0), min(column + TOLERANCE_CELLS + 1, side)):
            near = (i - row) ** 2 + (j - column) ** 2 <= TOLERANCE_CELLS**2
            if near and cells[i, j] == _OCCUPIED:
                return True
    return False
