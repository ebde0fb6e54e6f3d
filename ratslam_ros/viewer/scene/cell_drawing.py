# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pose cells as a box with the axes x, y and heading, which wrap around."""

from __future__ import annotations

import itertools
import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.history.records import CellsRecord
from ratslam_ros.viewer.scene.nodes import Canvas, Cloud, Labels, Lines, Strokes
from ratslam_ros.viewer.scene.palette import LEVELS, Bytes, Theme, mixed, scale_colours

Reals = NDArray[np.float64]
Numbers = NDArray[np.floating[Any]]

WRAP_CELLS = 2.0
"""Cells this near to a face are drawn again, pale, beyond the opposite face: there they act."""

SIZES = (1.3, 0.7, 0.3)
"""Diameters of points of high, middle and low activity, in cells of the longest axis."""

SHARES = (0.3, 0.05)
"""Activities, as shares of the largest, above which the diameter is that of high or middle."""

PALE = 0.72
"""Share of the background in the colour of repeated cells."""

LEAST_SHARE = 0.02
"""Share of the energy below which a packet has no label."""

TURN, TILT = math.radians(28.0), math.radians(-62.0)
"""Rotation of the box, so that it is seen from the side when the map is seen from above."""


def rotation() -> Reals:
    """Return the (3, 3) rotation of the box: first by ``TURN`` about its heading axis."""
    c, s = math.cos(TURN), math.sin(TURN)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    c, s = math.cos(TILT), math.sin(TILT)
    whole: Reals = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]) @ turn
    return whole


SHIFTS = np.array([shift for shift in itertools.product((-1, 0, 1), repeat=3) if any(shift)])
"""The 26 directions in which the box repeats."""

CORNERS = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
EDGES = [
    CORNERS[[a, b]] for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count('1') == 1
]
"""Lines along the edges of the box, in shares of its sides, as are those below."""

FLOOR = [
    line for share in (0.2, 0.4, 0.6, 0.8)
    for line in ([[share, 0, 0], [share, 1, 0]], [[0, share, 0], [1, share, 0]])
]
"""Lines on the floor, so that packets can be located on it."""

WALLS = [
    line for share in (0.25, 0.5, 0.75)
    for line in ([[0, 1, share], [1, 1, share]], [[0, 0, share], [0, 1, share]])
]
"""Lines on the two walls behind, for a quarter turn each."""

TEXTS = [
    ('Pose cells', (0.5, 1, 1.16)), ('x (wraps)', (0.5, -0.1, -0.03)),
    ('y (wraps)', (1.1, 0.5, -0.03)),
    *((f'{turn}°', (-0.04, -0.04, turn / 360)) for turn in (0, 90, 180, 270)),
    # Two lines, because a long one would be hidden behind the panel on the left.
    ('360° = 0°', (-0.04, -0.04, 1.05)), ('heading', (-0.04, -0.04, 1.18)),
]
"""Texts of the axes."""


def repeated(
    cells: NDArray[np.int64], dims: tuple[int, int, int]
) -> tuple[Reals, NDArray[np.int64]]:
    """Return copies of cells beyond the opposite faces, and the row that each is a copy of.

    Args:
        cells: (n, 3) x, y and theta.
        dims: numbers of cells in x, y and theta.
    """
    size = np.array(dims, float)
    outer = np.flatnonzero(((cells < WRAP_CELLS) | (cells >= size - WRAP_CELLS)).any(axis=1))
    moved = cells[outer] + 0.5 + SHIFTS[:, None] * size
    shift, at = np.nonzero(((moved > -WRAP_CELLS) & (moved < size + WRAP_CELLS)).all(axis=2))
    return moved[shift, at], outer[at]


def activity_levels(activity: Numbers) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the (n,) colour levels and size classes of activities; 0 is the largest size.

    Activity spans decades, so both depend on its logarithm.
    """
    top = float(activity.max(initial=0.0))
    if top <= 0.0:
        return np.zeros(len(activity), np.int64), np.full(len(activity), 2)
    share = np.maximum(activity / top, 1e-3)
    levels = np.round((1.0 + np.log10(share) / 3.0) * (LEVELS - 1)).astype(np.int64)
    return levels, np.where(share >= SHARES[0], 0, np.where(share >= SHARES[1], 1, 2))


@cache
def _pale(theme: Theme) -> Bytes:
    """Return the (LEVELS, 3) colours of repeated cells."""
    scale = scale_colours(theme).tolist()
    return np.array([mixed(tuple(rgb), theme.background, PALE) for rgb in scale], np.uint8)


class CellDrawing:
    """The box, the activity within it, competing packets and injections."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas, path = canvas, canvas.layer('cells')
        self._key: object = None
        self._box_key: object = None
        self._clouds = [Cloud(canvas, f'{path}/{k}', 0.1, 'gradient') for k in range(3)]
        self._edges = Lines(canvas, f'{path}/box')
        self._drops = Strokes(canvas, f'{path}/drops', 1.5)
        self._markers = Strokes(canvas, f'{path}/injections', 2.5)
        self._axes = Labels(canvas, f'{path}/axes')
        self._shares = Labels(canvas, f'{path}/shares', 'bottom-left')

    def draw(self, record: CellsRecord, centre: tuple[float, float], side_m: float) -> None:
        """Draw the activity of the pose cells.

        Args:
            record: the activity.
            centre: centre of the box on the map in m.
            side_m: length of its longest side.
        """
        place = (*centre, side_m, self._canvas.theme.background)
        key = (id(record), place)
        if key == self._key:
            return
        self._key = key
        # The lowest corner touches the ground.
        lowest = float(((CORNERS - 0.5) @ rotation().T)[:, 2].min())
        self._centre, self._side_m = np.array([*centre, -lowest * side_m]), side_m
        theme = self._canvas.theme
        if self._box_key != (record.dims, place):
            self._box_key = (record.dims, place)
            self._draw_box(record.dims, theme)
        levels, sizes = activity_levels(record.activity)
        colours = scale_colours(theme)[levels]
        copies, rows = repeated(record.cells, record.dims)
        pale = _pale(theme)[levels[rows]]
        inside = self._points(record.cells.astype(np.float64) + 0.5, record.dims)
        beyond = self._points(copies, record.dims)
        points = np.concatenate([inside, beyond])
        tints = np.concatenate([colours, pale])
        classes = np.concatenate([sizes, sizes[rows]])
        for k, cloud in enumerate(self._clouds):
            cloud.draw(points[classes == k], tints[classes == k])
        self._draw_packets(record, theme)
        self._draw_injections(record, theme)

    def _points(self, cells: Numbers, dims: tuple[int, int, int]) -> Reals:
        """Return points on the map; headings are drawn as high as the box is wide."""
        widest = max(dims[0], dims[1])
        lengths_m = self._side_m * np.array([dims[0] / widest, dims[1] / widest, 1.0])
        unit = cells / np.array(dims, float) - 0.5
        turned: Reals = unit * lengths_m @ rotation().T + self._centre
        return turned

    def _draw_box(self, dims: tuple[int, int, int], theme: Theme) -> None:
        lines = np.array([*EDGES, *FLOOR, *WALLS]) * dims
        line = mixed(theme.text, theme.background, 0.35)
        weak = mixed(theme.grid, theme.text, 0.12)
        tints = [line] * len(EDGES) + [weak] * len(FLOOR + WALLS)
        self._edges.draw(self._points(lines, dims), tints)
        cell_m = self._side_m / max(dims[0], dims[1])
        for cloud, size in zip(self._clouds, SIZES, strict=True):
            cloud.resize(size * cell_m)
        where = self._points(np.array([at for _, at in TEXTS]) * dims, dims).tolist()
        self._axes.draw([(text, tuple(at)) for (text, _), at in zip(TEXTS, where, strict=True)])

    def _draw_packets(self, record: CellsRecord, theme: Theme) -> None:
        energy = float(record.packets[:, 3].sum())
        shown = record.packets[record.packets[:, 3] >= LEAST_SHARE * max(energy, 1e-12)]
        peaks = shown[:, :3] + 0.5
        floor = peaks * np.array([1.0, 1.0, 0.0])
        drops = np.stack([self._points(peaks, record.dims), self._points(floor, record.dims)], 1)
        self._drops.draw(drops, theme.robot)
        above = self._points(peaks + np.array([0.5, 0.5, 1.5]), record.dims).tolist()
        texts = [f'{share:.0%}' for share in shown[:, 3] / max(energy, 1e-12)]
        self._shares.draw([(text, tuple(at)) for text, at in zip(texts, above, strict=True)])

    def _draw_injections(self, record: CellsRecord, theme: Theme) -> None:
        injections = record.injections
        # An octahedron is hollow from every side.
        tips = np.concatenate([np.eye(3), -np.eye(3)])
        pairs = [(a, b) for a in range(6) for b in range(a + 1, 6) if abs(a - b) != 3]
        radius_m = 1.4 * self._side_m / max(record.dims[0], record.dims[1])
        centres = self._points(injections[:, :3] + 0.5, record.dims)
        lines = centres[:, None, None] + radius_m * tips[np.array(pairs)]
        self._markers.draw(lines, theme.closure)
