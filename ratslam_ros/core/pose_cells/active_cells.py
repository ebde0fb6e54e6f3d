# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Activity of the pose cells as arrays, for programs that show or record it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.pose_cells.pose_cells import PoseCells


class ActiveCells(NamedTuple):
    """Activity of the pose cells; all places are ordered x, y, theta, in cells.

    Attributes:
        cells: (n, 3) active cells.
        activity: (n,) their activities, above 0.
        packets: (m, 4) peak of every packet and its total activity, the strongest first.
        injections: (k, 4) place and energy of every injection at the last view.
    """

    cells: NDArray[np.int64]
    activity: NDArray[np.float64]
    packets: NDArray[np.float64]
    injections: NDArray[np.float64]


def active_cells(pose_cells: PoseCells) -> ActiveCells:
    """Return the active cells, the packets and the injections of the last view."""
    cells, activity = pose_cells.active()
    packets = pose_cells.packets()
    packets = packets[np.argsort(-packets[:, 3], kind='stable')]
    n_theta = pose_cells.dims[2]
    injections = [
        (place.x, place.y, place.theta % n_theta, energy)
        for place, energy in pose_cells.injections
    ]
    return ActiveCells(
        np.ascontiguousarray(cells[:, ::-1]),
        activity,
        packets[:, [2, 1, 0, 3]],
        np.array(injections, np.float64).reshape(-1, 4),
    )
