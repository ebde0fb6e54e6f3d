# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot that was carried: its views are not those of the map, until it is found elsewhere."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from graphs import arrive, go, new_map
from states import filed

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.saved import check
from ratslam_ros.core.mapping.carried import (
    AGREEING_COUNT,
    LOST,
    MOST,
    MOVED_M,
    NEW,
    SEEN,
    Carried,
)
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.scan_match import ScanMatch
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.errors import UnusableInput

COUNT = 100
STEP = Motion(1.0, 1.0, math.tau / COUNT)
"""A loop of 100 m, in steps of 1 m."""

NEW_COUNT = math.ceil(LOST / NEW) + 1
"""New views until the pose is unknown."""


def loop() -> ExperienceMap:
    """Return the map of a loop, and the robot at its tenth place in the second lap."""
    graph = new_map(exp_gate_closures=True)
    arrive(graph, 0)
    for target in [*range(1, COUNT), *range(10)]:
        go(graph, target, STEP, behaviour='left_wall')
    assert graph.carried.sum == 0.0
    return graph


def restored(graph: ExperienceMap, folder: Path) -> ExperienceMap:
    """Return the map of a file that another one was saved to."""
    again = new_map(exp_gate_closures=True)
    again.restore(filed({'experience_map': graph.state()}, folder)['experience_map'])
    return again


def see_new(graph: ExperienceMap, count: int = NEW_COUNT) -> None:
    for _ in range(count):
        go(graph, len(graph), STEP)


def recognise(graph: ExperienceMap, *targets: int) -> None:
    for target in targets:
        go(graph, target, STEP)


def test_known_ground_with_other_views_makes_the_pose_unknown() -> None:
    graph = loop()
    see_new(graph, NEW_COUNT - 1)
    assert graph.localisation != 'unknown'
    see_new(graph, 1)
    assert graph.localisation == 'unknown'
    assert graph.covariance.reason == 'its views are not those of the map here'


@pytest.mark.parametrize('mapping', [True, False])
def test_its_own_views_make_the_pose_known_again(mapping: bool) -> None:
    graph = loop()
    see_new(graph)
    graph.mapping = mapping
    first = 9 + NEW_COUNT
    recognise(graph, *range(first + 1, first + 2 + math.ceil(NEW_COUNT * NEW / -SEEN)))
    assert graph.localisation == 'localised'
    assert graph.link_table.row(9, COUNT) is not None
    assert not graph.is_doubtful(COUNT)


@pytest.mark.parametrize('saved', [False, True])
def test_what_was_learned_since_is_moved_to_where_views_agree(tmp_path: Path, saved: bool) -> None:
    graph = loop()
    learned = graph.pose_of(9)
    see_new(graph)
    if saved:
        graph = restored(graph, tmp_path)
    links = graph.link_count
    recognise(graph, 60)
    assert (graph.gate.rejected_count, graph.link_count) == (1, links)
    recognise(graph, *range(61, 60 + AGREEING_COUNT))
    assert graph.localisation == 'localised'
    assert graph.link_table.row(9, COUNT) is None
    assert graph.pose_of(9) == learned
    found = 60 + AGREEING_COUNT - 1
    assert graph.pose == pytest.approx(graph.pose_of(found))
    for n in range(NEW_COUNT):
        expected = graph.pose_of(60 - NEW_COUNT + n)
        assert graph.pose_of(COUNT + n)[:2] == pytest.approx(expected[:2], abs=0.2)
    assert not graph.is_apart(9)


def test_links_unlearned_in_the_wrong_place_are_learned_again(tmp_path: Path) -> None:
    graph = loop()
    links = {(link.source_id, link.target_id) for link in graph.links()}
    while not graph.unlearn_blocked('left_wall', graph.pose.heading_rad):
        pass
    graph = restored(graph, tmp_path)
    assert len(graph.unlearned_ends)
    see_new(graph)
    recognise(graph, *range(60, 60 + AGREEING_COUNT))
    assert links <= {(link.source_id, link.target_id) for link in graph.links()}
    assert len(graph.unlearned_ends) == 0


def test_robot_that_was_taken_for_a_known_place_leaves_it() -> None:
    """Nothing that it learned moves then; the links to that place are deleted."""
    graph = loop()
    see_new(graph, NEW_COUNT + 1)
    graph.current_id = 9
    recognise(graph, *range(60, 60 + AGREEING_COUNT))
    assert graph.current_id == 60 + AGREEING_COUNT - 1
    assert graph.gate.relocation_count == 1


def test_long_path_and_short_displacement_are_not_moved() -> None:
    carried = Carried()
    carried.is_lost, carried.since_m = True, 100.0
    here, far = Pose(0.0, 0.0, 0.0), Pose(20.0, 0.0, 0.0)
    assert carried.may_move(100.0 + MOVED_M, here, far)
    assert carried.may_move(110.0, here, Pose(0.0, 0.0, 2.0))
    assert not carried.may_move(110.0, here, Pose(2.0, 0.0, 0.5))
    assert not carried.may_move(101.0 + MOVED_M, here, far)
    carried.restart()
    assert not carried.may_move(110.0, here, far)


def test_unknown_ground_is_no_evidence() -> None:
    graph = loop()
    for _ in range(3 * NEW_COUNT):
        go(graph, len(graph), Motion(1.0, 1.0, 0.0))  # leaves the loop within 6 m
    assert 0.0 < graph.carried.sum <= 6.0 * NEW


def test_robot_with_scans_is_found_by_them() -> None:
    graph = loop()
    for _ in range(3 * NEW_COUNT):
        graph.integrate(STEP)
        target = len(graph)
        action = MapAction(
            'create', graph.current_id, target, target, 0.0, graph.labels[0][1]
        )
        graph.apply(action, scan_match=ScanMatch(fits=lambda *_: False))
    assert graph.carried.sum == 0.0


def test_evidence_is_limited() -> None:
    graph = loop()
    see_new(graph, int(MOST / NEW) + 20)
    assert graph.carried.sum == MOST


def test_gap_of_the_odometry_ends_the_doubt() -> None:
    graph = loop()
    see_new(graph)
    graph.integrate(Motion(9.0, 0.0, 0.0, is_known=False))
    assert not graph.carried.is_lost
    assert np.isfinite(graph.poses).all()


def test_map_that_is_not_learned_keeps_its_links() -> None:
    graph = loop()
    see_new(graph)
    graph.mapping = False
    links, poses = [*graph.links()], graph.poses
    recognise(graph, *range(60, 60 + AGREEING_COUNT))
    assert [*graph.links()] == links
    assert np.array_equal(graph.poses, poses)


def test_evidence_ends_with_the_gate_of_closures() -> None:
    """Otherwise what is learned would be doubtful for ever, as nothing updates the sum."""
    graph = loop()
    see_new(graph)
    graph.reconfigure(replace(graph.parameters, exp_gate_closures=False))
    assert not graph.carried.is_lost
    recognise(graph, COUNT, COUNT + 1)
    assert graph.localisation == 'localised'


def test_saved_evidence_needs_the_gate_of_closures(tmp_path: Path) -> None:
    graph = loop()
    see_new(graph)
    again = new_map(exp_gate_closures=False)
    again.restore(filed({'experience_map': graph.state()}, tmp_path)['experience_map'])
    assert not again.carried.is_lost


@pytest.mark.parametrize('row', [
    [5.0, 0, COUNT + 50, 1.0, 0.0, 0.0, 1.0, '', 1, False],
    [5.0, 0, 1, 1.0, 0.0, 0.0, -1.0, '', 1, False],
    [5.0, 0, 1, 1.0, math.nan, 0.0, 1.0, '', 1, False],
    [5.0, 0, 1, np.ones(1), 0.0, 0.0, 1.0, '', 1, False],
    [5.0, 0, 1, 1.0, 0.0, 0.0, 1.0, '', 1],
    ['5', 0, 1, 1.0, 0.0, 0.0, 1.0, '', 1, False],
], ids=['unknown', 'duration', 'nan', 'array', 'short', 'text'])
def test_damaged_unlearned_links_are_refused(row: list[object]) -> None:
    graph = loop()
    graph.unlearn_blocked('left_wall', graph.pose.heading_rad)
    state = graph.state()
    check(ExperienceMap, state, 'experience_map', {})
    state['present']['blocked'] = [row]
    with pytest.raises(UnusableInput, match='expected links of known experiences'):
        check(ExperienceMap, state, 'experience_map', {})
