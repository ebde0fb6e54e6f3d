# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Picture of a match: the view as it was compared above its template, for viewers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]

SHOWN_WIDTH_PX = 240
"""Width that views are enlarged to for viewers; they are a few dozen pixels wide."""


def joined(view: Pixels, template: Pixels) -> Pixels:
    """Return a view above its template, (h, w) uint8 each, separated by a white row, enlarged."""
    gap = np.full((1, view.shape[1]), 255, np.uint8)
    factor = max(SHOWN_WIDTH_PX // view.shape[1], 1)
    return np.concatenate([view, gap, template]).repeat(factor, 0).repeat(factor, 1)


def separated(both: Pixels) -> tuple[Pixels, Pixels] | None:
    """Return the view and the template of a picture in their own size; None if it is no such."""
    height, width = both.shape
    for factor in range(SHOWN_WIDTH_PX, 0, -1):
        rows = height // factor
        if width % factor or height % factor or rows % 2 == 0:
            continue
        small = both[::factor, ::factor]
        view, template = small[: rows // 2], small[rows // 2 + 1 :]
        if np.array_equal(joined(view, template), both):
            return view, template
    return None
