# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Localisation state of the map: unknown, uncertain or localised."""

from __future__ import annotations

import math
from functools import partial

import graphs
import numpy as np
import pytest
from graphs import arrive, new_map
from helpers import ahead

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.mapping.loop_closure_gate import LOST_COUNT, REQUIRED_COUNT
from ratslam_ros.core.mapping.odometry_noise import UNMEASURED, UNMEASURED_VIEW
from ratslam_ros.core.mapping.pose_covariance import UNCERTAIN_M, UNKNOWN

GAP = Motion(5.0, 0.0, 0.0, is_known=False)
corridor = partial(graphs.corridor, beyond_m=1.0, exp_gate_closures=True)


def test_new_map_starts_localised_at_its_origin() -> None:
    graph = new_map()
    assert graph.localisation == 'localised'
    assert not graph.covariance.matrix.any()
    graph.lose('the robot may have been moved')  # the map will begin where it is
    assert graph.localisation == 'localised'


def test_pose_is_uncertain_after_a_long_drive_without_recognition() -> None:
    graph = corridor(61)
    arrive(graph, 60)
    assert graph.covariance.matrix == pytest.approx(UNMEASURED_VIEW)

    def std_m(length_m: float) -> float:
        """Return the deviation sideways after a straight drive."""
        heading_rad2 = UNMEASURED_VIEW[2, 2] + UNMEASURED.rad2_per_m * length_m / 3.0
        own_m2 = UNMEASURED_VIEW[1, 1] + UNMEASURED.m2_per_m * length_m
        return math.sqrt(own_m2 + heading_rad2 * length_m**2)

    driven_m = 0.0
    while std_m(driven_m + 0.1) < UNCERTAIN_M:
        assert graph.localisation == 'localised'
        graph.integrate(ahead(0.1))
        driven_m += 0.1
    graph.integrate(ahead(0.2))
    assert driven_m > 1.0
    assert graph.localisation == 'uncertain'
    arrive(graph, 61)  # a new place proves nothing
    assert graph.localisation == 'uncertain'


def test_pose_is_unknown_after_a_gap_until_an_earlier_place_is_recognised() -> None:
    graph = corridor()
    graph.integrate(GAP)
    assert graph.localisation == 'unknown'
    assert np.array_equal(graph.covariance.matrix, UNKNOWN)
    arrive(graph, 13)
    graph.integrate(ahead(1.0))
    arrive(graph, 14)
    arrive(graph, 13)  # recognised, but it was learned after the gap too
    assert graph.localisation == 'unknown'
    arrive(graph, 3)
    assert (graph.localisation, graph.covariance.reason) == ('localised', '')


def test_agreeing_closures_elsewhere_make_the_pose_unknown() -> None:
    graph = corridor(16)
    states = []
    for n in range(REQUIRED_COUNT):
        arrive(graph, 2 + n)
        states.append(graph.localisation)
        graph.integrate(ahead(1.0))
    lost = LOST_COUNT - 1, REQUIRED_COUNT - LOST_COUNT
    assert states == [*['localised'] * lost[0], *['unknown'] * lost[1], 'localised']
    assert graph.current_id == 1 + REQUIRED_COUNT


def test_one_false_closure_leaves_the_pose_localised() -> None:
    graph = corridor(16)
    arrive(graph, 2)
    assert (graph.gate.rejected_count, graph.localisation) == (1, 'localised')


def test_scans_confirm_a_pose_only_in_the_main_component() -> None:
    graph = corridor()
    graph.integrate(GAP)
    arrive(graph, 13)
    graph.confirm()
    assert graph.localisation == 'unknown'


def test_map_saved_without_uncertainty_has_an_unknown_pose() -> None:
    graph, other = corridor(), new_map()
    state = graph.state()
    del state['present']
    other.restore(state)
    assert other.localisation == 'unknown'
    assert 'not saved with the map' in other.covariance.reason
    assert math.isfinite(other.pose.x_m)
