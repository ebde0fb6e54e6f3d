# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots of temporal maps and routes."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.config import GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Goal
from ratslam_ros.core.navigation.route_planner import RoutePlanner, TemporalMap
from ratslam_ros.errors import UnusableInput
from ratslam_ros.results.map_json import read_map_json
from ratslam_ros.results.plots import (
    BLACK,
    PALE_GREY,
    VERMILLION,
    equal_axes,
    new_figure,
    save_figure,
)

Floats = NDArray[np.float64]

ARROW_SPACING_RATIO = 0.12
"""Distance between the arrows on a route, relative to the larger side of its bounding box."""


def draw_temporal_map(
    experience_map: ExperienceMap, times: TemporalMap, file: str | Path,
    route_m: Floats | None = None, goals: Iterable[Goal] = (), title: str = '',
) -> Path:
    """Draw the experiences, coloured by travel time.

    The plot follows figures 12 and 14 of Milford et al. (2006).

    Args:
        experience_map: the map.
        times: travel times to the experiences of the map. Unreachable experiences are grey.
        file: path of the PNG to write.
        route_m: (n, 2) route in m, drawn with arrows.
        goals: goals to mark with their names.
        title: title of the plot, empty for a default.

    Returns:
        The path of the file.
    """
    from matplotlib.collections import LineCollection

    places = experience_map.poses[:, :2]
    figure = new_figure(8.0, 7.0)
    axes = figure.add_subplot()
    ends = places[experience_map.link_ends]
    axes.add_collection(LineCollection(list(ends), colors=PALE_GREY, linewidths=0.8, zorder=1))
    reachable = np.isfinite(times.arrival_s)
    size = 24.0 if len(places) < 1000 else 6.0
    x_m, y_m = places.T
    axes.scatter(x_m[~reachable], y_m[~reachable], s=size, color=PALE_GREY, zorder=2)
    scatter = axes.scatter(
        x_m[reachable], y_m[reachable], s=size, c=times.arrival_s[reachable], cmap='viridis',
        vmin=0.0, zorder=3,
    )
    figure.colorbar(scatter, ax=axes, label='time from the robot in s', shrink=0.85)
    if route_m is not None and len(route_m) > 1:
        axes.plot(*route_m.T, color=VERMILLION, linewidth=2.0, label='route', zorder=5)
        for tail, tip in _arrows(route_m):
            axes.annotate(
                '', xy=(tip[0], tip[1]), xytext=(tail[0], tail[1]), zorder=6,
                arrowprops={'arrowstyle': '-|>', 'color': VERMILLION, 'mutation_scale': 18},
            )
    axes.plot(*places[times.start_id], linestyle='', marker='X', markersize=10, color=BLACK,
              markeredgecolor='white', label='robot', zorder=7)
    for goal in goals:
        at = goal.pose_on(experience_map)
        axes.plot(at.x_m, at.y_m, linestyle='', marker='o', markersize=11, markerfacecolor='none',
                  markeredgewidth=2.0, color=BLACK, zorder=7)
        axes.annotate(
            str(goal), (at.x_m, at.y_m), textcoords='offset points', xytext=(8, 8), zorder=8
        )
    equal_axes(axes)
    axes.set_title(title or f'{len(places)} experiences, from {times.start_id}', fontsize=11)
    axes.legend(loc='best', fontsize=8)
    return save_figure(figure, file)


def draw_times(folder: str | Path, start_id: int | None, goal_id: int | None) -> Path:
    """Draw `times.png` of a results folder: the temporal map and the route to a goal.

    Args:
        folder: a results folder with a map.json.
        start_id: experience to start from, None for the last one of the robot.
        goal_id: goal experience, None for no route.

    Returns:
        The path of the file.

    Raises:
        UnusableInput: there is no readable map, or no such experience to start from.
        UnreachableGoal: there is no such goal experience, or no link leads to it.
    """
    folder = Path(folder)
    _, graph = read_map_json(folder / 'map.json')
    start = graph.current_id if start_id is None else start_id
    if not 0 <= start < len(graph):
        raise UnusableInput(
            f'there is no experience {start} to start from; expected 0 to {len(graph) - 1}'
        )
    times = RoutePlanner(GoalRecallParameters(), graph).temporal_map(start)
    route_m, goals = None, []
    if goal_id is not None:
        route_m = graph.poses[list(times.route_to(goal_id).experience_ids), :2]
        goals.append(Goal(goal_id))
    return draw_temporal_map(graph, times, folder / 'times.png', route_m, goals)


def _arrows(route_m: Floats) -> list[tuple[Floats, Floats]]:
    """Return the tail and tip positions of arrows along a route in m."""
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route_m, axis=0).T))])
    spacing_m = ARROW_SPACING_RATIO * float(np.ptp(route_m, axis=0).max())
    if spacing_m == 0.0:
        return []
    marks = np.arange(spacing_m, along_m[-1] + 0.5 * spacing_m, spacing_m)
    tips, tails = (
        np.column_stack([np.interp(at, along_m, route_m[:, axis]) for axis in range(2)])
        for at in (marks, marks - 0.2 * spacing_m)
    )
    return list(zip(tails, tips, strict=True))
