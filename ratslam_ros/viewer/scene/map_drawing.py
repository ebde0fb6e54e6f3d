# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drawing of the map in chunks, of which only those that differ are sent."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.mapping.map_changes import LinkRows
from ratslam_ros.viewer.scene.colouring import Colours
from ratslam_ros.viewer.scene.nodes import Canvas, Cloud, Lines, chunks

CHUNK = 512
"""Number of experiences or rows of links of a chunk. A view changes one or two chunks of 8 to 20
kB; a map of 20,000 experiences has 80 chunks."""

LIMIT = 4_000
"""Number of experiences above which the map is thinned. On software rendering with two processors,
20,000 experiences are then drawn at 23 to 30 frames per second (benchmarks/page_frame_rate.py)."""


def thinned_links(rows: LinkRows, every: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the ends of links between drawn experiences, and which rows are drawn.

    Args:
        rows: rows of links.
        every: every how many experiences one is drawn.

    Returns:
        (rows, 2) ends, in which an experience that is not drawn is replaced by the drawn one
        before it, and (rows,) whether the link is drawn: not if it is deleted, has become a point,
        or equals an earlier one. A recognised link is not equal to a driven one.
    """
    ends = rows.ends // every * every
    drawn = (rows.ends[:, 0] >= 0) & (ends[:, 0] != ends[:, 1])
    if every > 1:
        low, high = ends.min(axis=1), ends.max(axis=1)
        keys = (low * (int(high.max(initial=0)) + 1) + high) * 2 + rows.recognised
        keys[~drawn] = -1
        first = np.zeros(len(keys), np.bool_)
        first[np.unique(keys, return_index=True)[1]] = True
        drawn &= first
    return ends, drawn


class MapDrawing:
    """Experiences and links, drawn as points and lines."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        # Above the experiences, which would hide the loop closures of a dense map.
        self._links_path = canvas.layer('links', 0.004)
        self._points_path = canvas.layer('experiences')
        self._clouds: list[Cloud] = []
        self._lines: list[Lines] = []
        self._size_m = 0.1
        self.every = 1
        """Every how many experiences one is drawn."""

    def draw(
        self, poses: NDArray[np.float64], rows: LinkRows, colours: Colours, limit: int = LIMIT
    ) -> None:
        """Draw the map; send the chunks that differ from what has been drawn.

        Args:
            poses: (n, 3) poses of the experiences.
            rows: rows of links.
            colours: colours of both.
            limit: largest number of experiences that is drawn without thinning.
        """
        self.every = every = max(1, math.ceil(len(poses) / limit))
        places = np.zeros((len(poses), 3), np.float32)
        places[:, :2] = poses[:, :2]
        known = np.isfinite(poses[:, 0])
        chosen = known & (np.arange(len(poses)) % every == 0)
        size = CHUNK * every
        for cloud, part in chunks(self._clouds, self._cloud, len(poses), size):
            keep = chosen[part]
            cloud.draw(places[part][keep], colours.experiences[part][keep])
        ends, drawn = thinned_links(rows, every)
        drawn &= ((ends >= 0) & (ends < len(poses))).all(axis=1)
        drawn[drawn] = known[ends[drawn]].all(axis=1)
        for lines, part in chunks(self._lines, self._new_lines, len(ends), size):
            keep = drawn[part]
            lines.draw(places[ends[part][keep]], colours.links[part][keep])

    def resize(self, size_m: float) -> None:
        """Change the diameter of the experiences."""
        self._size_m = size_m
        for cloud in self._clouds:
            cloud.resize(size_m)

    def _cloud(self, number: int) -> Cloud:
        return Cloud(self._canvas, f'{self._points_path}/{number}', self._size_m)

    def _new_lines(self, number: int) -> Lines:
        return Lines(self._canvas, f'{self._links_path}/{number}')
