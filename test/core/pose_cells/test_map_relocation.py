# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relocations of the map reach the pose cells a fixed number of views later."""

from __future__ import annotations

import math

import pytest
from helpers import ahead, extended, seen, turning

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.pose_cells.map_relocation import (
    ADOPTION_DELAY,
    MapRelocation,
    MapRelocations,
)
from ratslam_ros.core.pose_cells.pose_cells import PoseCells

HERE = MapRelocation(0, 0, Pose(0.5, 0.25, 0.3))


def test_relocation_is_due_after_the_delay_only() -> None:
    relocations = MapRelocations()
    relocations.answer(7, HERE)
    assert [n for n in range(20) if relocations.due(n) is not None] == [7 + ADOPTION_DELAY]
    assert relocations.due(7 + ADOPTION_DELAY) is None


def test_views_wait_for_the_answer_a_delay_before() -> None:
    relocations = MapRelocations()
    assert not relocations.is_awaited(100)
    relocations.answer(3, None)
    assert [relocations.is_awaited(n) for n in (3 + ADOPTION_DELAY, 4 + ADOPTION_DELAY)] == [
        False, True,
    ]


def driven() -> PoseCells:
    """Create an experience, and drive so far that two views are at other places."""
    cells = PoseCells(extended('pose_cells', pc_dim_x=61, pc_dim_y=61, pc_cell_x_size=0.25))
    for template in range(8):
        cells.integrate(ahead(0.5))
        cells.view(seen(template, is_new=True))
    return cells


def test_relocated_activity_includes_the_motion_since() -> None:
    cells = driven()
    start = cells._experiences[0].located.place
    for n in range(ADOPTION_DELAY):
        if n:
            cells.integrate(ahead(0.1))
            cells.integrate(turning(0.05))
        cells.view(seen(90 + n, is_new=True))
    cells.integrate(ahead(0.2))
    assert cells.relocate(HERE)
    assert cells.current_experience == 0
    pose = composed(Pose(0.0, 0.0, 2.0 * math.pi * start.theta / 36), HERE.offset)
    for distance_m, turn_rad in ((0.1, 0.05), (0.1, 0.05), (0.1, 0.05), (0.2, 0.0)):
        pose = composed(pose, Pose(distance_m, 0.0, turn_rad))
    x, y, heading_rad = pose
    assert cells.peak.x == pytest.approx((start.x + x / 0.25) % 61, abs=0.3)
    assert cells.peak.y == pytest.approx((start.y + y / 0.25) % 61, abs=0.3)
    assert cells.peak.theta == pytest.approx(36 * heading_rad / (2.0 * math.pi) % 36, abs=0.3)
    cells.integrate(ahead(0.5))
    assert cells.view(seen(99, is_new=True)).source_id == 0


@pytest.mark.parametrize('relocation', [
    HERE._replace(template_id=3), HERE._replace(experience_id=1000),
])
def test_relocation_to_a_pruned_experience_is_ignored(relocation: MapRelocation) -> None:
    cells = driven()
    before = cells.peak, cells.current_experience
    assert not cells.relocate(relocation)
    assert (cells.peak, cells.current_experience) == before


def test_relocation_before_a_gap_is_ignored() -> None:
    cells = driven()
    cells.integrate(Motion(10.0, 0.0, 0.0, False))
    assert not cells.relocate(HERE)
