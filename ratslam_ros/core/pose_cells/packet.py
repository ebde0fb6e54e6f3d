# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A packet of activity of the pose cells."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ratslam_ros.core.common.state import State
from ratslam_ros.core.pose_cells.packet_kernels import Box, Cells, Frame


class Packet(NamedTuple):
    """A box of activity that does not interact with activity outside it; immutable.

    Attributes:
        cells: (n_theta, n_y, n_x) activity.
        box: (6,) first cell and number of cells per axis, wrapping around the torus.
        frame: (3,) offset of its lattice from the lattice of the torus, in cells, -0.5 to 0.5.
    """

    cells: Cells
    box: Box
    frame: Frame


MAX_CELLS = 100_000
"""Largest number of cells along an axis in a saved state."""


def packets_fit(packets: Any, state: State) -> bool:
    """Return whether saved boxes lie on a torus of ``dims``, and have the size of their cells."""
    size = np.asarray(state['dims'])[::-1]
    for packet in packets:
        cells, box, frame = (np.asarray(packet[key]) for key in Packet._fields)
        if not (
            box.dtype.kind == 'i' and box.shape == (6,) and cells.ndim == 3
            and box[3:].tolist() == list(cells.shape) and bool((box[3:] <= size).all())
            # A merged packet may begin before the edge of the torus: the kernels wrap it.
            and bool((np.abs(box[:3]) <= MAX_CELLS).all())
            and frame.shape == (3,) and bool((np.abs(frame) <= 0.5).all())
            and bool(np.isfinite(cells).all()) and bool((cells >= 0.0).all())
        ):
            return False
    return True
