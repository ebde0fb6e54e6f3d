# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Agreement of scans with stored ones: at the same place, at others, and behind corners."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scans import HALL, ORIGIN, ROOM, scan_points

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.mapping.place_scans import NO_BEAMS, Agreement, PlaceGrid

STORED = [Pose(0.0, 0.0, 0.0), Pose(0.0, 0.5, math.pi), Pose(1.0, 0.5, math.pi / 2)]
GRID = PlaceGrid([(pose, scan_points(ROOM, pose)) for pose in STORED], 0.0, 0.0)


@given(st.floats(-0.8, 0.8), st.floats(-0.6, 1.0), st.floats(-3.1, 3.1))
@settings(max_examples=30, deadline=None)
def test_scan_at_its_own_pose_agrees(x_m: float, y_m: float, heading_rad: float) -> None:
    pose = Pose(x_m, y_m, heading_rad)
    found = GRID.agreement(scan_points(ROOM, pose), pose)
    assert found.share > 0.95


@given(st.floats(0.5, 1.0), st.floats(-3.1, 3.1))
@settings(max_examples=30, deadline=None)
def test_displaced_pose_is_contradicted(away_m: float, towards_rad: float) -> None:
    pose = Pose(away_m * math.cos(towards_rad), away_m * math.sin(towards_rad), 0.0)
    assert GRID.agreement(scan_points(ROOM, ORIGIN), pose).share < 0.9


def test_scan_of_another_room_is_contradicted() -> None:
    assert GRID.agreement(scan_points(HALL, ORIGIN), ORIGIN).share < 0.5


def test_agreement_is_independent_of_the_frame() -> None:
    frame = Pose(12.3, -4.5, 0.7)
    stored = [(composed(frame, pose), scan_points(ROOM, pose)) for pose in STORED]
    moved = PlaceGrid(stored, frame.x_m, frame.y_m)
    for pose in (ORIGIN, Pose(0.7, 0.4, 1.0)):
        points = scan_points(ROOM, pose)
        here, there = GRID.agreement(points, pose), moved.agreement(points, composed(frame, pose))
        assert np.array(here) == pytest.approx(np.array(there), abs=6)


def test_unseen_surroundings_are_unknown() -> None:
    grid = PlaceGrid([(ORIGIN, scan_points(ROOM, ORIGIN))], 0.0, 0.0)
    behind = Pose(0.0, 0.0, math.pi)
    found = grid.agreement(scan_points(ROOM, behind), behind)
    assert found.known_share < 0.2
    assert found.contradicting == 0


def test_wall_that_was_removed_contradicts() -> None:
    table = ROOM[:1]
    found = GRID.agreement(scan_points(table, ORIGIN), ORIGIN)
    assert 5 < found.contradicting < 40
    assert found.share > 0.7


def test_points_outside_the_grid_are_unknown() -> None:
    far = np.array([[50.0, 0.0], [0.0, -50.0]])
    assert PlaceGrid([], 0.0, 0.0).agreement(far, ORIGIN) == Agreement(0, 0, 2)


def test_empty_scan_neither_agrees_nor_contradicts() -> None:
    found = GRID.agreement(np.zeros((0, 2)), ORIGIN)
    assert found == NO_BEAMS
    assert (found.share, found.known_share) == (1.0, 0.0)
