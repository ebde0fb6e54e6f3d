# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots on the pose cells: time from each cell to the goal, and occupancy by sonar."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.goal_memory.goal_memory import TemporalArray
from ratslam_ros.core.mapping.sonar_grid import SonarGrid
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.results.plots import BLACK, BLUE, VERMILLION, new_figure, save_figure

JUMP_CELLS = 7.0
"""Links longer than this are drawn dotted: jumps of the activity packet."""

Floats = NDArray[np.float64]


def draw_temporal_array(
    times: TemporalArray, peak: Place, file: str | Path, driven: Floats | None = None
) -> Path:
    """Plot the times to a goal like Milford et al. (2005), figures 7 and 9: light is near.

    Args:
        times: times to the goal; cells that are not connected to it stay white.
        peak: position of the robot; the route starts at the connected cell nearest to it.
        file: PNG file to write.
        driven: (n, 2) positions of the peak, x and y in cells, to plot as well, without a line
            along jumps.

    Returns:
        The file.
    """
    n_y, n_x = times.remaining_s.shape
    figure = new_figure(8.0, 1.6 + 6.0 * n_y / n_x)
    axes = figure.add_subplot()
    finite = np.ma.masked_invalid(times.remaining_s)
    image = axes.imshow(
        finite, cmap='viridis_r', origin='lower', interpolation='nearest', vmin=0.0,
        extent=(-0.5, n_x - 0.5, -0.5, n_y - 0.5), zorder=1,
    )
    figure.colorbar(image, ax=axes, label='time to the goal in s', shrink=0.85)
    if driven is not None:
        axes.plot(*_split_at_jumps(driven).T, color=BLUE, linewidth=1.0, label='driven')
    route = _route(times, peak)
    steps = np.diff(route, axis=0)
    steps -= np.round(steps / (n_x, n_y)) * (n_x, n_y)
    jumps = np.hypot(*steps.T) > JUMP_CELLS
    for at in np.flatnonzero(jumps).tolist():
        axes.plot(*route[at : at + 2].T, color=VERMILLION, linewidth=1.2, linestyle=':')
    pieces = np.split(route, np.flatnonzero(jumps) + 1)
    for number, piece in enumerate(pieces):
        axes.plot(*_split_at_edges(piece, n_x, n_y).T, color=VERMILLION, linewidth=2.0,
                  label='' if number else 'way to the goal')
    axes.plot(peak.x, peak.y, linestyle='', marker='X', markersize=10, markeredgecolor='white',
              color=BLACK, label='robot')
    axes.plot(times.goal.x, times.goal.y, linestyle='', marker='o', markersize=11,
              markerfacecolor='none', markeredgewidth=2.0, color=BLACK, label='goal')
    axes.set_xlim(-0.5, n_x - 0.5)
    axes.set_ylim(-0.5, n_y - 0.5)
    axes.set_xlabel("x' in pose cells")
    axes.set_ylabel("y' in pose cells")
    axes.legend(loc='upper center', bbox_to_anchor=(0.5, -0.12), ncols=4, fontsize=8,
                frameon=False)
    return save_figure(figure, Path(file))


def draw_occupancy(grid: SonarGrid, driven: Floats, file: str | Path) -> Path:
    """Plot trajectory and occupancy like Milford et al. (2005), figures 6, 8 and 10.

    Args:
        grid: occupancy by sonar; dark cells are occupied, and cells without any beam are blue.
        driven: (n, 2) positions of the peak, x and y in cells; no line is drawn along jumps.
        file: PNG file to write.

    Returns:
        The file.
    """
    percent = grid.percent()
    n_y, n_x = percent.shape
    figure = new_figure(8.0, 1.2 + 7.0 * n_y / n_x)
    axes = figure.add_subplot()
    axes.set_facecolor('#d5dbe3')
    image = axes.imshow(
        np.ma.masked_less(percent, 0), cmap='gray_r', origin='lower', interpolation='nearest',
        vmin=0, vmax=100, extent=(-0.5, n_x - 0.5, -0.5, n_y - 0.5),
    )
    figure.colorbar(image, ax=axes, label='occupied in %', shrink=0.85)
    axes.plot(*_split_at_jumps(driven).T, color=VERMILLION, linewidth=1.0)
    axes.set_xlim(-0.5, n_x - 0.5)
    axes.set_ylim(-0.5, n_y - 0.5)
    axes.set_xlabel("x' in pose cells")
    axes.set_ylabel("y' in pose cells")
    return save_figure(figure, Path(file))


def _route(times: TemporalArray, peak: Place) -> Floats:
    """Return (n, 2) x and y of the cells on the route, from the cell nearest to the peak."""
    n_y, n_x = times.remaining_s.shape
    cells = np.flatnonzero(np.isfinite(times.remaining_s))
    d_x = np.abs(cells % n_x - peak.x)
    d_y = np.abs(cells // n_x - peak.y)
    distances = np.hypot(np.minimum(d_x, n_x - d_x), np.minimum(d_y, n_y - d_y))
    route = [int(cells[np.argmin(distances)])]
    while times.onward.flat[route[-1]] >= 0:
        route.append(int(times.onward.flat[route[-1]]))
    return np.array([(cell % n_x, cell // n_x) for cell in route], np.float64)


def _split_at_jumps(places: Floats) -> Floats:
    """Insert a gap (NaN) at jumps of the packet, and where it crosses an edge of the torus."""
    jumps = np.hypot(*np.diff(places, axis=0).T) > JUMP_CELLS
    return np.insert(places, np.flatnonzero(jumps) + 1, np.nan, axis=0)


def _split_at_edges(places: Floats, n_x: int, n_y: int) -> Floats:
    """Insert a gap (NaN) wherever consecutive places cross an edge of the torus."""
    crosses = (np.abs(np.diff(places, axis=0)) > (n_x / 2, n_y / 2)).any(axis=1)
    return np.insert(places, np.flatnonzero(crosses) + 1, np.nan, axis=0)
