# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A synthetic run for tests and benchmarks of the viewer: records without any RatSLAM."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.map_changes import ExperienceRows, LinkRows, MapChange
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.history.records import (
    CellsRecord,
    PoseRecord,
    Record,
    RouteRecord,
    ScanRecord,
    StatusRecord,
    ViewRecord,
)
from ratslam_ros.history.run_state import RunState

START_NS = 1_700_000_000_000_000_000
VIEW_NS = 100_000_000
SPACING_M = 0.25
DIMS = (25, 25, 36)
THRESHOLD = 0.05
WALL = 'left_wall'


def course(n: int) -> NDArray[np.float64]:
    """Return (n, 3) poses ``SPACING_M`` apart on a curve that crosses itself many times."""
    length = n * SPACING_M
    radius = max(2.0, math.sqrt(length / 3.0))
    angles = np.linspace(0.0, length / radius, 20 * n)
    r = radius * (1.0 + 0.25 * np.sin(3.1 * angles) + 0.15 * np.sin(0.71 * angles))
    x, y = r * np.cos(angles), r * np.sin(angles)
    driven = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
    at = np.linspace(0.0, driven[-1], n)
    x, y = np.interp(at, driven, x), np.interp(at, driven, y)
    return np.stack([x, y, np.arctan2(np.gradient(y), np.gradient(x))], 1)


class SyntheticRun:
    """A drive of n experiences with loop closures wherever the course crosses itself.

    ``records()`` yields what the drive reports, ``state()`` their sum. ``step()`` continues the
    drive by one view; ``close()`` closes a loop that moves every experience by a smooth warp.
    """

    def __init__(self, n: int = 300, seed: int = 0) -> None:
        self._random = np.random.default_rng(seed)
        self._room = 2 * n + 500
        self.poses = course(self._room)
        self.count = 0
        self.stamp_ns = START_NS
        self._n = n
        self.closures: list[tuple[int, int]] = []

    def records(self) -> Iterator[Record]:
        """Yield the records of the drive of n experiences; the map comes whole at the end."""
        for _ in range(self._n):
            yield from self._drive(whole=True)
        yield self.whole_map()
        yield from self.cells()

    def state(self) -> RunState:
        """Return the state after all records of ``records``."""
        state = RunState()
        for record in self.records():
            state.apply(record)
        return state

    def step(self) -> list[Record]:
        """Return the records of one more view and the odometry around it."""
        return [*self._drive(whole=False), *self.cells()]

    def close(self) -> list[Record]:
        """Return the records of a loop closure after which every experience has moved."""
        n = self.count
        self.poses[:, :2] += 0.2 * np.sin(0.1 * self.poses[:, 1::-1] + self._random.uniform(0, 6))
        source, target = n - 1, n // 3
        self.closures.append((source, target))
        self.stamp_ns += VIEW_NS
        view = self._view(target, 'link', source)
        rows = self._experiences(np.arange(n))
        links = self._links(np.array([[source, target]]), recognised=True)
        return [view, MapChange(self.stamp_ns, n, target, False, rows, links)]

    def reject(
        self, reason: str = 'displacement of 6.2 m exceeds the drift of 1.5 m'
    ) -> ViewRecord:
        """Return a view that would have closed a loop but for a reason."""
        self.stamp_ns += VIEW_NS
        return self._view(self.count // 2, 'link', self.count - 1, reason)

    def whole_map(self) -> MapChange:
        """Return the change that makes an empty map equal to that of the drive."""
        n = self.count
        ends = np.stack([np.arange(n - 1), np.arange(1, n)], 1)
        driven = self._links(ends)
        self.closures = self._crossings()
        closing = self._links(np.array(self.closures, np.int64).reshape(-1, 2), recognised=True)
        links = LinkRows(
            *(np.concatenate([getattr(driven, name), getattr(closing, name)])
              for name in ('ends', 'shapes', 'durations_s', 'confidences', 'counts',
                           'recognised')),
            driven.behaviours + closing.behaviours,
        )
        return MapChange(self.stamp_ns, n, n - 1, True, self._experiences(np.arange(n)), links)

    def cells(self) -> list[Record]:
        """Return the pose cells: two packets that compete, and one injection."""
        x, y, heading = self.poses[self.count - 1]
        planes = heading / (2 * math.pi) * DIMS[2]
        first = np.array([x / 0.5 % DIMS[0], y / 0.5 % DIMS[1], planes % DIMS[2]])
        second = (first + np.array([9.0, -6.0, 11.0])) % DIMS
        cells, activity, packets = [], [], []
        for peak, share in ((first, 0.7), (second, 0.3)):
            offsets = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3, indexing='ij'), -1)
            offsets = offsets.reshape(-1, 3)
            where = (np.floor(peak).astype(int) + offsets) % DIMS
            values = np.exp(-0.7 * (offsets**2).sum(1))
            values *= share / values.sum()
            keep = values > 1e-3
            cells.append(where[keep])
            activity.append(values[keep])
            packets.append([*np.floor(peak), share])
        return [
            CellsRecord(
                self.stamp_ns, DIMS, np.concatenate(cells),
                np.concatenate(activity).astype(np.float32), np.array(packets, np.float32),
                np.array([[*second, 0.1]], np.float32),
            )
        ]

    def goals(self) -> list[Record]:
        """Return a scan, a route to a goal, and the status that names the goals."""
        angles = np.linspace(-2.0, 2.0, 120)
        points = 2.0 * np.stack([np.cos(angles), np.sin(angles)], 1)
        goal = self.poses[self.count // 2]
        payload = {
            'schema_version': 1, 'status': 'following', 'goal': {'x_m': goal[0], 'y_m': goal[1]},
            'stamp': {'sec': 1, 'nanosec': 0}, 'explore': False, 'reason': '', 'experience_id': 40,
            'neighbours': [], 'remaining_s': 18.5, 'switched': 0, 'replanned': 1, 'outcomes': [],
            'queue': [{'number': 3, 'goal': 'kitchen', 'status': 'active', 'reason': ''}],
        }
        return [
            ScanRecord(self.stamp_ns, points),
            RouteRecord(self.stamp_ns, self.poses[self.count // 2 : self.count, :2][::-1]),
            StatusRecord(self.stamp_ns, json.dumps(payload)),
        ]

    def _drive(self, whole: bool) -> Iterator[Record]:
        self.stamp_ns += VIEW_NS
        n = self.count
        self.count += 1
        x, y, heading = self.poses[n].tolist()
        drift = 1.0 + 0.02 * math.sin(0.001 * n)
        yield PoseRecord(
            self.stamp_ns, Pose(x, y, heading), Pose(x * drift + 0.002 * n, y * drift, heading),
            Pose(x + 0.1, y - 0.1, heading),
        )
        yield self._view(n, 'create', n - 1)
        if not whole:
            first = max(0, n - 3)
            ends = np.stack([np.arange(first, n), np.arange(first + 1, n + 1)], 1)
            yield MapChange(
                self.stamp_ns, n + 1, n, False, self._experiences(np.arange(first, n + 1)),
                self._links(ends),
            )

    def _view(self, target: int, action: str, source: int, reason: str = '') -> ViewRecord:
        error = 0.02 + 0.04 * abs(math.sin(0.05 * target))
        return ViewRecord(
            self.stamp_ns, target, action == 'create', error, THRESHOLD, 0.0, action,  # type: ignore[arg-type]
            source, target, Place(1.0, 1.0, 1.0), target if reason else -1, 0.5, reason,
        )

    def _experiences(self, ids: NDArray[np.int64]) -> ExperienceRows:
        return ExperienceRows(ids, ids, self.poses[ids], np.zeros_like(ids))

    def _links(self, ends: NDArray[np.int64], recognised: bool = False) -> LinkRows:
        n = len(ends)
        source, target = self.poses[ends[:, 0], :2], self.poses[ends[:, 1], :2]
        distances = np.hypot(*(target - source).T)
        return LinkRows(
            ends, np.stack([distances, np.zeros(n), np.zeros(n)], 1), distances / 0.5,
            0.5 + 0.5 * np.cos(0.01 * ends[:, 0]), np.ones(n, np.int64),
            np.full(n, recognised), tuple(WALL if k // 100 % 2 else '' for k in ends[:, 0]),
        )

    def _crossings(self) -> list[tuple[int, int]]:
        """Return pairs of experiences that are close to each other on the map only."""
        pairs = cKDTree(self.poses[: self.count, :2]).query_pairs(
            0.5 * SPACING_M, output_type='ndarray'
        )
        far = pairs[pairs[:, 1] - pairs[:, 0] > 40]
        return [(int(b), int(a)) for a, b in far[np.argsort(far[:, 1])]]
