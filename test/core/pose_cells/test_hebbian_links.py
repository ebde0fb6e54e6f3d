# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hebbian links: a view is linked to all places where it is seen, and injects into each."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import ahead, extended, seen, turning

from ratslam_ros.core.pose_cells.hebbian_links import HebbianLinks
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.torus import Torus

RATE = 0.15
"""Milford et al. (2005), section IV.C."""


def cells(**changes: float) -> PoseCells:
    return PoseCells(extended('pose_cells', **{
        'pc_vt_agree_views': 0.0, 'pc_vt_learning_rate': RATE, 'pc_vt_spare_newest': False,
        'pc_dim_x': 140, 'pc_dim_y': 80, **changes,
    }))


def at(*places: tuple[int, int, int]) -> np.ndarray:
    return np.array(places, np.int64)


def test_weights_approach_the_activity_by_the_learning_rate() -> None:
    links = HebbianLinks((36, 8, 8), RATE)
    here, there = at((3, 4, 5)), at((9, 1, 2))
    for _ in range(2):
        links.learn(7, 0.0, here, np.ones(1))
    places, weights = links.recalled(7, 0.0)
    assert places.tolist() == here.tolist()
    assert weights == pytest.approx([0.15 + 0.85 * 0.15])
    links.learn(7, 0.0, there, np.ones(1))
    places, weights = links.recalled(7, 0.0)
    assert places.tolist() == [*here.tolist(), *there.tolist()]
    assert weights == pytest.approx([0.85 * 0.2775, 0.15])
    for _ in range(40):
        links.learn(7, 0.0, here, np.ones(1))
    assert links.recalled(7, 0.0)[0].tolist() == here.tolist()  # forgotten, so that it is bounded


def test_recall_turns_with_the_robot() -> None:
    links = HebbianLinks((36, 8, 8), RATE)
    links.learn(7, 35.2, at((1, 4, 5)), np.ones(1))
    assert links.recalled(7, 0.0)[0].tolist() == [[2, 4, 5]]
    assert links.recalled(7, -3.0)[0].tolist() == [[35, 4, 5]]


def test_view_of_two_places_injects_into_both() -> None:
    pose_cells = cells()
    for template_id in (0, 1, 0, 2, 3):
        pose_cells.integrate(ahead(20.0))
        pose_cells.view(seen(template_id))
    before = len(pose_cells.packets())
    pose_cells.integrate(ahead(20.0))
    pose_cells.view(seen(0))
    assert (before, len(pose_cells.packets())) == (2, 4)


CORRIDORS = (0, 1, 2, 0, 2, 1), (0, 2, 1, 0, 1, 2)
"""The views along two corridors. No view is unique: each is found twice in either."""
SPACING, GAP = 6, 15
"""From a view to the next one, and from a corridor to the other one, in cells."""
LENGTH = 5 * SPACING + GAP


def drive(pose_cells: PoseCells, distance: int) -> None:
    for _ in range(distance):
        pose_cells.integrate(ahead(1.0))


@pytest.mark.parametrize('corridor', range(2))
def test_robot_finds_itself_without_a_unique_landmark(corridor: int) -> None:
    """Milford et al. (2005), section II.D: several hypotheses converge to a single one.

    The corridors lie behind each other around the torus. After six laps the robot is carried.
    """
    pose_cells = cells(pc_dim_x=2 * LENGTH, pc_vt_inject_energy=0.6)
    start, torus = pose_cells.peak, Torus(*pose_cells.dims)

    def error(distance: int) -> float:
        return torus.distance(pose_cells.peak, start._replace(x=start.x - distance))

    for number in 6 * (0, 1):
        for at, view in enumerate(CORRIDORS[number]):
            pose_cells.view(seen(view))
            assert error(number * LENGTH + at * SPACING) < 1.0
            drive(pose_cells, SPACING if at < 5 else GAP)
    for turn_rad in 0.5 * math.pi, -0.5 * math.pi:  # the robot believes that it drives
        pose_cells.integrate(turning(turn_rad))
        drive(pose_cells, 20)
    counts, errors = [], []
    for at, view in enumerate(CORRIDORS[corridor]):
        pose_cells.view(seen(view))
        counts.append(len(pose_cells.packets()))
        drive(pose_cells, SPACING)
        errors.append(error(corridor * LENGTH + (at + 1) * SPACING))
    assert max(counts) >= 4 and errors[0] > 20.0
    assert max(errors[2:]) < 1.0
    assert pose_cells.packets()[:, 3].max() > 0.9
