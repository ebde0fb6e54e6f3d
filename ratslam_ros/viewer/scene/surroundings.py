# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The grid, and the camera's distance, on which the size of marks depends."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.history.run_state import RunState
from ratslam_ros.viewer.scene.nodes import Canvas, Labels, Lines
from ratslam_ros.viewer.scene.palette import mixed

Reals = NDArray[np.float64]

FIELD_OF_VIEW = math.radians(45.0)
"""Vertical field of view: less perspective than viser's 75 degrees, so that the map looks flat."""

LEAST_SIDE_M = 8.0
"""Least side of the framed area, in m."""

GROWTH = 1.25
"""Factor by which the framed area grows, so that it changes rarely while the map grows."""

GRID_LINES = 12
"""Approximate number of grid lines along the framed area."""

SLANT = 0.02
"""Deviation of the start view from straight down, as a share of the distance. Straight down, the
camera's orientation would be undefined."""


class Bounds:
    """The area of the map, in steps."""

    def __init__(self) -> None:
        self.centre = np.zeros(2)
        self.side_m = LEAST_SIDE_M
        self.version = 0
        """Counter that grows with every change."""

    def include(self, state: RunState) -> None:
        """Grow until everything of a state is inside, by at least ``GROWTH``."""
        parts = [state.map.poses[:, :2]]
        # Not dead reckoning: it drifts without bound, and the map would become small.
        for trail in state.trail, state.truth:
            parts.append(trail.points_m[-1:])
        half = 0.5 * self.side_m
        # Comparisons with NaN, which unknown poses have, are false.
        if not any((np.abs(part - self.centre) > half).any() for part in parts):
            return
        points = np.concatenate(parts)
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            return
        low, high = points.min(axis=0), points.max(axis=0)
        self.centre = (low + high) / 2
        side_m = float((high - low).max())
        while self.side_m < 1.05 * side_m:
            self.side_m *= GROWTH
        self.version += 1


def grid_step(side_m: float) -> float:
    """Return the distance of grid lines in m: 1, 2 or 5 times a power of 10."""
    power = 10.0 ** math.floor(math.log10(side_m / GRID_LINES))
    return min(
        (power * step for step in (1, 2, 5, 10)),
        key=lambda step: abs(math.log(side_m / GRID_LINES / step)),
    )


class GridDrawing:
    """A grid with the distances in metres."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        self._path = canvas.layer('grid', -0.05)
        self._lines = Lines(canvas, f'{self._path}/lines')
        self._labels = Labels(canvas, f'{self._path}/metres')
        self._key: object = None

    def draw(self, bounds: Bounds) -> None:
        """Draw the grid of an area, with some room around it."""
        theme = self._canvas.theme
        if self._key == (bounds.version, theme.background):
            return
        self._key = bounds.version, theme.background
        step = grid_step(bounds.side_m)
        low = np.floor((bounds.centre - 0.6 * bounds.side_m) / step).astype(int)
        high = np.ceil((bounds.centre + 0.6 * bounds.side_m) / step).astype(int)
        lines, tints, texts = [], [], []
        strong = mixed(theme.grid, theme.text, 0.2)
        beside = np.append(low * step - np.array([0.4, 0.3]) * step, 0.0)
        for axis in (0, 1):
            other = 1 - axis
            for k in range(low[axis], high[axis] + 1):
                ends = np.zeros((2, 3))
                ends[:, axis] = k * step
                ends[:, other] = low[other] * step, high[other] * step
                lines.append(ends)
                tints.append(strong if k % 5 == 0 else theme.grid)
                if k % 5 == 0:
                    at = np.where(np.arange(3) == other, beside, ends[0])
                    texts.append((f'{k * step:g} m', tuple(at.tolist())))
        self._lines.draw(lines, tints)
        self._labels.draw(texts)


class Cameras:
    """The browsers' cameras: they show the whole map until the user moves them."""

    TOLERANCE = 0.02
    """Deviation, as a share of the distance, by which a user has moved the camera."""

    PATIENCE = 50
    """Number of updates for which a camera must be elsewhere to count as moved by the user. A page
    on software rendering may report earlier positions for seconds after a new one was set."""

    def __init__(self, server: Any) -> None:
        self._server = server
        self._set: dict[int, tuple[Reals, int, object]] = {}
        """Position of every camera, the number of updates for which it has been elsewhere, and
        what it was aimed at."""
        self._area: object = None

    def aim_again(self) -> None:
        """Show the area in all browsers at the next update, and whatever the map grows to."""
        self._set.clear()

    def distance_m(self, default_m: float) -> float:
        """Return the distance of the nearest camera from what it looks at, in steps of 1.4."""
        found = [
            float(np.linalg.norm(client.camera.position - client.camera.look_at))
            for client in self._server.get_clients().values()
            if client.camera.update_timestamp
        ]
        nearest = max(min(found, default=default_m), 0.1)
        return float(2.0 ** (round(2.0 * math.log2(nearest)) / 2.0))

    def watch(self, low: Reals, high: Reals) -> None:
        """Show an area, (2,) lower and upper corner in m, unless the user has moved the camera."""
        centre, size, area = (low + high) / 2, high - low, (*low.tolist(), *high.tolist())
        if area != self._area:
            self._area = area
            start = self._server.initial_camera  # of new browsers
            position, look_at = _above(centre, size, 1.2)
            start.fov, start.position, start.look_at = FIELD_OF_VIEW, position, look_at
            start.far = 100.0 * float(position[2])
        for number, client in self._server.get_clients().items():
            camera = client.camera
            aim, updates, aimed = self._set.get(number, (centre, 0, None))
            if updates > self.PATIENCE or not camera.update_timestamp:
                continue
            # The page is narrower as soon as its panels are docked.
            if aimed != (area, camera.aspect):
                aim, look_at = _above(centre, size, camera.aspect)
                camera.far = 100.0 * float(aim[2])
                camera.position, camera.look_at = aim, look_at
                self._set[number] = aim, 0, (area, camera.aspect)
                continue
            gap_m = float(np.linalg.norm(np.array(camera.position) - aim))
            updates = updates + 1 if gap_m > self.TOLERANCE * abs(aim[2]) else 0
            self._set[number] = aim, updates, aimed


def _above(centre: Reals, size: Reals, aspect: float) -> tuple[Reals, Reals]:
    """Return the position of a camera above an area, and the point that it looks at."""
    half = max(0.5 * float(size[1]), 0.5 * float(size[0]) / max(aspect, 0.1))
    distance_m = 1.08 * half / math.tan(FIELD_OF_VIEW / 2)
    look_at = np.array([*centre, 0.0])
    return look_at + np.array([0.0, -SLANT * distance_m, distance_m]), look_at
