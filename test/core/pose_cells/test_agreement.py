# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How much one recognised view is believed."""

from __future__ import annotations

import math

import pytest

from ratslam_ros.core.pose_cells.agreement import MOST_CLAIMS, Agreement
from ratslam_ros.core.pose_cells.torus import Place, Torus

TORUS = Torus(30, 30, 36)
HERE, THERE = Place(10.0, 10.0, 0.0), Place(20.0, 20.0, 18.0)


def agreement(views: float = 3.0) -> Agreement:
    return Agreement(TORUS, views, radius_cells=3.0, spacing_cells=2.0, recent=8)


def ahead(place: Place, cells: float) -> Place:
    return TORUS.moved(place, cells, 0.0)


def test_views_that_agree_on_the_way_are_believed_more_and_more() -> None:
    claims = agreement()
    weights = []
    for n in range(6):
        weights.append(claims.weigh(n, ahead(HERE, 2.0 * n), THERE))
        claims.integrate(2.0, 0.0)
    assert weights == pytest.approx([((n + 1) / 3) ** 4 for n in range(6)])


def test_many_views_from_one_place_count_once() -> None:
    claims = agreement()
    weights = []
    for n in range(40):
        weights.append(claims.weigh(n, ahead(HERE, 0.02 * n), THERE))
        claims.integrate(0.02, 0.0)
    assert max(weights) == pytest.approx((1 / 3) ** 4)


def test_claims_that_do_not_move_with_the_robot_do_not_agree() -> None:
    claims = agreement()
    for n in range(6):
        weight = claims.weigh(n, HERE, THERE)  # always the same place, though the robot drives
        claims.integrate(4.0, 0.0)
    assert weight == pytest.approx((1 / 3) ** 4)


def test_views_for_the_believed_place_oppose() -> None:
    claims = agreement()
    believed = THERE
    for n in range(4):
        claims.weigh(n, believed, believed)
        claims.integrate(2.0, 0.0)
        believed = ahead(believed, 2.0)
    assert claims.weigh(9, HERE, believed) == 0.0


def test_turning_on_the_spot_shows_different_places() -> None:
    claims = agreement()
    heading = 0.0
    for n in range(37):
        weight = claims.weigh(n, Place(HERE.x, HERE.y, heading), THERE)
        claims.integrate(0.0, 1.0)
        heading += 1.0
    assert weight > 1.0


@pytest.mark.parametrize(('off_cells', 'needed'), [
    (0.0, 2.0), (2.0, 2.0), (5.0, 3.0), (9.9, 5.94), (10.0, 6.0), (math.inf, 6.0)
])  # fmt: skip
def test_a_claim_close_by_needs_fewer_views(off_cells: float, needed: float) -> None:
    claims = Agreement(TORUS, 6.0, 3.0, 2.0, recent=8, near_cells=10.0)
    weights = []
    for n in range(4):
        weights.append(claims.weigh(n, ahead(HERE, 2.0 * n), THERE, off_cells))
        claims.integrate(2.0, 0.0)
    assert weights == pytest.approx([((n + 1) / needed) ** 4 for n in range(4)])


def test_however_many_agree_on_a_place_close_by_they_count_as_twice_as_many_as_needed() -> None:
    claims = Agreement(TORUS, 6.0, 3.0, 2.0, recent=8, near_cells=10.0)
    for n in range(8):
        weight = claims.weigh(n, ahead(HERE, 2.0 * n), THERE, 1.0)
        claims.integrate(2.0, 0.0)
    assert weight == 2.0**4


def test_without_a_nearness_all_claims_need_as_many() -> None:
    claims = agreement()
    assert claims.weigh(0, HERE, THERE, 0.0) == pytest.approx((1 / 3) ** 4)


def test_switched_off_each_view_counts_fully() -> None:
    claims = agreement(views=0.0)
    assert claims.weigh(0, HERE, THERE) == 1.0


def test_what_is_remembered_is_bounded() -> None:
    claims = agreement()
    for n in range(10 * MOST_CLAIMS):
        claims.weigh(n, Place(n % 7, n % 5, math.pi), THERE)
        claims.integrate(1e-6, 0.0)
    assert len(claims) == MOST_CLAIMS
