# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of the goal memory: how long it takes from each pose cell to the goal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.goal_memory.goal_memory import TemporalArray
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.results.plots import BLACK, BLUE, VERMILLION, new_figure, save_figure

JUMP_CELLS = 7.0
"""A longer step of a way is drawn dashed: a discontinuity of the pose cells."""

Floats = NDArray[np.float64]


def draw_temporal_array(
    times: TemporalArray, peak: Place, file: str | Path, driven: Floats | None = None
) -> Path:
    """Draw the times to a goal as figures 7 and 9 of seed 001 do: the lighter, the nearer.

    Args:
        times: what the goal memory recalled; cells that nothing leads on from stay white.
        peak: where the robot is; the way from the known cell nearest to it is drawn over.
        file: a PNG to write.
        driven: (n, 2) x and y in cells of where the peak has been, drawn as well.

    Returns:
        The file.
    """
    n_y, n_x = times.remaining_s.shape
    figure = new_figure(8.0, 1.6 + 6.0 * n_y / n_x)
    axes = figure.add_subplot()
    known = np.ma.masked_invalid(times.remaining_s)
    shown = axes.imshow(
        known, cmap='viridis_r', origin='lower', interpolation='nearest', vmin=0.0,
        extent=(-0.5, n_x - 0.5, -0.5, n_y - 0.5), zorder=1,
    )  # fmt: skip
    figure.colorbar(shown, ax=axes, label='time to the goal in s', shrink=0.85)
    if driven is not None:
        axes.plot(*_broken(driven, n_x, n_y).T, color=BLUE, linewidth=1.0, label='driven')
    way = _way(times, peak)
    steps = np.diff(way, axis=0)
    steps -= np.round(steps / (n_x, n_y)) * (n_x, n_y)
    jumps = np.hypot(*steps.T) > JUMP_CELLS
    for at in np.flatnonzero(jumps).tolist():
        axes.plot(*way[at : at + 2].T, color=VERMILLION, linewidth=1.2, linestyle=':')
    pieces = np.split(way, np.flatnonzero(jumps) + 1)
    for number, piece in enumerate(pieces):
        axes.plot(*_broken(piece, n_x, n_y).T, color=VERMILLION, linewidth=2.0,
                  label='' if number else 'way to the goal')  # fmt: skip
    axes.plot(peak.x, peak.y, linestyle='', marker='X', markersize=10, markeredgecolor='white',
              color=BLACK, label='robot')  # fmt: skip
    axes.plot(times.goal.x, times.goal.y, linestyle='', marker='o', markersize=11,
              markerfacecolor='none', markeredgewidth=2.0, color=BLACK, label='goal')  # fmt: skip
    axes.set_xlim(-0.5, n_x - 0.5)
    axes.set_ylim(-0.5, n_y - 0.5)
    axes.set_xlabel("x' in pose cells")
    axes.set_ylabel("y' in pose cells")
    axes.legend(loc='upper center', bbox_to_anchor=(0.5, -0.12), ncols=4, fontsize=8,
                frameon=False)  # fmt: skip
    return save_figure(figure, Path(file))


def _way(times: TemporalArray, peak: Place) -> Floats:
    """Return (n, 2) x and y of the cells from the known one nearest to the peak to the goal."""
    n_y, n_x = times.remaining_s.shape
    cells = np.flatnonzero(np.isfinite(times.remaining_s))
    away_x = np.abs(cells % n_x - peak.x)
    away_y = np.abs(cells // n_x - peak.y)
    away = np.hypot(np.minimum(away_x, n_x - away_x), np.minimum(away_y, n_y - away_y))
    way = [int(cells[np.argmin(away)])]
    while times.onward.flat[way[-1]] >= 0:
        way.append(int(times.onward.flat[way[-1]]))
    return np.array([(cell % n_x, cell // n_x) for cell in way], np.float64)


def _broken(places: Floats, n_x: int, n_y: int) -> Floats:
    """Return places with a gap (NaN) wherever they pass over an edge of the torus."""
    over = (np.abs(np.diff(places, axis=0)) > (n_x / 2, n_y / 2)).any(axis=1)
    return np.insert(places, np.flatnonzero(over) + 1, np.nan, axis=0)
