# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of the panels: a view above its template, and the error of the last minute."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

import cv2
import numpy as np
from numpy.typing import NDArray

from ratslam_ros.history.records import MatchRecord, ViewRecord
from ratslam_ros.history.run_state import NS_PER_S
from ratslam_ros.viewer.panels.html import ORANGE

PICTURE_WIDTH_PX = 320
"""Least width of the picture of a match, about that of the panel."""

GAP_PX = 4
"""Space between a view and its template."""

UNMATCHED = 0.35
"""Brightness of the columns that have no counterpart."""

PLOT_POINTS = 300
"""Largest number of points of the error plot; the panel has about as many columns."""


def match_picture(match: MatchRecord) -> NDArray[np.uint8]:
    """Return a view above its template, with columns that show the same above each other.

    The template is moved by the shift of the match. Columns without a counterpart are dark, and
    a line marks where the counterparts end.

    Returns:
        (height, width, 3) picture.
    """
    shift = match.shift_px
    columns = max(match.view.shape[1], match.template.shape[1]) + abs(shift)
    zoom = max(1, -(-PICTURE_WIDTH_PX // columns))
    rows = [
        _row(match.view, max(-shift, 0), columns, match.template.shape[1], max(shift, 0)),
        _row(match.template, max(shift, 0), columns, match.view.shape[1], max(-shift, 0)),
    ]
    upper, lower = (row.repeat(zoom, axis=0).repeat(zoom, axis=1) for row in rows)
    gap = np.full((GAP_PX, columns * zoom), 127, np.uint8)
    picture = cv2.cvtColor(np.concatenate([upper, gap, lower]), cv2.COLOR_GRAY2RGB)
    first = abs(shift) * zoom
    last = (columns - abs(shift)) * zoom
    if shift:
        picture[:, max(first - 1, 0) : first + 1] = ORANGE
        picture[:, last - 1 : last + 1] = ORANGE
    return np.asarray(picture, np.uint8)


def _row(
    image: NDArray[np.uint8], at: int, columns: int, other_width: int, other_at: int
) -> NDArray[np.uint8]:
    """Return an image at its columns of the picture, dark where the other one has none."""
    row = np.full((image.shape[0], columns), 127, np.uint8)
    row[:, at : at + image.shape[1]] = image
    for unmatched in (row[:, :other_at], row[:, other_at + other_width :]):
        unmatched[:] = (unmatched * UNMATCHED).astype(np.uint8)
    return row


def error_curves(views: Iterable[ViewRecord], now_ns: int) -> tuple[NDArray[np.float64], ...]:
    """Return the curves of the error plot.

    Returns:
        x: time before now in s, negative; then the match error, the threshold, and the error of
        views that became new templates, NaN for others. Views without an error are left out,
        because the page scales its axis by the errors and cannot do so with NaN among them.
    """
    views = [view for view in views if view.error >= 0]
    stride = max(1, -(-len(views) // PLOT_POINTS))
    chosen = list(islice(views, (len(views) - 1) % stride, None, stride))
    rows = np.array(
        [
            [(view.stamp_ns - now_ns) / NS_PER_S, view.error, view.threshold, view.is_new]
            for view in chosen
        ]
    ).reshape(-1, 4)
    x, error, threshold, is_new = rows.T.copy()
    return x, error, threshold, np.where(is_new == 1, error, np.nan)
