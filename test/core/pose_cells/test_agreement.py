# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Weights of recognised views: agreement of pose hypotheses that follow the odometry."""

from __future__ import annotations

import math

import pytest
from helpers import extended

from ratslam_ros.core.pose_cells.agreement import MAX_HYPOTHESES_COUNT, Agreement
from ratslam_ros.core.pose_cells.lengths import Lengths
from ratslam_ros.core.pose_cells.torus import Place, Torus

TORUS = Torus(30, 30, 36)
HERE, THERE = Place(10.0, 10.0, 0.0), Place(20.0, 20.0, 18.0)


def agreement(views: float = 3.0) -> Agreement:
    parameters = extended(
        'pose_cells', pc_vt_agree_cells=3.0, pc_vt_agree_spacing=2.0
    )
    return Agreement(TORUS, Lengths(parameters), views)


def ahead(place: Place, cells: float) -> Place:
    direction = place.theta / TORUS.planes_per_rad
    return Place(
        place.x + cells * math.cos(direction), place.y + cells * math.sin(direction), place.theta
    )


def test_agreeing_views_while_driving_increase_weight() -> None:
    hypotheses = agreement()
    weights = []
    for n in range(6):
        weights.append(hypotheses.weigh(n, ahead(HERE, 2.0 * n), THERE))
        hypotheses.integrate(2.0, 0.0)
    assert weights == pytest.approx([((n + 1) / 3) ** 4 for n in range(6)])


def test_share_counts_agreeing_views_whatever_the_estimate() -> None:
    hypotheses = agreement(views=4.0)
    shares = []
    for n in range(6):
        hypotheses.weigh(n, ahead(HERE, 2.0 * n), THERE)
        shares.append(hypotheses.share(n))
        hypotheses.integrate(2.0, 0.0)
    assert shares == [0.25, 0.5, 0.75, 1.0, 1.0, 1.0]
    hypotheses.weigh(9, Place(25.0, 5.0, 9.0), THERE)
    assert hypotheses.share(9) == 0.25
    assert hypotheses.share(3) == 0.0  # not the latest view


def test_many_views_from_one_place_count_once() -> None:
    hypotheses = agreement()
    weights = []
    for n in range(40):
        weights.append(hypotheses.weigh(n, ahead(HERE, 0.02 * n), THERE))
        hypotheses.integrate(0.02, 0.0)
    assert max(weights) == pytest.approx((1 / 3) ** 4)


def test_hypotheses_contradicting_odometry_do_not_agree() -> None:
    hypotheses = agreement()
    for n in range(6):
        weight = hypotheses.weigh(n, HERE, THERE)  # always the same place although the robot moves
        hypotheses.integrate(4.0, 0.0)
    assert weight == pytest.approx((1 / 3) ** 4)


@pytest.mark.parametrize(
    ('drift_cells', 'estimate', 'count'), [(1.2, None, 6), (1.2, THERE, 3), (4.0, None, 1)]
)
def test_views_of_another_component_agree_in_spite_of_drift(
    drift_cells: float, estimate: Place | None, count: int
) -> None:
    """The first and the last are 6 cells apart, twice the distance at which neighbours agree."""
    hypotheses = agreement()
    for n in range(6):
        drifted = HERE._replace(y=HERE.y + drift_cells * n)
        weight = hypotheses.weigh(n, ahead(drifted, 2.0 * n), estimate)
        hypotheses.integrate(2.0, 0.0)
    assert weight == pytest.approx((count / 3) ** 4)


def test_recognitions_of_two_places_in_turn_count_apart() -> None:
    hypotheses = agreement()
    for n in range(6):
        weight = hypotheses.weigh(n, ahead((HERE, THERE)[n % 2], 2.0 * n), None)
        hypotheses.integrate(2.0, 0.0)
    assert weight == pytest.approx(1.0)  # three of each


def test_views_supporting_current_estimate_reduce_weight() -> None:
    hypotheses = agreement()
    estimate = THERE
    for n in range(4):
        hypotheses.weigh(n, estimate, estimate)
        hypotheses.integrate(2.0, 0.0)
        estimate = ahead(estimate, 2.0)
    assert hypotheses.weigh(9, HERE, estimate) == 0.0


def test_views_while_turning_on_the_spot_count_separately() -> None:
    hypotheses = agreement()
    heading = 0.0
    for n in range(37):
        weight = hypotheses.weigh(n, Place(HERE.x, HERE.y, heading), THERE)
        hypotheses.integrate(0.0, 1.0)
        heading += 1.0
    assert weight > 1.0


def test_number_of_hypotheses_is_bounded() -> None:
    hypotheses = agreement()
    for n in range(10 * MAX_HYPOTHESES_COUNT):
        hypotheses.weigh(n, Place(n % 7, n % 5, math.pi), THERE)
        hypotheses.integrate(1e-6, 0.0)
    assert len(hypotheses.state()['claims']) == MAX_HYPOTHESES_COUNT
