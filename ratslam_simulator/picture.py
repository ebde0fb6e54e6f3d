# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of floor plans and simulated runs: trajectories, obstacles and camera views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.results.plots import (
    BLUE,
    GREEN,
    VERMILLION,
    add_legend_below,
    new_figure,
    save_figure,
)
from ratslam_simulator.camera import Camera, CameraOptions
from ratslam_simulator.floor_plan import FloorPlan
from ratslam_simulator.recording import SimulatedRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes

VIEWS_COUNT = 4
"""Camera views in the picture of a run."""

Rectangle = tuple[float, float, float, float]
"""x_m, y_m of the centre, width_m along x, depth_m along y."""

# The colour-blind safe palette of Okabe and Ito, as in pictures.py.
TRAJECTORY_COLOURS = (GREEN, VERMILLION, BLUE, '#E69F00', '#CC79A7', '#56B4E9', '#000000')


def draw_plan(
    plan: FloorPlan,
    path: str | Path,
    trajectories: Mapping[str, NDArray[np.float64]] | None = None,
    obstacles: Sequence[Rectangle] = (),
    title: str | None = None,
) -> Path:
    """Draw a floor plan with its named places, trajectories and obstacles; needs no display.

    Args:
        plan: the floor plan.
        path: file to write.
        trajectories: label -> (n, 2 or more), x_m and y_m first; NaN interrupts a line.
        obstacles: rectangles.
        title: title of the picture; None for the name of the plan.

    Returns:
        The path of the file.
    """
    width_m, depth_m = plan.size_m
    # The aspect ratio of the plan, with space for the axis labels.
    figure = new_figure(11.0, min(max(10.0 * depth_m / width_m + 1.6, 4.0), 11.0))
    axes = figure.add_subplot()
    _draw_floor(axes, plan, obstacles)
    for index, (label, positions) in enumerate((trajectories or {}).items()):
        colour = TRAJECTORY_COLOURS[index % len(TRAJECTORY_COLOURS)]
        axes.plot(positions[:, 0], positions[:, 1], color=colour, linewidth=1.3, label=label)
        axes.plot(*positions[0, :2], 'o', color=colour, markersize=5)
    axes.set_title(plan.name if title is None else title)
    if trajectories:
        add_legend_below(figure, axes, columns=4, fontsize=10)
    return save_figure(figure, path)


def _draw_floor(axes: Axes, plan: FloorPlan, obstacles: Sequence[Rectangle] = ()) -> None:
    """Draw walls, names of places and obstacles into axes in metres."""
    from matplotlib.patches import Rectangle as Patch

    _draw_walls(axes, plan)
    for name, (x_m, y_m) in plan.places.items():
        axes.text(
            x_m, y_m, name, ha='center', va='center', zorder=5,
            bbox={'boxstyle': 'circle,pad=0.15', 'facecolor': 'white', 'linewidth': 0.6},
        )
    for x_m, y_m, width_m, depth_m in obstacles:
        corner = (x_m - width_m / 2, y_m - depth_m / 2)
        axes.add_patch(Patch(corner, width_m, depth_m, color=VERMILLION, alpha=0.6, zorder=4))
    axes.set_aspect('equal')
    axes.set_xlabel('x [m]')
    axes.set_ylabel('y [m]')


def draw_run(run: SimulatedRun, path: str | Path) -> Path:
    """Draw the floor plan, true path, dead reckoning and camera views; needs no display."""
    figure = new_figure(9.0, 8.2)
    grid = figure.add_gridspec(2, VIEWS_COUNT, height_ratios=(4.0, 1.0))
    floor = figure.add_subplot(grid[0, :])
    _draw_paths(floor, run)
    camera = Camera(run.world, np.random.Generator(np.random.PCG64(0)), CameraOptions())
    for view in range(VIEWS_COUNT):
        # Over the first of three circuits, which all follow the same path.
        index = len(run.truth_pose) * (2 * view + 1) // (6 * VIEWS_COUNT)
        x_m, y_m, heading_rad = run.truth_pose[index]
        name = 'abcdefgh'[view]
        floor.annotate(
            name, (x_m, y_m), ha='center', va='center', zorder=5,
            bbox={'boxstyle': 'circle', 'facecolor': 'white', 'edgecolor': GREEN},
        )
        axes = figure.add_subplot(grid[1, view])
        axes.imshow(camera.take(x_m, y_m, heading_rad), cmap='gray', vmin=0, vmax=255)
        axes.set_title(f'view at {name}')
        axes.set_axis_off()
    return save_figure(figure, path)


def _draw_paths(axes: Axes, run: SimulatedRun) -> None:
    _draw_walls(axes, run.world.plan)
    odometry_m = _from_true_start(run.odometry_pose, run.truth_pose[0])
    axes.plot(*odometry_m.T, color=VERMILLION, linewidth=1.0, label='dead reckoning')
    axes.plot(*run.truth_pose[:, :2].T, color=GREEN, linewidth=1.6, label='truth')
    axes.plot(*run.truth_pose[0, :2], 'o', color=GREEN, label='start')
    axes.set_aspect('equal', adjustable='datalim')
    axes.margins(0.03)
    axes.set_xlabel('x [m]')
    axes.set_ylabel('y [m]')
    axes.set_title(f'Simulated office: {run.duration_s:.0f} s, {run.images} images')
    axes.legend(loc='upper right')


def _draw_walls(axes: Axes, plan: FloorPlan) -> None:
    width_m, depth_m = plan.size_m
    axes.imshow(
        np.where(plan.solid, 0.77, np.nan),
        origin='lower',
        extent=(0.0, width_m, 0.0, depth_m),
        cmap='gray',
        vmin=0.0,
        vmax=1.0,
        interpolation='nearest',
    )


def _from_true_start(
    odometry_pose: NDArray[np.float64], start: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Transform odometry, which starts at (0, 0, 0), to the true start; return (n, 2)."""
    cos, sin = np.cos(start[2]), np.sin(start[2])
    x, y = odometry_pose[:, 0], odometry_pose[:, 1]
    return np.stack([start[0] + cos * x - sin * y, start[1] + sin * x + cos * y], axis=1)
