# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Perceptual aliasing: how often views of different places match each other."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray


@dataclass(frozen=True)
class Aliasing:
    """How well single views distinguish places at one match threshold.

    look_alike_share: fraction of views that match a view from a different place
    revisited_share: fraction of views at a place seen before in the same direction
    recognised_share: fraction of the revisits that match an earlier view of their place
    right_share: fraction of the revisits whose best match is of their place, not a look-alike
    """

    look_alike_share: float
    revisited_share: float
    recognised_share: float
    right_share: float


def measure_aliasing(
    views: NDArray[np.uint8],
    poses: NDArray[np.float64],
    threshold: float,
    shift: int = 0,
    far_m: float = 5.0,
) -> Aliasing:
    """Compare all views of a run with each other.

    Args:
        views: (n, height, width) uint8, the normalised templates, in time order.
        poses: (n, 3) x_m, y_m, heading_rad, the true poses at which they were taken.
        threshold: largest error at which two views match, as vt_match_threshold.
        shift: largest column offset at which views are compared, as vt_shift_match.
        far_m: distance beyond which two views are of different places.
    """
    revisit_error, look_alike_error = nearest_errors(views, poses, shift, far_m)
    revisited = np.isfinite(revisit_error)
    revisits = max(int(revisited.sum()), 1)
    recognised = revisited & (revisit_error <= threshold)
    right = revisited & (revisit_error < look_alike_error)
    return Aliasing(
        float((look_alike_error <= threshold).mean()),
        float(revisited.mean()),
        int(recognised.sum()) / revisits,
        int(right.sum()) / revisits,
    )


def nearest_errors(
    views: NDArray[np.uint8],
    poses: NDArray[np.float64],
    shift: int = 0,
    far_m: float = 5.0,
    near_m: float = 0.5,
    near_rad: float = math.radians(15.0),
    pause: int = 100,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the match errors of the best revisit and of the best look-alike of every view.

    Args:
        views, poses, shift, far_m: as in `measure_aliasing`.
        near_m, near_rad: largest distance and heading difference between a view and its revisit.
        pause: smallest number of views between a view and its revisit.

    Returns:
        Two (n,) arrays of the mean absolute difference / 255: to the best revisit among the
        earlier views, and to the best look-alike among all views; inf if there is none.
    """
    return _nearest_errors(views, poses, shift, far_m, near_m, near_rad, pause)  # type: ignore


@njit(cache=True)
def _nearest_errors(views, poses, shift, far_m, near_m, near_rad, pause):  # type: ignore
    n, height, width = views.shape
    revisit = np.full(n, np.inf)
    look_alike = np.full(n, np.inf)
    scale = 255.0 * height * (width - 2 * shift)
    for i in range(n):
        for j in range(n):
            distance_m = math.hypot(poses[i, 0] - poses[j, 0], poses[i, 1] - poses[j, 1])
            turn_rad = (poses[i, 2] - poses[j, 2] + math.pi) % (2 * math.pi) - math.pi
            again = j <= i - pause and distance_m <= near_m and abs(turn_rad) <= near_rad
            if not again and distance_m <= far_m:
                continue
            for offset in range(2 * shift + 1):
                difference = np.int64(0)
                for y in range(height):
                    for x in range(width - 2 * shift):
                        difference += abs(
                            np.int64(views[i, y, shift + x]) - np.int64(views[j, y, offset + x])
                        )
                error = difference / scale
                if again:
                    revisit[i] = min(revisit[i], error)
                else:
                    look_alike[i] = min(look_alike[i], error)
    return revisit, look_alike
