# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trails: where the robot has been on the map, by dead reckoning, and in truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.history.run_state import Trail
from ratslam_ros.viewer.scene.nodes import Canvas, Lines, Strokes, chunks, faded
from ratslam_ros.viewer.scene.palette import Rgb

CHUNK = 512
"""Number of points of a chunk that is sent as a whole."""

LIMIT = 4096
"""Number of points above which only every k-th is drawn: long trails are as costly as the map."""

TAIL = 48
"""Number of points of the thick, fading end: about 5 m."""

JUMP = 3.0
"""A step that is this many times the median is a jump of the estimate, and not drawn."""


TOLERANCE = 1 / 4000
"""Largest deviation of the drawn lines from the points, as a share of the side of the map: an
eighth of a pixel if all of it is shown. Recorded trails then need a third of the lines, of which
3,000 take software rendering 4 ms per frame."""


def steps(points_m: NDArray[np.float64], tolerance_m: float = 0.0) -> NDArray[np.float32]:
    """Return the (k, 2, 3) lines along points, without steps that were jumped instead of driven.

    Args:
        points_m: (n, 2) points.
        tolerance_m: distance by which points may be off the lines (Douglas and Peucker, 1973).
    """
    if len(points_m) < 2:
        return np.empty((0, 2, 3), np.float32)
    lengths = np.hypot(*np.diff(points_m, axis=0).T)
    jumps = np.flatnonzero(lengths > JUMP * np.median(lengths))
    runs = [_simplified(run, tolerance_m) for run in np.split(points_m, jumps + 1)]
    ends = np.concatenate([np.stack([run[:-1], run[1:]], axis=1) for run in runs])
    return np.pad(ends, ((0, 0), (0, 0), (0, 1))).astype(np.float32)


def _simplified(points_m: NDArray[np.float64], tolerance_m: float) -> NDArray[np.float64]:
    """Return the points that lines within a tolerance need, the ends included."""
    if not tolerance_m or len(points_m) < 3:
        return points_m
    import cv2

    begin = points_m[0]  # Single precision suffices near it.
    line = cv2.approxPolyDP((points_m - begin).astype(np.float32)[:, None], tolerance_m, False)
    kept: NDArray[np.float64] = begin + line.reshape(-1, 2)
    return kept


class TrailDrawing:
    """A trail as thin lines, with a thick end that fades if it has a tail."""

    def __init__(self, canvas: Canvas, name: str, height_m: float, has_tail: bool = False) -> None:
        self._canvas = canvas
        self._path = canvas.layer(name, height_m)
        self._chunks: list[Lines] = []
        self.is_drawn = False
        """Whether there is anything to see."""
        self._key: object = None
        self._tail_key: object = None
        self._tail = Strokes(canvas, f'{self._path}/tail', 4.0) if has_tail else None

    def draw(self, trail: Trail, colour: Rgb, side_m: float) -> None:
        """Draw a trail on a map of a side; send only the chunks that differ."""
        style = colour, TOLERANCE * side_m
        key = (id(trail), trail.version, style)
        if key == self._key:
            return
        self._key, self.is_drawn = key, len(trail.points_m) > 0
        points = trail.points_m[:: max(1, -(-len(trail.points_m) // LIMIT))]
        for lines, part in chunks(
            self._chunks, lambda k: Lines(self._canvas, f'{self._path}/{k}'),
            max(len(points) - 1, 0), CHUNK,
        ):
            driven = points[part.start : part.stop + 1]
            lines.draw(steps(driven, TOLERANCE * side_m), colour)

    def draw_tail(self, trail: Trail, colour: Rgb) -> None:
        """Draw the end of the trail."""
        key = (id(trail), trail.version, colour, self._canvas.theme.background)
        if self._tail is not None and key != self._tail_key:
            self._tail_key = key
            lines = steps(trail.points_m[-TAIL - 1 :])
            tints = faded(colour, self._canvas.theme.background, 2 * len(lines))
            self._tail.draw(lines, tints.reshape(-1, 2, 3))
