# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lengths that are estimated while driving: view spacing, scatter, and decisions at any scale."""

from __future__ import annotations

import json
import math

import pytest
from helpers import extended, seen

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import AUTOMATIC, PoseCellsParameters
from ratslam_ros.core.goal_memory.goal_memory import GoalMemory
from ratslam_ros.core.pose_cells.automatic_lengths import (
    MIN_GAPS_COUNT,
    AutomaticLengths,
    LogHistogram,
)
from ratslam_ros.core.pose_cells.lengths import lengths_of
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.errors import UnusableParameter

PER_LAP = 40


def automatic(**changes: float) -> PoseCellsParameters:
    return extended('pose_cells', **{
        'pc_dim_x': 200, 'pc_dim_y': 200, 'pc_cell_x_size': AUTOMATIC,
        'exp_delta_pc_threshold': AUTOMATIC, 'pc_vt_agree_cells': AUTOMATIC,
        'pc_vt_agree_spacing': AUTOMATIC, **changes,
    })


def drive(
    pose_cells: PoseCells, first: int, last: int, view_m: float = 1.0
) -> list[MapAction]:
    """Drive laps of PER_LAP views on a circle, with odometry that turns 3 % too far."""
    actions = []
    for n in range(first, last):
        for _ in range(3):
            pose_cells.integrate(
                Motion(0.3, view_m / 3, 1.03 * 2.0 * math.pi / PER_LAP / 3)
            )
            actions.append(pose_cells.view(seen(n % PER_LAP)))
    return actions


def decisions(actions: list[MapAction]) -> list[tuple[str, int, int]]:
    return [(a.action, a.source_id, a.target_id) for a in actions]


def test_weighted_median_of_histogram_is_within_a_bin() -> None:
    histogram = LogHistogram()
    for value, weight in ((0.5, 1.0), (2.0, 1.0), (3.0, 3.0), (0.0, 9.0)):
        histogram.add(value, weight)
    assert histogram.median() == pytest.approx(3.0, rel=0.05)
    assert histogram.count == 3
    assert LogHistogram().median() == 0.0


def test_view_spacing_is_the_distance_between_new_views() -> None:
    pose_cells = PoseCells(automatic())
    drive(pose_cells, 0, MIN_GAPS_COUNT, 0.4)
    assert not pose_cells.lengths.are_known
    drive(pose_cells, MIN_GAPS_COUNT, PER_LAP, 0.4)
    assert pose_cells.lengths.spacing_m == pytest.approx(0.4, rel=0.1)
    assert pose_cells.lengths.cell_m == pytest.approx(0.4 * 2 / 3, rel=0.1)


@pytest.mark.parametrize('related', [0, 1, 4])
def test_view_spacing_reaches_back_to_the_last_unrelated_template(related: int) -> None:
    lengths = AutomaticLengths(automatic())
    for _ in range(40):
        lengths.integrate(0.3)
        lengths.observe(is_new=True, is_recent=True, related_count=related)
    assert lengths.spacing_m == pytest.approx(0.3 * (related + 1), rel=0.1)
    resumed = AutomaticLengths(automatic())
    resumed.restore(json.loads(json.dumps(lengths.state())))
    for one in (lengths, resumed):
        one.integrate(0.9)
        one.observe(is_new=True, is_recent=True, related_count=related)
    assert resumed.state() == lengths.state()


def test_distances_driven_over_known_ground_are_not_measured() -> None:
    pose_cells = PoseCells(automatic())
    drive(pose_cells, 0, PER_LAP)
    before = pose_cells.lengths.spacing_m
    drive(pose_cells, PER_LAP, 2 * PER_LAP, 7.0)
    drive(pose_cells, 0, 5, 7.0)
    assert pose_cells.lengths.spacing_m == before


@pytest.mark.parametrize('scale', [0.03, 40.0])
def test_scaled_world_gives_same_decisions(scale: float) -> None:
    one, other = PoseCells(automatic()), PoseCells(automatic())
    expected = decisions(drive(one, 0, 3 * PER_LAP))
    assert decisions(drive(other, 0, 3 * PER_LAP, scale)) == expected
    assert {action for action, _, _ in expected} >= {'create', 'link'}
    assert other.lengths.cell_m == pytest.approx(scale * one.lengths.cell_m)


def test_rescaled_places_keep_their_distances() -> None:
    pose_cells = PoseCells(automatic())
    turned = 0.0
    while not pose_cells.lengths.are_known:
        pose_cells.integrate(Motion(0.1, 0.25, 0.1))
        turned += 0.1
        pose_cells.view(seen(len(pose_cells)))
    radius_m = 2.5
    cell_m = pose_cells.lengths.cell_m
    first = pose_cells._experiences[0].located.place
    expected_m = 2.0 * radius_m * abs(math.sin(0.5 * (turned - 0.1)))
    distance_m = cell_m * math.hypot(
        pose_cells.peak.x - first.x, pose_cells.peak.y - first.y
    )
    assert distance_m == pytest.approx(expected_m, rel=0.02)


@pytest.mark.parametrize('views', [3, PER_LAP + 9])
def test_restored_lengths_continue_identically(views: int) -> None:
    pose_cells, restored = PoseCells(automatic()), PoseCells(automatic())
    drive(pose_cells, 0, views)
    state = pose_cells.state()
    lengths = json.loads(json.dumps(state['lengths']))
    restored.restore({**state, 'lengths': lengths})
    assert decisions(drive(pose_cells, views, 3 * PER_LAP)) == decisions(
        drive(restored, views, 3 * PER_LAP)
    )
    assert restored.lengths.state() == pose_cells.lengths.state()


def test_explicit_lengths_are_saved_and_measured_not_at_all() -> None:
    pose_cells = PoseCells(extended('pose_cells'))
    drive(pose_cells, 0, PER_LAP)
    assert 'lengths' not in pose_cells.state()
    assert pose_cells.lengths.delta == (2.0, 1.0)
    assert pose_cells.lengths.report() == {}


def test_automatic_thresholds_do_not_depend_on_the_cell_size() -> None:
    for cell_m in (0.25, 1.0, 3.0):
        lengths = AutomaticLengths(automatic(pc_cell_x_size=cell_m))
        for _ in range(MIN_GAPS_COUNT + 1):
            lengths.observe(True, True)
            lengths.integrate(1.5)
        limit, planes_per_cell = lengths.delta
        assert limit / planes_per_cell * lengths.cell_m == pytest.approx(0.75)


def test_recognised_views_are_linked_wherever_the_robot_creates_experiences() -> None:
    pose_cells = PoseCells(automatic(exp_view_links=True))
    drive(pose_cells, 0, PER_LAP)
    actions = drive(pose_cells, PER_LAP, 3 * PER_LAP)
    created = [a for a in actions if a.action == 'create']
    assert {a.action for a in actions} == {'create', 'none'}
    assert len(created) < 4 * PER_LAP + 2  # half a view spacing apart
    recognised = [a for a in actions if a.recognised_id >= 0]
    assert len(recognised) > 0.7 * len(actions)  # the ten newest templates are not recognised
    places = {(a.template_id, a.recognised_id) for a in recognised}
    # The first experience at a place, until it is superseded.
    assert len(places) <= 2 * len({template for template, _ in places})
    assert max(a.agreement for a in recognised) == 1.0
    assert actions[-1].view_spacing_m == pose_cells.lengths.spacing_m
    pose_cells.mapping = False
    located = drive(pose_cells, 0, PER_LAP)
    assert 'create' not in {a.action for a in located}
    assert {'link', 'set'} & {a.action for a in located}


@pytest.mark.parametrize('weighs', [False, True])
def test_weighed_links_have_the_view_spacing(weighs: bool) -> None:
    pose_cells = PoseCells(automatic(exp_view_links=False, exp_weigh_links=weighs))
    actions = drive(pose_cells, 0, 2 * PER_LAP)
    assert 'link' in {a.action for a in actions}
    assert actions[-1].view_spacing_m == (pose_cells.lengths.spacing_m if weighs else 0.0)
    recognised = {a.action for a in actions if a.recognised_id != NO_EXPERIENCE}
    assert recognised == ({'create'} if weighs else set())


def test_explicit_lengths_scale_the_weights_by_the_threshold() -> None:
    explicit = extended('pose_cells', pc_cell_x_size=0.5, exp_delta_pc_threshold=1.0)
    assert lengths_of(explicit).scale_m == 1.0
    assert AutomaticLengths(automatic()).scale_m == 0.0


def test_goal_memory_rejects_an_automatic_cell_size() -> None:
    with pytest.raises(UnusableParameter, match='pc_cell_x_size is -1'):
        GoalMemory(automatic())
