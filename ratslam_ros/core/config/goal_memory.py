# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the goal memory."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter


@dataclass(frozen=True)
class GoalMemoryParameters(Section):
    """Navigation on the pose cells: travel times between cells (Milford et al. 2005)."""

    goal_memory: bool = parameter(
        False, '', 0, 1, 'Learn a goal memory on the pose cells, beside the experience map.',
        'goals should be reached on the pose cells', 'goals are reached on the experience map',
    )  # fmt: skip
    goal_memory_step_cells: float = parameter(
        1.0, 'cells', 0.0, 1000.0,
        'Distance between updates of the links: they are learned whenever the activity peak has '
        'moved this far. 0: at every odometry message while the robot moves, as in the paper.',
        'slow and fast routes should differ more clearly', 'routes cut corners',
    )  # fmt: skip
    goal_memory_active_share: float = parameter(
        0.3, 'of the largest activity', 0.01, 1.0,
        'Cells with at least this activity, summed over all headings, are linked.',
        'routes change over to neighbouring paths', 'routes are interrupted at discontinuities',
    )  # fmt: skip
    goal_memory_eta_tau: float = parameter(
        1.0, '', 0.0, 1000.0, 'Weight of the elapsed time in the length of a link.',
        'slow routes should be avoided', 'short routes should be preferred to fast ones',
    )  # fmt: skip
    goal_memory_eta_chi: float = parameter(
        0.25, 's', 0.0, 1000.0, "Weight of the weakness of the linked cells' activity.",
        'routes run beside the path that was driven', 'weak packets should bridge discontinuities',
    )  # fmt: skip
    goal_memory_eta_delta: float = parameter(
        0.1, 's per cell', 0.0, 1000.0, 'Weight of the distance between the linked cells.',
        'routes jump across the pose cells', 'discontinuities count as long distances',
    )  # fmt: skip
    goal_memory_search_cells: float = parameter(
        4.0, 'cells', 1.5, 1000.0,
        'Radius around the peak in which cells contribute to the direction to the goal.',
        'the direction fluctuates, or the robot leaves the known cells',
        'the robot is led across walls',
    )  # fmt: skip
    goal_memory_reached_cells: float = parameter(
        1.0, 'cells', 0.01, 1000.0,
        'The goal is reached when the peak is within this distance of it, as in the paper.',
        'the robot turns back and forth beside its goal', 'it stops short of its goal',
    )  # fmt: skip
