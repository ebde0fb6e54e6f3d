# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""At the limit of experiences, those with a younger one at their place are pruned first."""

from __future__ import annotations

from helpers import ahead

from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.vision.local_view import ViewMatch

LAP = 40
LIMIT = 60


def driven(laps: int) -> tuple[PoseCells, list[int]]:
    """Drive laps on a straight that returns by the edge of the torus; return pruned ids."""
    cells = PoseCells(PoseCellsParameters(
        exp_view_links=True, exp_max=LIMIT, pc_dim_x=LAP // 2, pc_dim_y=LAP // 2,
        pc_cell_x_size=0.5, exp_delta_pc_threshold=0.6,
    ))  # fmt: skip
    pruned, count = [], 0
    for lap in range(laps):
        for place in range(LAP):
            cells.integrate(ahead(0.25))
            action = cells.view(ViewMatch(place, lap == 0, 0.0, 0.0))
            if action.action == 'create':
                if action.target_id < count:
                    pruned.append(action.target_id)
                count = max(count, action.target_id + 1)
    return cells, pruned


def test_older_experience_at_the_same_place_goes_first() -> None:
    cells, pruned = driven(3)
    assert len(cells.state()['experiences']) == LIMIT
    assert pruned
    # Each place still has an experience, although as many as have room were driven twice.
    templates = {int(row[0]) for row in cells.state()['experiences']}
    assert len(templates) == len({int(row[0]) for row in driven(1)[0].state()['experiences']})


def test_marks_are_restored() -> None:
    cells, _ = driven(2)
    state = cells.state()
    assert len(state['superseded']) > 0
    other = PoseCells(cells._p)
    other.restore(state)
    assert other.state()['superseded'].tolist() == state['superseded'].tolist()
