# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Localisation state of the map: unknown, uncertain or localised."""

from __future__ import annotations

import math

import pytest
from graphs import arrive, new_map
from helpers import ahead

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.loop_closure_gate import LOST_COUNT, REQUIRED_COUNT
from ratslam_ros.core.mapping.pose_uncertainty import UNCERTAIN_M2, UNKNOWN_M2, UNKNOWN_RAD2
from ratslam_ros.core.mapping.scan_matching import DRIFT_M2_PER_M, VIEW_SD_M

GAP = Motion(5.0, 0.0, 0.0, is_known=False)


def corridor(metres: int = 12) -> ExperienceMap:
    """Drive straight ahead, with an experience every metre."""
    graph = new_map(exp_jump_drift=0.05)
    for n in range(metres + 1):
        arrive(graph, n)
        graph.integrate(ahead(1.0))
    return graph


def test_new_map_starts_localised_at_its_origin() -> None:
    graph = new_map()
    assert (graph.localisation, graph.uncertainty.variances) == ('localised', (0.0, 0.0))
    graph.lose('the robot may have been moved')  # the map will begin where it is
    assert graph.localisation == 'localised'


def test_pose_is_uncertain_after_a_long_drive_without_recognition() -> None:
    graph = corridor(60)
    arrive(graph, 60)
    assert graph.uncertainty.variances.position_m2 == VIEW_SD_M**2
    distance_m = (UNCERTAIN_M2 - VIEW_SD_M**2) / DRIFT_M2_PER_M
    graph.integrate(ahead(distance_m - 0.1))
    assert graph.localisation == 'localised'
    graph.integrate(ahead(0.2))
    assert graph.localisation == 'uncertain'
    arrive(graph, 61)  # a new place proves nothing
    assert graph.localisation == 'uncertain'


def test_pose_is_unknown_after_a_gap_until_an_earlier_place_is_recognised() -> None:
    graph = corridor()
    graph.integrate(GAP)
    assert graph.localisation == 'unknown'
    assert graph.uncertainty.variances == (UNKNOWN_M2, UNKNOWN_RAD2)
    arrive(graph, 13)
    graph.integrate(ahead(1.0))
    arrive(graph, 14)
    arrive(graph, 13)  # recognised, but it was learned after the gap too
    assert graph.localisation == 'unknown'
    arrive(graph, 3)
    assert (graph.localisation, graph.uncertainty.reason) == ('localised', '')


def test_agreeing_closures_elsewhere_make_the_pose_unknown() -> None:
    graph = corridor(40)
    states = []
    for n in range(REQUIRED_COUNT):
        arrive(graph, 2 + n)
        states.append(graph.localisation)
        graph.integrate(ahead(1.0))
    lost = LOST_COUNT - 1, REQUIRED_COUNT - LOST_COUNT
    assert states == [*['localised'] * lost[0], *['unknown'] * lost[1], 'localised']
    assert graph.current_id == 1 + REQUIRED_COUNT


def test_one_false_closure_leaves_the_pose_localised() -> None:
    graph = corridor(40)
    arrive(graph, 2)
    assert (graph.gate.rejected_count, graph.localisation) == (1, 'localised')


def test_scans_do_not_make_an_unknown_pose_known() -> None:
    graph = corridor()
    graph.uncertainty.align(0.01)
    assert graph.uncertainty.variances.position_m2 == 0.01
    graph.lose('the robot may have been moved')
    graph.uncertainty.align(0.01)
    assert graph.localisation == 'unknown'


@pytest.mark.parametrize('reason', ['', 'laser scans contradict it'])
def test_restored_map_keeps_the_localisation(reason: str) -> None:
    graph, other = corridor(), new_map()
    if reason:
        graph.lose(reason)
    other.restore(graph.state())
    assert other.localisation == graph.localisation
    assert other.uncertainty.reason == reason
    assert other.uncertainty.variances == graph.uncertainty.variances


def test_map_saved_without_uncertainty_has_an_unknown_pose() -> None:
    graph, other = corridor(), new_map()
    state = graph.state()
    del state['present']
    other.restore(state)
    assert other.localisation == 'unknown'
    assert 'not saved with the map' in other.uncertainty.reason
    assert math.isfinite(other.pose.x_m)
