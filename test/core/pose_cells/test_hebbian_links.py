# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hebbian links: a view is linked to all places where it is seen, and injects into each."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import ahead, extended, seen

from ratslam_ros.core.pose_cells.hebbian_links import HebbianLinks
from ratslam_ros.core.pose_cells.pose_cells import PoseCells

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
