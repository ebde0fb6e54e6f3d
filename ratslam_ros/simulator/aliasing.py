# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How alike the places of a world look: what a recogniser of single views is up against."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray


@dataclass(frozen=True)
class Aliasing:
    """How well views tell places apart at one threshold.

    look_alike_share: of all views, those that match a view from a place too far off to be this
    revisited_share: of all views, those that saw their place before, in the same direction
    recognised_share: of the revisits, those that match a view from then
    right_share: of the revisits, those for which the best match is nearby and not a look-alike
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
    """Compare all views of a run with each other at a local-view threshold.

    views: (n, height, width) uint8, the normalised templates, in order of time
    poses: (n, 3) x_m, y_m, heading_rad, where they were really taken from
    shift: columns to either side within which views may match, as vt_shift_match
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
    """Find how similar the best revisit and the best look-alike of every view are.

    near_m, near_rad: a revisit is as close as this to a view at least `pause` views older
    Returns two (n,) arrays: mean |difference| / 255 to the best revisit among the older views and
        to the best look-alike among all, infinite where there is none
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
