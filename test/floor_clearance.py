# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Distance to the nearest wall of a floor plan, independent of the simulator's collision code."""

from __future__ import annotations

import numpy as np

from ratslam_simulator.floor_plan import FloorPlan


def clearance_m(plan: FloorPlan, x_m: float, y_m: float) -> float:
    """Return the distance in metres from a point to the nearest wall, 0 inside one."""
    rows, columns = np.nonzero(plan.solid)
    # To the nearest point of each wall cell, which is a square.
    dx = np.maximum(np.abs(x_m - (columns + 0.5) * plan.cell_m) - plan.cell_m / 2, 0.0)
    dy = np.maximum(np.abs(y_m - (rows + 0.5) * plan.cell_m) - plan.cell_m / 2, 0.0)
    return float(np.sqrt(np.min(dx * dx + dy * dy)))
