# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the goal memory."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter


@dataclass(frozen=True)
class GoalMemoryParameters(Section):
    """Times between places, learned on the pose cells themselves: the older way to goals."""

    goal_memory: bool = parameter(
        False, '', 0, 1, 'Learn a goal memory on the pose cells, beside the experience map.',
        'goals shall be reached on the pose cells', 'goals are reached on the experience map',
    )  # fmt: skip
    goal_memory_step_cells: float = parameter(
        1.0, 'cells', 0.0, 1000.0,
        'Links are learned whenever the peak of activity has moved this far; 0: at every odometry '
        'message while the robot moves, as in the paper.',
        'slow ways should be told from fast ones more clearly', 'routes cut corners',
    )  # fmt: skip
    goal_memory_active_share: float = parameter(
        0.3, 'of the largest activity', 0.01, 1.0,
        'Cells with at least this activity, over all headings, are linked.',
        'routes pass from one way to another beside it', 'routes break off at discontinuities',
    )  # fmt: skip
    goal_memory_eta_tau: float = parameter(
        1.0, '', 0.0, 1000.0, 'Weight of the time that passed in the length of a link.',
        'slow ways should be avoided', 'short ways should be preferred to quick ones',
    )  # fmt: skip
    goal_memory_eta_chi: float = parameter(
        0.25, 's', 0.0, 1000.0, 'Weight of how weakly active the linked cells are.',
        'routes run beside the way that was driven', 'weak packets should bridge discontinuities',
    )  # fmt: skip
    goal_memory_eta_delta: float = parameter(
        0.1, 's per cell', 0.0, 1000.0, 'Weight of the distance of the linked cells.',
        'routes jump across the pose cells', 'discontinuities are taken for long ways',
    )  # fmt: skip
    goal_memory_search_cells: float = parameter(
        4.0, 'cells', 1.5, 1000.0,
        'The direction to the goal is looked for among the cells this near to the peak.',
        'the direction is restless, or the robot leaves the cells it knows',
        'the robot is led across walls',
    )  # fmt: skip
    goal_memory_reached_cells: float = parameter(
        1.0, 'cells', 0.01, 1000.0,
        'The robot is at its goal when the peak is this near to it, as in the paper.',
        'the robot turns to and fro beside its goal', 'it stops short of its goal',
    )  # fmt: skip
