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
    goal_memory_update: str = parameter(
        'cell', '', 0, 0,
        'When links between cells are observed. cell: after each cell driven, between strongly '
        'active cells. iteration: every 0.1 s, between all active cells, by equations (2) to (5) '
        'of Milford et al. (2005) as printed.',
        'leave at cell', 'set to iteration to compare with the paper',
        choices=('cell', 'iteration'),
    )  # fmt: skip
