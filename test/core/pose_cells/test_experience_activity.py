# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Experience activity: equations (1) to (4) of Milford et al. (2006), and selection by it."""

from __future__ import annotations

import math

import pytest
from helpers import STILL, ahead, extended, seen, turning
from hypothesis import given
from hypothesis import strategies as st

from ratslam_ros.core.pose_cells.experience_activity import activity
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.torus import Place, Torus

TORUS = Torus(21, 30, 36)
CELL = st.floats(-50.0, 50.0)
ZONE = st.floats(0.1, 10.0)


def circular_distance(a: float, b: float, extent: float) -> float:
    return min(abs(a - b + k * extent) for k in range(-6, 7))


@given(st.tuples(CELL, CELL, CELL), st.tuples(CELL, CELL, CELL), ZONE, ZONE)
def test_activity_equals_equations(
    peak: tuple[float, float, float], place: tuple[float, float, float], r_a: float, theta_a: float
) -> None:
    d_x, d_y, d_theta = (
        circular_distance(a, b, n) for a, b, n in zip(peak, place, (21, 30, 36), strict=True)
    )
    r, theta = math.sqrt(d_x**2 + d_y**2) / r_a, d_theta / theta_a
    expected = 0.0 if r > 1.0 or theta > 1.0 else 2.0 - r - theta
    found = activity(TORUS, Place(*peak), Place(*place), r_a, theta_a)
    assert 0.0 <= found <= 2.0
    assert found == pytest.approx(expected, abs=1e-9) or min(abs(r - 1), abs(theta - 1)) < 1e-9


def cells(**changes: float | str) -> PoseCells:
    return PoseCells(extended('pose_cells', **{'pc_vt_agree_views': 0.0, **changes}))  # type: ignore[arg-type]


def drive(pose_cells: PoseCells, templates: list[int], distance_m: float) -> list[MapAction]:
    actions = []
    for template_id in templates:
        pose_cells.integrate(ahead(distance_m))
        actions.append(pose_cells.view(seen(template_id)))
    return actions


def test_activity_uses_heading_of_the_view() -> None:
    pose_cells = cells()
    drive(pose_cells, [0], 1.0)
    pose_cells.integrate(turning(math.pi / 2))
    pose_cells.view(seen(0, math.pi / 2))
    ((experience, share),) = pose_cells.active_experiences()
    assert experience == 0
    assert share > 1.5
    pose_cells.view(seen(0))
    assert pose_cells.active_experiences() == []


def by_activity(**changes: float | str) -> PoseCells:
    return cells(exp_current_by='activity', pc_vt_inject_energy=0.0, **changes)


def test_most_active_experience_becomes_current_or_one_is_created() -> None:
    pose_cells = by_activity(exp_activity_xy=1.6)
    actions = drive(pose_cells, [0] * 7, 0.5)
    # Experience 0 is active within 1.6 cells; the next one is created at 2 cells.
    assert [(a.action, a.target_id) for a in actions] == [
        ('create', 0), *[('none', 0)] * 3, ('create', 1), *[('none', 1)] * 2,
    ]
    back = drive(pose_cells, [0] * 5, -0.6)  # experience 0 is active at 1.2 and at 0.6 cells
    assert [(a.action, a.target_id) for a in back] == [
        *[('none', 1)] * 3, ('link', 0), ('none', 0),
    ]
    assert [a.action for a in drive(pose_cells, [0] * 3, 0.7)] == ['none', 'set', 'none']


def test_stationary_robot_with_alternating_views_keeps_current_experience() -> None:
    pose_cells = by_activity()
    drive(pose_cells, [0, 1], 0.3)
    for n in range(20):
        pose_cells.integrate(STILL)
        action = pose_cells.view(seen(n % 3))
        assert (action.action, action.target_id) == ('none', 1)
