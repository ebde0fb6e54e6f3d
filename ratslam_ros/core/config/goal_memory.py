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
        False, 'Learn a goal memory on the pose cells, beside the experience map.',
        raise_if='goals should be reached on the pose cells',
        lower_if='goals are reached on the experience map',
    )
    goal_memory_update: str = parameter(
        'cell',
        'When links between cells are observed. cell: after each cell driven, between strongly '
        'active cells; routes follow links, and blocked ways are learned. iteration: every 0.1 s, '
        'between all active cells, by equations (2) to (5) of Milford et al. (2005) as printed; '
        'the direction is that in which the time decreases fastest, and nothing else.',
        choices=('cell', 'iteration'),
        raise_if='leave at cell', lower_if='set to iteration to compare with the paper',
    )
