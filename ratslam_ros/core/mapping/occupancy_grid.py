# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Occupancy grid: the scans of all experiences at their present poses on the map.

The grid is a picture of the map for other programs; nothing is computed from it. When the map is
corrected, scans are removed from where they were and added where they are now, a few at a time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.occupancy import HIGHEST, HIT, LOWEST, MISS, Picture
from ratslam_ros.core.mapping.scan_matching import MAX_RANGE_M, ScanMatcher

CELL_M = 0.05
"""Size of a cell in m, that of the maps of Nav2: narrow passages are visible."""

ROWS = 64
"""Rows of the picture that are written in one step: 0.5 ms at the full width."""

MOVED_RAD = 0.01
"""Rotation at which a scan is drawn again; it moves points at 5 m by a cell of 0.05 m."""

CHECKED = 512
"""Number of experiences in each step whose scans are compared with those that were drawn."""

LIMIT_CELLS = 2048
"""Cells of a grid along each axis; a power of two. The cell (x, y) of the map is kept as cell
(x % LIMIT_CELLS, y % LIMIT_CELLS), so that the grid can grow to all sides."""

_MASK = LIMIT_CELLS - 1
_TILE_BITS, _TILE_MASK = 6, 63
_ROW_BITS = 11 - _TILE_BITS


class OccupancyGrid:
    """Counts, for each cell, the scans that end in it and that pass it."""

    def __init__(self, cell_m: float = CELL_M) -> None:
        """Create an empty grid.

        Args:
            cell_m: size of a cell. It doubles whenever the map is longer than ``LIMIT_CELLS``, so
                that memory and messages stay bounded.
        """
        self.cell_m = cell_m
        self.has_changed = False
        """Whether the last update has changed anything."""
        self._clear()

    def _clear(self) -> None:
        cells = LIMIT_CELLS * LIMIT_CELLS
        # Memory of zeros is only taken when it is written.
        self._hits, self._misses = np.zeros(cells, np.int32), np.zeros(cells, np.int32)
        self._marks, self._mark = np.zeros(cells, np.int32), 0
        self._drawn: dict[int, tuple[Pose, NDArray[np.float32]]] = {}
        self._poses = np.empty((0, 3))
        self._bounds: tuple[int, int, int, int] | None = None
        self._next = 0

    def update(self, graph: ExperienceMap, scans: ScanMatcher, count: int) -> int:
        """Draw up to a number of scans that are new or have moved, or remove ones that are gone.

        Only the component of the map in which the robot is is drawn: where the others are relative
        to it is unknown.

        Args:
            graph: the map.
            scans: scans of its experiences.
            count: largest number of scans to draw.

        Returns:
            Number of scans that are still to be drawn, as far as known.
        """
        stale = self._stale(graph, scans)
        self.has_changed = False
        for experience_id in stale[:count]:
            drawn = self._drawn.pop(experience_id, None)
            if drawn is not None:
                self.has_changed = True
                self._cast(-1, *drawn)
            points, pose = scans.reference(experience_id), graph.pose_of(experience_id)
            self._poses[experience_id] = pose
            if points is None or self._is_apart(graph, experience_id):
                continue
            if not self._make_room(pose):
                return len(graph)
            self.has_changed = True
            self._drawn[experience_id] = pose, points
            low_x, low_y, high_x, high_y = bounds = self._cast(1, pose, points)
            a, b, c, d = self._bounds or bounds
            self._bounds = min(low_x, a), min(low_y, b), max(high_x, c), max(high_y, d)
        return max(len(stale) - count, 0)

    @property
    def is_empty(self) -> bool:
        """Whether no scan was ever drawn."""
        return self._bounds is None

    def picture(self) -> Iterator[Picture]:
        """Yield the picture while its rows are written, and last when it is complete."""
        if self._bounds is None:
            yield Picture(0.0, 0.0, self.cell_m, np.empty((0, 0), np.int8))
            return
        x, y, high_x, high_y = self._bounds
        percent = np.empty((high_y - y + 1, high_x - x + 1), np.int8)
        whole = Picture(x * self.cell_m, y * self.cell_m, self.cell_m, percent)
        for row in range(0, len(percent), ROWS):
            _write_rows(self._hits, self._misses, x, y + row, percent[row : row + ROWS])
            yield whole

    def _stale(self, graph: ExperienceMap, scans: ScanMatcher) -> list[int]:
        """Return the ids of experiences that are not drawn as they are, ascending."""
        poses, count = graph.poses, len(graph)
        if len(self._poses) < count:
            grown = np.full((max(2 * len(self._poses), count, 64), 3), np.nan)
            grown[: len(self._poses)] = self._poses
            self._poses = grown
        moved = np.abs(poses - self._poses[:count])
        moved[:, 2] = np.minimum(moved[:, 2], math.tau - moved[:, 2])
        limits = 0.5 * self.cell_m, 0.5 * self.cell_m, MOVED_RAD
        # Positions of experiences that were never drawn are NaN, which is not within any limit.
        found = set(np.flatnonzero(~(moved <= limits).all(axis=1)).tolist())
        # New scans and components do not change a pose: compare some experiences in each step.
        ids = range(self._next, min(self._next + CHECKED, count))
        self._next = ids.stop if ids.stop < count else 0
        for i in ids:
            drawn = self._drawn.get(i)
            wanted = None if self._is_apart(graph, i) else scans.reference(i)
            if (drawn and drawn[1]) is not wanted:
                found.add(i)
        return sorted(found)

    def _is_apart(self, graph: ExperienceMap, experience_id: int) -> bool:
        current = graph.current_id
        return current >= 0 and graph.component_of(experience_id) != graph.component_of(current)

    def _cast(
        self, sign: int, pose: Pose, points: NDArray[np.float32]
    ) -> tuple[int, int, int, int]:
        self._mark += 1
        # The scans of a loaded map are parts of arrays that cannot be written, another type.
        points = np.array(points, np.float32)
        bounds: tuple[int, int, int, int] = _cast_scan(
            self._hits, self._misses, self._marks, self._mark, sign,
            (pose.x_m, pose.y_m, pose.heading_rad), points, self.cell_m, MAX_RANGE_M,
        )
        return bounds

    def _make_room(self, pose: Pose) -> bool:
        """Return whether a scan fits; otherwise begin again with cells of twice the size."""
        around = math.ceil(MAX_RANGE_M / self.cell_m) + 1
        x, y = math.floor(pose.x_m / self.cell_m), math.floor(pose.y_m / self.cell_m)
        a, b, c, d = self._bounds or (x, y, x, y)
        width = max(c, x + around) - min(a, x - around)
        height = max(d, y + around) - min(b, y - around)
        if max(width, height) < LIMIT_CELLS:
            return True
        self.cell_m *= 2.0
        self._clear()
        return False


@compiled
def _index(x: int, y: int) -> int:
    """Return where a cell is kept: in tiles of 64 x 64, as a scan touches memory of few tiles."""
    column, row = x & _MASK, y & _MASK
    tile = ((row >> _TILE_BITS) << _ROW_BITS) | (column >> _TILE_BITS)
    return (tile << (2 * _TILE_BITS)) | ((row & _TILE_MASK) << _TILE_BITS) | (column & _TILE_MASK)


@compiled
def _cast_scan(
    hits: NDArray[np.int32], misses: NDArray[np.int32], marks: NDArray[np.int32], mark: int,
    sign: int, pose: tuple[float, float, float], points: NDArray[np.float32], cell_m: float,
    range_m: float,
) -> tuple[int, int, int, int]:
    """Add a scan to the counts of the cells, or remove it; each cell counts once.

    Args:
        hits, misses: numbers of scans that end in each cell, and that pass it, of
            LIMIT_CELLS * LIMIT_CELLS cells; changed.
        marks: last scan that has changed each cell; changed.
        mark: number of this scan, above all in ``marks``.
        sign: 1 to add the scan, -1 to remove it.
        pose: x and y in m, and heading in rad.
        points: (n, 2) end points of the beams in m in the frame of the pose.
        cell_m: size of a cell.
        range_m: length of a beam after which it is ignored.

    Returns:
        Smallest x and y, and largest x and y, of the cells that were changed.
    """
    x_m, y_m, heading = pose
    cos, sin = math.cos(heading), math.sin(heading)
    from_x, from_y = math.floor(x_m / cell_m), math.floor(y_m / cell_m)
    low_x = high_x = from_x
    low_y = high_y = from_y
    ends = np.empty((len(points), 2), np.int64)
    for i in range(len(points)):
        a, b = float(points[i, 0]), float(points[i, 1])
        length = math.sqrt(a * a + b * b)
        is_end = length < range_m
        scale = 1.0 if is_end else range_m / length
        ends[i, 0] = math.floor((x_m + (cos * a - sin * b) * scale) / cell_m)
        ends[i, 1] = math.floor((y_m + (sin * a + cos * b) * scale) / cell_m)
        low_x, high_x = min(low_x, ends[i, 0]), max(high_x, ends[i, 0])
        low_y, high_y = min(low_y, ends[i, 1]), max(high_y, ends[i, 1])
        at = _index(ends[i, 0], ends[i, 1])
        if is_end and marks[at] != mark:
            marks[at] = mark
            hits[at] += sign
    for i in range(len(points)):
        x, y = from_x, from_y
        d_x, d_y = abs(ends[i, 0] - x), abs(ends[i, 1] - y)
        step_x = 1 if ends[i, 0] > x else -1
        step_y = 1 if ends[i, 1] > y else -1
        error = d_x - d_y  # Bresenham's line (1965)
        while x != ends[i, 0] or y != ends[i, 1]:
            at = _index(x, y)
            if marks[at] != mark:
                marks[at] = mark
                misses[at] += sign
            twice = 2 * error
            if twice > -d_y:
                error -= d_y
                x += step_x
            if twice < d_x:
                error += d_x
                y += step_y
    return low_x, low_y, high_x, high_y


@compiled
def _write_rows(
    hits: NDArray[np.int32], misses: NDArray[np.int32], x: int, y: int, out: NDArray[np.int8]
) -> None:
    """Write the probabilities that cells are occupied, in percent; -1 if they were never seen.

    Args:
        hits, misses: counts of the cells.
        x, y: cell of ``out[0, 0]``.
        out: (rows, columns); changed.
    """
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            at = _index(x + k, y + i)
            hit, miss = hits[at], misses[at]
            if hit + miss == 0:
                out[i, k] = -1
            else:
                odds = min(max(hit * HIT + miss * MISS, LOWEST), HIGHEST)
                out[i, k] = np.int8(round(100.0 / (1.0 + math.exp(-odds))))
