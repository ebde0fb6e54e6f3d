# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Jumps: one view that looks like another does not fold the map; many that agree are believed."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from helpers import ahead, turning
from hypothesis import given
from hypothesis import strategies as st

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.loop_closure_gate import (
    LONG_KNOWN_M,
    REQUIRED_COUNT,
    SPOT_SPACING_M,
    LoopClosureGate,
    exceeds_drift,
    long_known_experience,
)
from ratslam_ros.core.mapping.scan_matching import ScanMatch
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place

HERE = Pose(0.0, 0.0, 0.0)
CHAIN = np.array([[n, n + 1] for n in range(100)])
METRE = np.ones(100)


def jumps_to(claimed: Pose, target: int, drift: float = 0.05, links: int = 100) -> bool:
    """Whether a robot at 0 jumps that is told to be at a place so many metres of way off."""
    return exceeds_drift(HERE, claimed, drift, CHAIN[:links], METRE[:links], 0, target)


def test_how_far_the_map_may_be_wrong_grows_with_the_way() -> None:
    assert not jumps_to(Pose(0.9, 0.0, 0.0), 1)
    assert jumps_to(Pose(3.0, 0.0, 0.0), 20)
    assert not jumps_to(Pose(3.0, 0.0, 0.0), 60)
    assert not jumps_to(Pose(3.0, 0.0, 0.0), 20, drift=0.2)


def test_a_corner_that_looks_alike_the_other_way_round_is_a_jump() -> None:
    assert jumps_to(Pose(0.1, 0.1, math.pi / 2), 90)
    assert not jumps_to(Pose(0.1, 0.1, 0.3), 90)
    assert not jumps_to(Pose(0.1, 0.1, 1.0), 90, drift=0.3)


def test_between_parts_that_no_link_joins_the_map_cannot_tell() -> None:
    assert not jumps_to(Pose(50.0, 0.0, 2.0), 60, links=40)


@given(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0), st.floats(-3.0, 3.0))
def test_claims_that_agree_over_some_metres_are_believed(
    x_m: float, y_m: float, heading_rad: float
) -> None:
    gate, relocated = LoopClosureGate(), Pose(x_m, y_m, heading_rad)
    said = [
        gate.accepts(here := Pose(0.4 * n, 0.0, 0.0), composed(relocated, here)) for n in range(10)
    ]
    assert said.index(True) == REQUIRED_COUNT - 1
    assert gate.relocation_count == 1
    assert not any(said[REQUIRED_COUNT:])  # what comes then is a new matter


def test_a_robot_that_turns_in_one_place_sees_one_corner() -> None:
    gate = LoopClosureGate()
    for n in range(30):
        here = Pose(0.0, 0.0, 0.1 * n)
        assert not gate.accepts(here, composed(Pose(5.0, 0.0, 0.0), here))
    assert gate.rejected_count == 30


def test_claims_that_disagree_are_never_believed() -> None:
    gate = LoopClosureGate()
    for n in range(50):
        assert not gate.accepts(Pose(0.4 * n, 0.0, 0.0), Pose(0.0, 3.0 * n, 0.0))


def test_what_is_seen_where_the_robot_believes_to_be_speaks_against_a_jump() -> None:
    gate = LoopClosureGate()
    for n in range(60):
        here = Pose(0.4 * n, 0.0, 0.0)
        if n % 2:
            gate.record_agreement(here)
            assert not gate.rejecting
        else:
            assert not gate.accepts(here, composed(Pose(9.0, 0.0, 0.0), here))
            assert gate.rejecting


def test_a_robot_that_was_carried_may_turn_where_it_recognises_something() -> None:
    gate, relocated = LoopClosureGate(), Pose(7.0, -3.0, 1.0)
    for n in range(REQUIRED_COUNT):
        for turn_rad in (0.0, math.pi / 2):
            here = Pose(0.4 * n, 0.0, turn_rad)
            relocation_count = gate.accepts(here, composed(relocated, here))
            if relocation_count:
                break
    assert relocation_count


def test_what_is_new_where_something_was_recognised_does_not_matter() -> None:
    gate = LoopClosureGate()
    said = []
    for n in range(REQUIRED_COUNT):
        here = Pose(0.4 * n, 0.0, 0.0)
        said.append(gate.accepts(here, composed(Pose(9.0, 0.0, 0.0), here)))
        gate.record_new_place(Pose(0.4 * n + 0.1, 0.0, 0.0))
    assert said == [False] * (REQUIRED_COUNT - 1) + [True]


def test_where_nobody_knows_where_the_robot_is_the_first_jump_is_believed() -> None:
    gate = LoopClosureGate()
    gate.restart()
    gate.record_new_place(HERE)
    assert gate.accepts(HERE, Pose(9.0, 0.0, 0.0))
    assert not gate.accepts(HERE, Pose(0.0, 9.0, 0.0))
    gate.restart()
    gate.record_agreement(HERE)  # it has not been carried
    assert not gate.accepts(HERE, Pose(9.0, 0.0, 0.0))


def test_what_was_claimed_survives() -> None:
    gate = LoopClosureGate()
    for n in range(REQUIRED_COUNT - 1):
        gate.accepts(here := Pose(0.4 * n, 0.0, 0.0), composed(Pose(9.0, 0.0, 0.0), here))
    again = LoopClosureGate()
    again.restore(json.loads(json.dumps(gate.state())))
    last = Pose(0.4 * REQUIRED_COUNT, 0.0, 0.0)
    for one in (gate, again):
        assert one.accepts(last, composed(Pose(9.0, 0.0, 0.0), last))
        assert (one.rejected_count, one.relocation_count) == (REQUIRED_COUNT - 1, 1)


# On the map


def arrive(
    graph: ExperienceMap, target: int, source: int | None = None,
    scan_match: ScanMatch | None = None,
) -> None:
    """Apply what the pose cells say; they are at ``source``."""
    action = 'create' if target == len(graph) else 'link'
    source = graph.current_id if source is None else source
    graph.apply(
        MapAction(action, source, target, target, 0.0, Place(float(target), 0.0, 0.0)),
        scan_match=scan_match,
    )


def corridor(drift: float, metres: int = 12, loops: int = 10) -> ExperienceMap:
    """Return the map of a robot that has driven straight on, an experience a metre."""
    graph = ExperienceMap(ExperienceMapParameters(
        exp_jump_drift=drift, exp_initial_em_deg=0.0, exp_loops=loops,
    ))  # fmt: skip
    for n in range(metres + 1):
        arrive(graph, n)
        graph.integrate(ahead(1.0))
    return graph


def test_a_jump_that_is_refused_leaves_the_map_and_the_robot_where_they_are() -> None:
    graph = corridor(0.05)
    before, here = graph.poses, graph.pose
    arrive(graph, 2)
    assert graph.gate.rejected_count == 1
    assert graph.current_id == 12
    assert graph.pose == here
    assert graph.link_count == 12
    assert np.array_equal(graph.poses, before)


def test_what_comes_after_is_linked_to_where_the_map_has_the_robot() -> None:
    graph = corridor(0.05)
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


def test_a_robot_that_never_left_an_experience_makes_no_link_to_it() -> None:
    """The pose cells were elsewhere meanwhile, the map was not."""
    graph = corridor(0.05)
    arrive(graph, 2)
    arrive(graph, 12, source=2)
    assert graph.current_id == 12
    assert graph.link_count == 12
    assert graph.offset == HERE


def test_by_default_every_recognition_is_believed() -> None:
    graph = corridor(0.0)
    arrive(graph, 2)
    assert graph.current_id == 2
    assert graph.links()[-1].target_id == 2


def test_a_robot_that_was_carried_makes_no_link() -> None:
    graph = corridor(0.05)
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


def claimed_all_along(graph: ExperienceMap, scan_match: ScanMatch | None) -> None:
    """Drive back along a corridor that was driven long ago; all that is seen is six metres off."""
    graph.integrate(ahead(LONG_KNOWN_M / 2))
    graph.integrate(ahead(-LONG_KNOWN_M / 2 - 1.0))
    for target in range(REQUIRED_COUNT, 0, -1):
        arrive(graph, target, scan_match=scan_match)
        graph.integrate(ahead(-1.0))


def test_where_scans_fit_the_places_that_are_there_no_jump_is_believed() -> None:
    asked = []

    def fits(experience_id: int, pose: Pose) -> bool:
        asked.append((experience_id, *pose))
        return True

    graph = corridor(0.05)
    claimed_all_along(graph, ScanMatch(fits=fits))
    assert graph.gate.relocation_count == 0
    assert graph.gate.rejected_count == REQUIRED_COUNT
    assert graph.pose.x_m == pytest.approx(12.0 - REQUIRED_COUNT)
    assert [asked_id for asked_id, *_ in asked] == list(range(12, 12 - REQUIRED_COUNT, -1))
    assert np.array([pose for _, *pose in asked]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize('scan_match', [None, ScanMatch(), ScanMatch(fits=lambda *_: False)])
def test_where_they_do_not_or_nothing_tells_it_is(scan_match: ScanMatch | None) -> None:
    graph = corridor(0.05)
    claimed_all_along(graph, scan_match)
    assert graph.gate.relocation_count == 1


def test_a_robot_that_was_put_there_asks_no_scan() -> None:
    graph = corridor(0.05)
    graph.gate.restart()
    claimed_all_along(graph, ScanMatch(fits=lambda *_: True))
    assert graph.gate.relocation_count == 1


def test_a_map_that_is_loaded_knows_how_old_its_places_are() -> None:
    graph = corridor(0.05)
    again = ExperienceMap(ExperienceMapParameters(exp_jump_drift=0.05))
    again.restore(graph.state())
    for one in (graph, again):
        claimed_all_along(one, ScanMatch(fits=lambda *_: True))
        assert one.gate.relocation_count == 0


def test_only_places_that_are_near_and_old_are_asked() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 2.0], [0.1, 0.0, 0.0], [5.0, 0.0, 3.1]])
    made_m = np.array([0.0, 1.0, 50.0, 2.0])
    assert long_known_experience(poses, made_m, 100.0, HERE) == 0
    assert long_known_experience(poses, made_m, 110.1, Pose(0.1, 0.0, 0.0)) == 2
    assert long_known_experience(poses, made_m, 59.9, HERE) is None
    assert long_known_experience(poses, made_m, 100.0, Pose(1.0, 0.0, 0.0)) is None
    assert long_known_experience(poses, made_m, 100.0, Pose(0.2, 0.0, 2.1)) == 1
    assert long_known_experience(poses, made_m, 100.0, Pose(5.0, 0.1, -3.1)) == 3
    assert long_known_experience(poses[:0], made_m[:0], 100.0, HERE) is None


@pytest.mark.parametrize(('fits', 'at_m'), [(True, 12.0), (False, 12.0), (True, 14.0)])
def test_scans_know_a_place_again_of_which_all_views_are_new(fits: bool, at_m: float) -> None:
    """Where nothing was, 14 m from the start, they do not say so, whatever they fit."""
    graph = corridor(0.05)
    assert graph.scan_confirmed_m == 0.0
    graph.integrate(ahead(LONG_KNOWN_M / 2))
    graph.integrate(ahead(at_m - 13.0 - LONG_KNOWN_M / 2))
    came_m = 13.0 + LONG_KNOWN_M / 2 + abs(at_m - 13.0 - LONG_KNOWN_M / 2)
    for _ in range(3):
        arrive(graph, len(graph), scan_match=ScanMatch(fits=lambda *_: fits))
        graph.integrate(ahead(0.4))
    # Asked at once, and not again before a metre.
    assert graph.scan_confirmed_m == pytest.approx(came_m if fits and at_m == 12.0 else 0.0)


def test_a_link_that_is_known_is_no_jump() -> None:
    graph = corridor(0.0)
    arrive(graph, 2)  # believed once
    again = ExperienceMap(ExperienceMapParameters(exp_jump_drift=0.05, exp_initial_em_deg=0.0))
    again.restore(graph.state())
    for target in (*range(3, 13), 2):
        again.integrate(ahead(1.0))
        arrive(again, target)
        assert again.current_id == target
    assert again.gate.rejected_count == 0


def test_but_it_is_where_the_robot_is_elsewhere_than_its_source() -> None:
    graph = corridor(0.05, metres=13)
    for target, way_m in ((2, 10.0), (14, 0.0)):
        arrive(graph, target, source=13)
        graph.integrate(ahead(way_m))
    assert graph.pose.x_m == pytest.approx(24.0)
    arrive(graph, 2, source=13)  # 14 is at 14 m; a view of 2 has the pose cells elsewhere
    graph.integrate(ahead(10.0))
    arrive(graph, 13, source=2)
    assert graph.gate.rejected_count == 3
    assert graph.pose.x_m == pytest.approx(34.0)


def test_so_is_the_experience_that_the_robot_left_long_ago() -> None:
    graph = corridor(0.05)
    arrive(graph, 2)
    graph.integrate(ahead(29.0))
    arrive(graph, 12, source=2)
    assert graph.gate.rejected_count == 2
    assert graph.pose.x_m == pytest.approx(42.0)


def test_the_way_since_the_last_experience_counts() -> None:
    graph = corridor(0.1)
    graph.integrate(ahead(20.0))
    for _ in range(2):  # to and fro, 200 m in all
        graph.integrate(ahead(50.0))
        graph.integrate(ahead(-50.0))
    arrive(graph, 12)
    assert graph.gate.rejected_count == 0


def test_a_loop_that_has_just_been_closed_is_relaxed_before_it_is_judged() -> None:
    """On a large map relaxing waits; until then the map is as far off as the robot drifted."""
    graph = ExperienceMap(ExperienceMapParameters(exp_jump_drift=0.05, exp_initial_em_deg=0.0))
    for n in range(2000):  # round a square, the second half with wheels that go too little
        arrive(graph, n)
        graph.integrate(ahead(0.1 if n < 1000 else 0.095))
        if n % 500 == 499:
            graph.integrate(turning(math.pi / 2))
    graph.integrate(turning(-math.pi / 2))
    for step_m, target in ((-0.095 * 3, 1997), (0.095 * 2, 1999)):
        graph.integrate(ahead(step_m))
        arrive(graph, target)  # relaxing after the first uses up the work that was saved
    graph.integrate(ahead(0.095))
    graph.integrate(turning(math.pi / 2))
    arrive(graph, 0)
    assert graph.current_id == 0
    assert math.dist(graph.pose_of(0)[:2], graph.pose_of(1999)[:2]) > 3.0
    graph.integrate(turning(math.pi / 2))  # back to where it came from
    for target in (1999, 1998, 1997):
        graph.integrate(ahead(0.095))
        graph.apply(MapAction(
            'link', graph.current_id, target, target, math.pi, Place(0.0, 0.0, 0.0)
        ))  # fmt: skip
        assert graph.current_id == target
    assert graph.gate.rejected_count == 0


def test_a_map_that_is_not_relaxed_is_not_for_this_either() -> None:
    graph = corridor(0.05, loops=0)
    arrive(graph, 11)  # 2 m back, over 1 m of way: a jump
    graph.apply(MapAction('link', 12, 12, 12, 0.0, Place(12.0, 0.0, 0.0)))
    before = graph.poses
    graph.integrate(ahead(0.5))
    arrive(graph, 3)
    assert graph.gate.rejected_count >= 1
    assert np.array_equal(graph.poses, before)


def test_a_map_in_doubt_goes_on_as_it_would_have() -> None:
    maps = [corridor(0.05)]
    arrive(maps[0], 2)
    maps.append(ExperienceMap(ExperienceMapParameters(
        exp_jump_drift=0.05, exp_initial_em_deg=0.0,
    )))  # fmt: skip
    maps[1].restore(maps[0].state())
    for graph in maps:
        for target in range(3, 2 + REQUIRED_COUNT):
            graph.integrate(ahead(1.0))
            arrive(graph, target, source=target - 1)
    assert [graph.gate.relocation_count for graph in maps] == [1, 1]
    assert maps[0].pose == maps[1].pose
    assert np.array_equal(maps[0].poses, maps[1].poses)


def test_a_robot_that_is_only_located_is_believed() -> None:
    graph = corridor(0.05)
    graph.mapping = False
    arrive(graph, 2)
    assert graph.current_id == 2


def test_spacing_is_less_than_what_claims_are_apart() -> None:
    gate = LoopClosureGate()
    for n in range(200):  # 10 m in steps of 5 cm
        here = Pose(0.05 * n, 0.0, 0.0)
        if gate.accepts(here, composed(Pose(9.0, 0.0, 0.0), here)):
            break
    assert gate.relocation_count == 1
    assert here.x_m == pytest.approx((REQUIRED_COUNT - 1) * SPOT_SPACING_M, abs=0.35)
