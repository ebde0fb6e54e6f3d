# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""New experiences at known places: they are linked to the older ones, or supersede them.

At the limit of experiences, superseded ones are pruned first.
"""

from __future__ import annotations

import math

from helpers import extended

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.vision.local_view import ViewMatch

LAP = 40
LIMIT = 60
STEP = Motion(0.1, 0.25, 2.0 * math.pi / LAP)
LOOKS_LIKE = {25: 5}
"""Place at the other side of the circle with the view of another one."""


def driven(
    laps: int, look_alikes: dict[int, int] | None = None, limit: int = LIMIT
) -> tuple[PoseCells, list[int], list[tuple[int, int]]]:
    """Drive laps on a circle.

    Returns:
        The pose cells, the pruned ids, and pairs of the present place and that at which the
        recognised experience was created.
    """
    cells = PoseCells(extended(
        'pose_cells', exp_view_links=True, exp_max=limit, pc_dim_x=LAP // 2, pc_dim_y=LAP // 2,
        pc_cell_x_size=0.5, exp_delta_pc_threshold=0.6,
    ))
    pruned: list[int] = []
    recognised: list[tuple[int, int]] = []
    created_at: dict[int, int] = {}
    for lap in range(laps):
        for place in range(LAP):
            cells.integrate(STEP)
            view = (look_alikes or {}).get(place, place)
            action = cells.view(ViewMatch(view, lap == 0 and view == place, 0.0, 0.0))
            if action.recognised_id >= 0 and view == place:
                recognised.append((place, created_at[action.recognised_id]))
            if action.action == 'create':
                if action.target_id in created_at:
                    pruned.append(action.target_id)
                created_at[action.target_id] = place
    return cells, pruned, recognised


def test_older_experience_at_the_same_place_goes_first() -> None:
    cells, pruned, _ = driven(3)
    assert len(cells.state()['experiences']) <= LIMIT
    assert pruned
    # Each place still has an experience, although as many as have room were driven twice.
    templates = {int(row[0]) for row in cells.state()['experiences']}
    assert len(templates) == len({int(row[0]) for row in driven(1)[0].state()['experiences']})


def test_map_without_a_limit_stops_growing_on_known_ground() -> None:
    once, twice, many = (
        len(driven(laps, limit=0)[0].state()['experiences']) for laps in (1, 6, 60)
    )
    assert once < twice <= 1.5 * once
    assert many == twice


def test_recognised_experience_is_at_the_place_of_the_view() -> None:
    # The experiences created with the views are pruned; those at look-alikes may be older than
    # the ones that replace them.
    _, pruned, recognised = driven(6, LOOKS_LIKE)
    assert len(pruned) > LAP
    assert {place for place, _ in recognised} >= set(LOOKS_LIKE.values())
    for place, created_at in recognised:
        assert abs(place - created_at) <= 2


def test_new_experience_of_a_known_view_is_linked_without_chains() -> None:
    """Too few views agree to correct the pose, so that a second row of places grows."""
    cells = PoseCells(extended(
        'pose_cells', exp_view_links=False, exp_weigh_links=True, pc_vt_agree_views=4.0,
        pc_vt_agree_spacing=0.9, pc_dim_x=LAP, pc_dim_y=LAP, pc_cell_x_size=0.5,
        exp_delta_pc_threshold=0.6,
    ))
    ahead = Motion(0.1, 0.5, 0.0)
    first = []
    for place in range(20):
        cells.integrate(ahead)
        first.append(cells.view(ViewMatch(place, True, 0.0, 0.0)))
    assert all(action.recognised_id == NO_EXPERIENCE for action in first)
    cells.integrate(Motion(0.1, -8.0, 0.0))  # according to odometry; in truth 9 m
    again = [cells.view(ViewMatch(1, False, 0.0, 0.0))]
    cells.integrate(ahead)
    again.append(cells.view(ViewMatch(2, False, 0.0, 0.0)))
    assert [action.action for action in again] == ['create', 'create']
    assert [action.recognised_id for action in again] == [1, 2]
    assert 0.0 < again[0].agreement < again[1].agreement < 1.0


def test_marks_are_restored() -> None:
    cells, _, _ = driven(2)
    state = cells.state()
    assert len(state['superseded']) > 0
    other = PoseCells(cells._p)
    other.restore(state)
    assert other.state()['superseded'].tolist() == state['superseded'].tolist()
