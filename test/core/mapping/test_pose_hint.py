# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses that an operator gives: the robot is there at once, and recognised places decide."""

from __future__ import annotations

import json
import math
from functools import partial

import graphs
import numpy as np
import pytest
from graphs import arrive, new_map
from helpers import ahead

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.pose_hint import LONGEST_M, PoseHint
from ratslam_ros.errors import UnusableInput


def hint(pose: Pose, sd_m: float = 0.5, sd_rad: float = 0.26) -> PoseHint:
    return PoseHint(pose, sd_m**2, 0.0, sd_m**2, sd_rad**2).checked()


corridor = partial(graphs.corridor, beyond_m=1.0, exp_gate_closures=True)


@pytest.mark.parametrize('gated', [True, False])
def test_given_pose_moves_the_robot_at_once(gated: bool) -> None:
    graph = corridor(exp_gate_closures=gated)
    given = Pose(2.0, 0.5, 0.1)
    assert graph.suggest(hint(given))
    assert graph.pose == pytest.approx(given)
    assert graph.localisation == 'uncertain'
    assert graph.covariance.matrix == pytest.approx(np.diag([0.25, 0.25, 0.26**2]))
    graph.integrate(ahead(1.0))
    assert graph.pose[:2] == pytest.approx((2.0 + math.cos(0.1), 0.5 + math.sin(0.1)))


@pytest.mark.parametrize('gated', [True, False])
def test_agreeing_place_confirms_a_given_pose(gated: bool) -> None:
    graph = corridor(exp_gate_closures=gated)
    before = graph.poses
    graph.suggest(hint(Pose(2.4, 0.3, 0.1)))
    arrive(graph, 2)
    assert (graph.hint, graph.localisation, graph.current_id) == (None, 'localised', 2)
    assert graph.pose == pytest.approx(graph.pose_of(2))
    assert np.array_equal(graph.poses, before)
    assert graph.link_count == 12  # the robot was carried, so nothing links both places


@pytest.mark.parametrize('gated', [True, False])
def test_two_agreeing_places_refute_a_given_pose(gated: bool) -> None:
    graph = corridor(exp_gate_closures=gated)
    before = graph.poses
    graph.suggest(hint(Pose(2.0, -20.0, 0.0)))
    arrive(graph, 11)
    assert (graph.localisation, graph.pose) == ('uncertain', pytest.approx((2.0, -20.0, 0.0)))
    graph.integrate(ahead(1.0))
    arrive(graph, 12)
    assert (graph.hint, graph.localisation, graph.current_id) == (None, 'localised', 12)
    assert np.array_equal(graph.poses, before)


def test_places_that_disagree_do_not_refute_a_given_pose() -> None:
    graph = corridor()
    graph.suggest(hint(Pose(2.0, -20.0, 0.0)))
    for target in (11, 3, 9, 1):
        arrive(graph, target)
        graph.integrate(ahead(1.0))
    assert graph.localisation == 'uncertain'
    assert graph.pose == pytest.approx((6.0, -20.0, 0.0))


def test_places_learned_at_a_wrong_given_pose_move_to_the_right_one() -> None:
    graph = corridor()
    graph.suggest(hint(Pose(2.0, -20.0, 0.0)))  # but the robot is 3 m before experience 5
    arrive(graph, 13)
    graph.integrate(ahead(3.0))
    assert graph.pose_of(13) == pytest.approx((2.0, -20.0, 0.0))
    arrive(graph, 5)
    graph.integrate(ahead(1.0))
    arrive(graph, 6)
    assert graph.localisation == 'localised'
    assert graph.component_count == 1
    assert graph.pose_of(13) == pytest.approx((2.0, 0.0, 0.0))


def test_unconfirmed_given_pose_is_dropped() -> None:
    graph = corridor()
    graph.suggest(hint(Pose(2.0, -20.0, 0.0)))
    graph.integrate(ahead(LONGEST_M))
    assert graph.localisation == 'uncertain'
    graph.integrate(ahead(0.1))
    assert (graph.hint, graph.localisation) == (None, 'unknown')
    assert 'confirmed the given pose' in graph.covariance.reason


def test_given_pose_at_the_estimate_has_no_effect() -> None:
    graph = corridor()
    pose = graph.pose
    assert not graph.suggest(hint(graph.pose._replace(y_m=0.3)))
    assert (graph.pose, graph.localisation) == (pose, 'localised')
    graph.lose('the robot may have been moved')
    assert graph.suggest(hint(graph.pose))  # now it is evidence
    assert not new_map().suggest(hint(Pose(1.0, 0.0, 0.0)))  # an empty map begins at the robot


def test_restored_map_keeps_the_given_pose() -> None:
    graph, other = corridor(), new_map(exp_gate_closures=True)
    graph.suggest(hint(Pose(2.0, -20.0, 0.0)))
    arrive(graph, 11)
    other.restore(graph.state() | {'present': json.loads(json.dumps(graph.state()['present']))})
    assert (other.hint, other.localisation, other.pose) == (graph.hint, 'uncertain', graph.pose)
    for one in graph, other:
        one.integrate(ahead(1.0))
        arrive(one, 12)
    assert other.pose == graph.pose


@pytest.mark.parametrize(
    'values',
    [(math.nan, 0.0, 1.0, 0.0, 1.0, 1.0), (0.0, 0.0, -1.0, 0.0, 1.0, 1.0),
     (0.0, 0.0, 1.0, 2.0, 1.0, 1.0), (0.0, 0.0, 1.0, 0.0, 1.0, math.inf)],
)
def test_unusable_hints_are_refused(values: tuple[float, ...]) -> None:
    x, y, *covariance = values
    with pytest.raises(UnusableInput, match='expected'):
        PoseHint(Pose(x, y, 0.0), *covariance).checked()
