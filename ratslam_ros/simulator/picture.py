# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A picture of a simulated run: the floor from above, where the robot went, what it believed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.simulator.recording import SimulatedRun

BLUE, VERMILLION = '#0072B2', '#D55E00'
DOTS_PER_INCH = 120


def draw_run(run: SimulatedRun, path: str | Path) -> Path:
    """Draw the floor plan, the true path and dead reckoning to a PNG; needs no display."""
    # Imported here, as it is slow to import; and not pyplot, which may want a screen.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    path = Path(path)
    width_m, depth_m = run.world.plan.size_m
    believed = _from_true_start(run.odometry_pose, run.truth_pose[0])
    figure = Figure(figsize=(9.0, 6.4), layout='constrained')
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.imshow(
        np.where(run.world.plan.solid, 1.0, np.nan),
        origin='lower',
        extent=(0.0, width_m, 0.0, depth_m),
        cmap='gray',
        vmin=0.0,
        vmax=1.3,
        interpolation='nearest',
        zorder=0,
    )
    axes.plot(*believed.T, color=VERMILLION, lw=1.0, label='where its wheels say it went')
    axes.plot(*run.truth_pose[:, :2].T, color=BLUE, lw=1.4, label='where the robot went')
    axes.plot(*run.truth_pose[0, :2], 'o', color=BLUE, label='start')
    axes.set_aspect('equal')
    axes.set_xlabel('x (m)')
    axes.set_ylabel('y (m)')
    axes.set_title(f'Simulated office, {run.duration_s:.0f} s, {run.images} images')
    figure.legend(loc='outside lower center', ncols=3, frameon=False)
    # Without the version of matplotlib in it: the same run gives the same bytes.
    figure.savefig(path, dpi=DOTS_PER_INCH, metadata={'Software': None})
    return path


def _from_true_start(
    odometry_pose: NDArray[np.float64], start: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Turn and shift odometry, which begins at (0, 0, 0), so that it begins at the true start."""
    cos, sin = np.cos(start[2]), np.sin(start[2])
    x, y = odometry_pose[:, 0], odometry_pose[:, 1]
    return np.stack([start[0] + cos * x - sin * y, start[1] + sin * x + cos * y], axis=1)
