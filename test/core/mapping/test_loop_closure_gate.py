# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Loop-closure gate: single false matches are rejected, consistent relocations are accepted."""

from __future__ import annotations

import math
from functools import partial

import graphs
import numpy as np
import pytest
from graphs import new_map, place_of
from helpers import ahead, turning
from hypothesis import given
from hypothesis import strategies as st

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.loop_closure_gate import (
    LONG_KNOWN_M,
    REQUIRED_COUNT,
    Excess,
    LoopClosureGate,
    long_known_experience,
    path_covariance,
)
from ratslam_ros.core.mapping.odometry_noise import UNMEASURED, UNMEASURED_VIEW
from ratslam_ros.core.mapping.pose_covariance import OdometryVariance, PoseCovariance
from ratslam_ros.core.mapping.scan_match import ScanMatch
from ratslam_ros.core.pose_cells.map_action import Action, MapAction

ORIGIN = Pose(0.0, 0.0, 0.0)
CHAIN_ENDS = np.array([[n, n + 1] for n in range(100)])
CHAIN_LENGTHS_M = np.ones(100)
CHAIN_POSES = np.array([[-float(n), 0.0, 0.0] for n in range(101)])


def exceeds(
    claimed: Pose, target: int, noise: OdometryVariance = UNMEASURED, links: int = 100
) -> bool:
    """Return whether a closure from experience 0 to ``target``, as many m behind, is rejected."""
    path = path_covariance(
        CHAIN_POSES, CHAIN_ENDS[:links], CHAIN_LENGTHS_M[:links], 0, target, noise
    )
    if path is None:
        return False
    return Excess.of(ORIGIN, claimed, path + UNMEASURED_VIEW) is not None


# Expected drift


def test_allowed_displacement_grows_with_path_length() -> None:
    assert not exceeds(Pose(0.9, 0.0, 0.0), 1)
    assert exceeds(Pose(3.0, 0.0, 0.0), 20)
    assert not exceeds(Pose(2.0, 0.0, 0.0), 100)
    assert not exceeds(Pose(3.0, 0.0, 0.0), 20, OdometryVariance(0.04))


def test_rotation_beyond_drift_exceeds_it() -> None:
    assert exceeds(Pose(0.1, 0.1, math.pi / 2), 90)
    assert not exceeds(Pose(0.1, 0.1, 0.3), 90)
    assert exceeds(Pose(0.1, 0.1, 1.0), 2)
    assert not exceeds(Pose(0.1, 0.1, 1.0), 2, OdometryVariance(0.003, 0.1))


def test_path_covariance_is_that_of_the_drive_along_it() -> None:
    """A corner: the covariance is in the frame of the experience at its end."""
    poses = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 0.0, 1.5], [2.1, 2.0, 1.5]])
    ends, lengths_m = np.array([[1, 0], [1, 2], [3, 2], [3, 0]]), np.array([2.0, 0.0, 2.0, 9.0])
    driven = PoseCovariance()
    for distance_m, turn_rad in ((2.0, 0.0), (0.0, 1.5), (2.0, 0.0)):
        driven.integrate(Motion(1.0, distance_m, turn_rad), UNMEASURED)
    found = path_covariance(poses, ends, lengths_m, 3, 0, UNMEASURED)
    assert found == pytest.approx(driven.matrix, rel=0.1, abs=2e-4)


def test_closure_between_unlinked_components_never_exceeds_drift() -> None:
    assert not exceeds(Pose(50.0, 0.0, 2.0), 60, links=40)


def test_blocked_way_is_part_of_the_path() -> None:
    """Otherwise, time-outs at a place without a detour would make any place the robot's."""
    graph = graphs.corridor(behaviour='ahead', exp_gate_closures=True)
    while not graph.unlearn_blocked('ahead', 0.0, Pose(8.5, 0.0, 0.0)):
        pass
    assert graph.link_table.row(8, 9) is None
    graphs.go(graph, 2, ahead(0.5))
    assert graph.gate.rejected_count == 1
    assert graph.link_table.row(12, 2) is None


# Evidence for a relocation


@given(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0), st.floats(-3.0, 3.0))
def test_agreeing_closures_are_accepted_as_relocation(
    x_m: float, y_m: float, heading_rad: float
) -> None:
    gate, relocation = LoopClosureGate(), Pose(x_m, y_m, heading_rad)
    accepted = [
        gate.record_closure(here := Pose(0.4 * n, 0.0, 0.0), composed(relocation, here))
        for n in range(10)
    ]
    assert accepted.index(True) == REQUIRED_COUNT - 1
    assert gate.relocation_count == 1
    assert not any(accepted[REQUIRED_COUNT:])  # the evidence is cleared


def test_closures_while_turning_in_place_count_once() -> None:
    gate = LoopClosureGate()
    for n in range(30):
        here = Pose(0.0, 0.0, 0.1 * n)
        assert not gate.record_closure(here, composed(Pose(5.0, 0.0, 0.0), here))
    assert gate.rejected_count == 30


def test_disagreeing_closures_are_never_accepted() -> None:
    gate = LoopClosureGate()
    for n in range(50):
        assert not gate.record_closure(Pose(0.4 * n, 0.0, 0.0), Pose(0.0, 3.0 * n, 0.0))


def test_agreeing_recognitions_prevent_a_relocation() -> None:
    gate = LoopClosureGate()
    for n in range(60):
        here = Pose(0.4 * n, 0.0, 0.0)
        if n % 2:
            gate.record_agreement(here)
            assert not gate.rejecting
        else:
            assert not gate.record_closure(here, composed(Pose(9.0, 0.0, 0.0), here))
            assert gate.rejecting


def test_new_place_at_a_spot_keeps_its_closure() -> None:
    gate = LoopClosureGate()
    accepted = []
    for n in range(REQUIRED_COUNT):
        here = Pose(0.4 * n, 0.0, 0.0)
        accepted.append(gate.record_closure(here, composed(Pose(9.0, 0.0, 0.0), here)))
        gate.record_new_place(Pose(0.4 * n + 0.1, 0.0, 0.0))
    assert accepted == [False] * (REQUIRED_COUNT - 1) + [True]


def test_first_closure_after_restart_is_accepted() -> None:
    gate = LoopClosureGate()
    gate.restart()
    gate.record_new_place(ORIGIN)
    assert gate.record_closure(ORIGIN, Pose(9.0, 0.0, 0.0))
    assert not gate.record_closure(ORIGIN, Pose(0.0, 9.0, 0.0))
    gate.restart()
    gate.record_agreement(ORIGIN)  # the robot was not carried
    assert not gate.record_closure(ORIGIN, Pose(9.0, 0.0, 0.0))


PROVEN = Pose(9.0, 2.0, 0.5)
ELSEWHERE = Pose(3.0, 2.0, 0.5)


@pytest.mark.parametrize(('views', 'accepted'), [
    ([], True), ([ELSEWHERE], True), ([PROVEN], True), ([ELSEWHERE] * 2, False),
    ([ELSEWHERE, ELSEWHERE, PROVEN], False), ([ELSEWHERE, PROVEN] * 2, True),
])
def test_proven_place_is_accepted_unless_views_contradict(
    views: list[Pose], accepted: bool
) -> None:
    gate = LoopClosureGate()
    gate.restart()
    assert gate.offer_proven(PROVEN, views) == accepted
    assert gate.relocation_count == accepted
    assert gate.rejected_count == (not accepted)
    assert gate.rejecting == accepted  # until the pose cells are there as well
    assert gate.accepts_next == (not accepted)


def test_views_do_not_relocate_if_only_landmarks_may() -> None:
    gate = LoopClosureGate()
    gate.restart()
    for n in range(20):
        here = Pose(0.4 * n, 0.0, 0.0)
        assert not gate.record_closure(here, composed(Pose(9.0, 0.0, 0.0), here), by_views=False)
    assert gate.rejecting


# Closures on the map


def arrive(
    graph: ExperienceMap, target: int, source: int | None = None,
    scan_match: ScanMatch = ScanMatch(),
) -> None:
    """Apply an action; ``source``: current experience of the pose cells, None: that of the map."""
    kind: Action = 'create' if target == len(graph) else 'link'
    source = graph.current_id if source is None else source
    graph.apply(
        MapAction(kind, source, target, target, 0.0, place_of(target)), scan_match=scan_match
    )


corridor = partial(graphs.corridor, beyond_m=1.0, exp_gate_closures=True, exp_loops=10)


def test_rejected_closure_changes_neither_map_nor_pose() -> None:
    graph = corridor()
    poses, pose = graph.poses, graph.pose
    arrive(graph, 2)
    assert graph.gate.rejected_count == 1
    assert graph.current_id == 12
    assert graph.pose == pose
    assert graph.link_count == 12
    assert np.array_equal(graph.poses, poses)


def test_create_after_rejection_links_from_map_experience() -> None:
    graph = corridor()
    arrive(graph, 2)
    graph.integrate(ahead(0.5))
    arrive(graph, 13, source=2)
    link = graph.links()[-1]
    assert (link.source_id, link.target_id) == (12, 13)
    assert link.distance_m == pytest.approx(1.5)
    assert graph.pose_of(13).x_m == pytest.approx(13.5)
    graph.integrate(ahead(0.5))
    arrive(graph, 14, source=13)
    assert graph.links()[-1].source_id == 13


def test_return_after_rejection_adds_no_link() -> None:
    """Only the pose cells left the experience; on the map the robot was there all the time."""
    graph = corridor()
    arrive(graph, 2)
    arrive(graph, 12, source=2)
    assert graph.current_id == 12
    assert graph.link_count == 12
    assert graph.offset == ORIGIN


def test_relocated_robot_links_from_its_place_without_link_to_it() -> None:
    graph = corridor()
    assert graph.relocate(3, Pose(0.2, 0.1, 0.0))
    assert graph.current_id == 3
    assert graph.pose[:2] == pytest.approx((3.2, 0.1))
    assert graph.link_count == 12
    graph.integrate(ahead(0.5))
    arrive(graph, 13, source=12)  # the pose cells are still at the old place
    graph.integrate(ahead(0.5))
    arrive(graph, 14, source=3)  # they have adopted the relocation
    ends = [(link.source_id, link.target_id) for link in graph.links()[-2:]]
    assert ends == [(3, 13), (13, 14)]
    assert graph.pose_of(14)[:2] == pytest.approx((4.2, 0.1))


def test_disabled_gate_accepts_every_closure() -> None:
    graph = corridor(exp_gate_closures=False)
    arrive(graph, 2)
    assert graph.current_id == 2
    assert graph.links()[-1].target_id == 2


def test_accepted_relocation_adds_no_link() -> None:
    graph = corridor()
    for target in range(2, 2 + REQUIRED_COUNT):
        assert graph.current_id == 12
        arrive(graph, target)
        graph.integrate(ahead(1.0))
    assert graph.current_id == 1 + REQUIRED_COUNT
    assert graph.gate.relocation_count == 1
    assert graph.link_count == 12
    arrive(graph, 2 + REQUIRED_COUNT)
    assert graph.current_id == 2 + REQUIRED_COUNT
    assert graph.gate.rejected_count == REQUIRED_COUNT - 1


def drive_back_with_false_closures(graph: ExperienceMap, scan_match: ScanMatch) -> None:
    """Drive back along a corridor that was learned long ago, with closures that are 6 m off."""
    graph.integrate(ahead(LONG_KNOWN_M / 2))
    graph.integrate(ahead(-LONG_KNOWN_M / 2 - 1.0))
    for target in range(REQUIRED_COUNT, 0, -1):
        arrive(graph, target, scan_match=scan_match)
        graph.integrate(ahead(-1.0))


def test_closures_are_rejected_while_scans_confirm_the_pose() -> None:
    checks = []

    def fits(experience_id: int, pose: Pose) -> bool:
        checks.append((experience_id, *pose))
        return True

    graph = corridor()
    drive_back_with_false_closures(graph, ScanMatch(fits=fits))
    assert graph.gate.relocation_count == 0
    assert graph.gate.rejected_count == REQUIRED_COUNT
    assert graph.pose.x_m == pytest.approx(12.0 - REQUIRED_COUNT)
    assert [checked_id for checked_id, *_ in checks] == list(range(12, 12 - REQUIRED_COUNT, -1))
    assert np.array([pose for _, *pose in checks]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize('scan_match', [ScanMatch(), ScanMatch(fits=lambda *_: False)])
def test_relocation_is_accepted_without_scan_confirmation(scan_match: ScanMatch) -> None:
    graph = corridor()
    drive_back_with_false_closures(graph, scan_match)
    assert graph.gate.relocation_count == 1


def test_closure_after_restart_ignores_scan_confirmation() -> None:
    graph = corridor()
    graph.gate.restart()
    drive_back_with_false_closures(graph, ScanMatch(fits=lambda *_: True))
    assert graph.gate.relocation_count == 1


def test_restored_map_keeps_the_age_of_experiences() -> None:
    graph = corridor()
    again = new_map(exp_gate_closures=True)
    again.restore(graph.state())
    for one in (graph, again):
        drive_back_with_false_closures(one, ScanMatch(fits=lambda *_: True))
        assert one.gate.relocation_count == 0


def test_long_known_experience_is_near_and_old() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 2.0], [0.1, 0.0, 0.0], [5.0, 0.0, 3.1]])
    created_at_m = np.array([0.0, 1.0, 50.0, 2.0])
    assert long_known_experience(poses, created_at_m, 100.0, ORIGIN) == 0
    assert long_known_experience(poses, created_at_m, 110.1, Pose(0.1, 0.0, 0.0)) == 2
    assert long_known_experience(poses, created_at_m, 59.9, ORIGIN) is None
    assert long_known_experience(poses, created_at_m, 100.0, Pose(1.0, 0.0, 0.0)) is None
    assert long_known_experience(poses, created_at_m, 100.0, Pose(0.2, 0.0, 2.1)) == 1
    assert long_known_experience(poses, created_at_m, 100.0, Pose(5.0, 0.1, -3.1)) == 3
    assert long_known_experience(poses[:0], created_at_m[:0], 100.0, ORIGIN) is None


@pytest.mark.parametrize(('fits', 'at_m'), [(True, 12.0), (False, 12.0), (True, 14.0)])
def test_scan_confirms_old_place_with_new_views(fits: bool, at_m: float) -> None:
    """At 14 m there is no old experience nearby, so a fitting scan confirms nothing."""
    graph = corridor()
    graph.integrate(ahead(LONG_KNOWN_M / 2))
    graph.integrate(ahead(at_m - 13.0 - LONG_KNOWN_M / 2))
    states = [graph.localisation]
    for _ in range(3):
        arrive(graph, len(graph), scan_match=ScanMatch(fits=lambda *_: fits))
        states.append(graph.localisation)
        graph.integrate(ahead(0.4))
    confirmed = 'localised' if fits and at_m == 12.0 else 'uncertain'
    assert states == ['uncertain', *[confirmed] * 3]


def test_transition_along_existing_link_is_accepted() -> None:
    graph = corridor(exp_gate_closures=False)
    arrive(graph, 2)  # accepted, as the gate is off
    again = new_map(exp_gate_closures=True)
    again.restore(graph.state())
    for target in (*range(3, 13), 2):
        again.integrate(ahead(1.0))
        arrive(again, target)
        assert again.current_id == target
    assert again.gate.rejected_count == 0


def test_far_return_to_neighbour_is_rejected() -> None:
    graph = corridor(14)
    for target, driven_m in ((2, 10.0), (14, 0.0)):
        arrive(graph, target, source=13)
        graph.integrate(ahead(driven_m))
    assert graph.pose.x_m == pytest.approx(24.0)
    arrive(graph, 2, source=13)  # rejected, so map and pose cells disagree
    graph.integrate(ahead(10.0))
    arrive(graph, 13, source=2)
    assert graph.gate.rejected_count == 3
    assert graph.pose.x_m == pytest.approx(34.0)


def test_far_return_to_current_experience_is_rejected() -> None:
    graph = corridor()
    arrive(graph, 2)
    graph.integrate(ahead(29.0))
    arrive(graph, 12, source=2)
    assert graph.gate.rejected_count == 2
    assert graph.pose.x_m == pytest.approx(42.0)


def test_distance_since_current_experience_allows_displacement() -> None:
    graph = corridor()
    graph.integrate(ahead(1.5))
    for _ in range(2):  # 200 m without net displacement
        graph.integrate(ahead(50.0))
        graph.integrate(ahead(-50.0))
    arrive(graph, 12)
    assert graph.gate.rejected_count == 0


def test_pending_relaxation_is_done_before_gating() -> None:
    """On a large map relaxation waits, and the poses still contain the drift until then."""
    graph = new_map(exp_gate_closures=True)
    for n in range(2000):  # a square; odometry is 5 % short in the second half
        arrive(graph, n)
        graph.integrate(ahead(0.1 if n < 1000 else 0.095))
        if n % 500 == 499:
            graph.integrate(turning(math.pi / 2))
    graph.integrate(turning(-math.pi / 2))
    for step_m, target in ((-0.095 * 3, 1997), (0.095 * 2, 1999)):
        graph.integrate(ahead(step_m))
        arrive(graph, target)  # the first closure uses up the saved relaxation budget
    graph.integrate(ahead(0.095))
    graph.integrate(turning(math.pi / 2))
    arrive(graph, 0)
    assert graph.current_id == 0
    assert math.dist(graph.pose_of(0)[:2], graph.pose_of(1999)[:2]) > 3.0
    graph.integrate(turning(math.pi / 2))  # turns back
    for target in (1999, 1998, 1997):
        graph.integrate(ahead(0.095))
        graph.apply(
            MapAction('link', graph.current_id, target, target, math.pi, place_of(0))
        )
        assert graph.current_id == target
    assert graph.gate.rejected_count == 0


def test_gating_does_not_relax_if_relaxation_is_off() -> None:
    graph = corridor(exp_loops=0)
    arrive(graph, 11)  # 2 m back over a path of 1 m exceeds the drift
    graph.apply(MapAction('link', 12, 12, 12, 0.0, place_of(12)))
    before = graph.poses
    graph.integrate(ahead(0.5))
    arrive(graph, 3)
    assert graph.gate.rejected_count >= 1
    assert np.array_equal(graph.poses, before)


def test_map_restored_while_rejecting_continues_identically() -> None:
    maps = [corridor()]
    arrive(maps[0], 2)
    maps.append(new_map(exp_gate_closures=True))
    maps[1].restore(maps[0].state())
    for graph in maps:
        for target in range(3, 2 + REQUIRED_COUNT):
            graph.integrate(ahead(1.0))
            arrive(graph, target, source=target - 1)
    assert [graph.gate.relocation_count for graph in maps] == [1, 1]
    assert maps[0].pose == maps[1].pose
    assert np.array_equal(maps[0].poses, maps[1].poses)


def test_localising_map_accepts_every_closure() -> None:
    graph = corridor()
    graph.mapping = False
    arrive(graph, 2)
    assert graph.current_id == 2
