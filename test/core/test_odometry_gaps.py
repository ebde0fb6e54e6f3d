# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gaps of the odometry, in which the robot is moved, in a small world with a known true map."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from gap_drives import LAP_STEPS, PERIOD_NS, STEP_M, Drive, config, true_pose
from helpers import seen, twist

from ratslam_ros.core.common.odometry import Motion, MotionFromOdometry
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.late_join import LateJoin
from ratslam_ros.core.navigation.goal_tree import GoalTree
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnreachableGoal
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.pipeline.items import ViewStep


@pytest.mark.parametrize('gated', [False, True])
def test_component_joins_where_a_known_place_is_recognised(gated: bool) -> None:
    """The second and third side are mapped in a component of their own, then joined."""
    drive = Drive(config(**{'experience_map.exp_gate_closures': gated}))
    drive.forward(15)
    drive.carry(15)
    drive.forward(40)
    graph = drive.slam.experience_map
    assert graph.component_count == 2
    drive.forward(40)
    drive.finish()
    assert graph.component_count == 1
    assert drive.error_m() < 1.0  # the views agree a few steps after the first known place
    assert max(link.distance_m for link in graph.links()) < 1.5


def test_gap_is_integrated_without_limit() -> None:
    """The same drive as above with the default leaves a link as long as the gap."""
    drive = Drive(config(60.0))
    drive.forward(15)
    drive.carry(15)
    drive.forward(80)
    graph = drive.finish().experience_map
    assert graph.component_count == 1
    assert max(link.distance_m for link in graph.links()) > 9.0
    assert drive.error_m() > 2.0


def test_component_without_recognition_stays_separate() -> None:
    drive = Drive(config())
    drive.forward(15)
    before = drive.slam.experience_map.pose
    drive.carry(15)
    drive.forward(30)
    graph = drive.finish().experience_map
    apart = graph.components.index(1)
    assert graph.components == [0] * apart + [1] * (len(graph) - apart)
    # It begins at the pose where the other one ended, and no link crosses the gap.
    assert math.dist(graph.pose_of(apart)[:2], before[:2]) < STEP_M + 1e-9
    assert not any(
        graph.component_of(k.source_id) != graph.component_of(k.target_id) for k in graph.links()
    )


def test_gap_while_stationary_creates_no_second_experience() -> None:
    drive = Drive(config())
    drive.forward(10)
    drive.stand(5)
    drive.carry(0)
    count = len(drive.slam.experience_map)
    drive.stand(20)
    graph = drive.finish().experience_map
    assert len(graph) == count + 1  # where the robot stood before cannot be known
    assert graph.component_of(-1) == 1


def test_one_ambiguous_view_joins_nothing_unless_one_view_suffices() -> None:
    for views, expected in ((3.0, 2), (0.0, 1)):
        drive = Drive(config(**{'pose_cells.pc_vt_agree_views': views}))
        drive.forward(15)
        drive.carry(10)
        drive.forward(10)
        drive.stamp_ns += PERIOD_NS
        drive.slam.odometry(twist(drive.stamp_ns, 1.0))
        drive.slam.template(drive.stamp_ns, seen(3))  # a view of the first component
        drive.forward(5)
        assert drive.finish().experience_map.component_count == expected


def test_pose_cells_join_where_the_map_can() -> None:
    """A second view between two odometry messages has no experience, to which the map could go."""
    drive = Drive(config())
    graph, views = drive.slam.experience_map, 100
    for _ in range(15):
        drive.forward(1)
        drive.slam.template(drive.stamp_ns + 1, seen(views + drive.at))
    drive.carry(LAP_STEPS - 15)
    for at in range(1, 11):  # the second views alone
        drive.stamp_ns += PERIOD_NS
        drive.slam.odometry(twist(drive.stamp_ns, STEP_M / (PERIOD_NS * 1e-9)))
        drive.slam.template(drive.stamp_ns, seen(views + at))
    drive.at += 10
    drive.slam.finish()
    assert graph.component_count == 2
    assert len(drive.slam.pose_cells._evidence._components) == 2
    drive.forward(5)
    drive.finish()
    assert graph.component_count == 1


def test_gap_as_long_as_the_limit_is_integrated() -> None:
    for gap_ns, expected in ((2 * 10**9, 1), (2 * 10**9 + 1, 2)):
        drive = Drive(config())
        drive.forward(10)
        drive.carry(4, gap_ns)
        drive.forward(5)
        assert drive.finish().experience_map.component_count == expected


def test_views_during_the_gap_have_no_effect() -> None:
    """The camera continues while odometry is missing: the robot may be anywhere."""
    maps = []
    for with_views in (False, True):
        drive = Drive(config())
        drive.forward(15)
        for n in range(1, 19):
            stamp_ns = drive.stamp_ns + n * PERIOD_NS
            if with_views and stamp_ns > drive.stamp_ns + 2 * 10**9:
                drive.steps += drive.slam.template(stamp_ns, seen((drive.at + n) % LAP_STEPS))
        drive.carry(20)
        drive.forward(80)
        drive.finish()
        maps.append(encode_map(0, drive.slam.experience_map))
    assert maps[0] == maps[1]


def test_place_seen_first_during_the_gap_is_learned_afterwards() -> None:
    """A view in the first two seconds of a gap is processed, as it may not be a gap yet."""
    drive = Drive(config())
    drive.forward(15)
    for n in (1, 2, 3):
        drive.steps += drive.slam.template(drive.stamp_ns + n * PERIOD_NS, seen(15 + 5 * n))
    drive.carry(-10)
    drive.forward(90)
    drive.finish()
    assert drive.slam.experience_map.component_count == 1
    assert drive.error_m() < 1.0


def test_localisation_only_returns_to_the_map_after_a_gap() -> None:
    drive = Drive(config())
    drive.forward(LAP_STEPS)
    slam = drive.slam
    count, links = len(slam.experience_map), slam.experience_map.link_count
    slam.pose_cells.mapping = slam.experience_map.mapping = False
    drive.carry(30)
    drive.forward(2)  # the jump of the stamps is confirmed by three messages
    assert slam.experience_map.current_id == -1
    drive.forward(18)
    drive.finish()
    graph = slam.experience_map
    assert (len(graph), graph.link_count, graph.component_count) == (count, links, 1)
    assert graph.component_of(-1) == 0
    assert math.dist(graph.pose[:2], true_pose(drive.at)[:2]) < 1.0


def test_random_gaps_never_link_across_and_join_correctly() -> None:
    """Each component is long enough for three views that count separately."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        drive = Drive(config())
        graph = drive.slam.experience_map
        for _ in range(int(rng.integers(1, 4))):
            drive.forward(int(rng.integers(12, 40)))
            drive.carry(int(rng.integers(-30, 30)))
            labels = graph.components
            assert all(labels[a] == labels[b] for a, b in graph.link_ends.tolist())
        drive.forward(2 * LAP_STEPS)
        drive.finish()
        assert graph.component_count == 1, seed
        assert drive.error_m() < 1.0, seed


@pytest.mark.parametrize('forward', [30, 75])
def test_restored_memory_continues_in_a_separate_component(forward: int) -> None:
    """Saved before and after the components are joined."""
    drives = [Drive(config()) for _ in range(2)]
    for drive in drives:
        drive.forward(20)
        drive.carry(10)
        drive.forward(forward)
    slam = drives[1].slam
    components = list(slam.experience_map.components)
    for part in ('pose_cells', 'experience_map'):
        slam.pipeline.restore_stage(part, slam.pipeline.state_of(part))
    assert list(slam.experience_map.components) == components
    maps = []
    for drive in drives:
        drive.forward(LAP_STEPS)
        drive.carry(7)
        drive.forward(LAP_STEPS)
        maps.append(encode_map(0, drive.finish().experience_map))
    assert maps[0] == maps[1]


def test_late_join_executes_the_same_actions() -> None:
    """The places that identify experiences stay the same when their component moves."""
    drive = Drive(config())
    drive.forward(15)
    drive.carry(15)
    drive.forward(2 * LAP_STEPS)
    drive.finish()
    graph = ExperienceMap(config().experience_map)
    late_join, motions = LateJoin(graph), MotionFromOdometry('twist', 2.0)
    sequence = 0
    for step in drive.steps:
        if isinstance(step, ViewStep):
            action = late_join.translate(step.action, sequence, 1)
            assert action == step.action
            graph.apply(step.action)
            sequence += 1
        else:
            motion = motions.update(drive.messages[step.stamp_ns])
            if motion is not None:
                graph.integrate(motion)
    assert encode_map(0, graph) == encode_map(0, drive.slam.experience_map)


def test_map_that_misses_the_gap_keeps_one_component() -> None:
    """Odometry is lost on its way to one of two nodes: their gaps differ."""
    for lossy in ('pose_cells', 'experience_map'):
        drive = Drive(config())
        drive.forward(20)
        slam = drive.slam
        getattr(slam, lossy).integrate(Motion(3.0, 0.0, 0.0, False))
        for n in range(100):
            motion = Motion(0.5, STEP_M, 0.0)
            slam.pose_cells.integrate(motion)
            slam.experience_map.integrate(motion)
            action = slam.pose_cells.view(seen((drive.at + 1 + n) % 60))
            source = slam.experience_map.current_id
            slam.experience_map.apply(replace(action, source_id=source))
        assert slam.experience_map.component_count == 1


def test_later_component_moves_if_the_robot_is_in_an_earlier_one() -> None:
    """A robot on the first component recognises a place of one that it left by a gap."""
    drive = Drive(config())
    drive.forward(20)
    drive.carry(20)  # to step 40
    drive.forward(20)
    drive.carry(-55)  # back to the first component, where it is recognised
    drive.forward(14)
    graph = drive.slam.experience_map
    drive.slam.finish()
    first = graph.pose_of(0)
    assert graph.component_of(-1) == 0
    assert graph.component_count == 2
    drive.forward(40)  # over unknown ground into the other component
    drive.finish()
    assert graph.component_count == 1
    assert graph.pose_of(0) == first
    assert drive.error_m() < 1.0


def test_route_to_a_separate_component_is_refused() -> None:
    drive = Drive(config())
    drive.forward(15)
    drive.carry(15)
    drive.forward(15)
    graph = drive.finish().experience_map
    planner = RoutePlanner(config().goal_recall, graph)
    here = graph.current_id
    for request in (
        lambda: planner.temporal_map(here).route_to(0), lambda: GoalTree(planner, 0).route(here),
        lambda: planner.route_to_place(0.0, 0.0, 0.9, here),
    ):
        with pytest.raises(UnreachableGoal, match='components, 1 and 0, the odometry had a gap'):
            request()
    for request in (lambda: planner.route_to(0), lambda: GoalTree(planner, 0).route()):
        with pytest.raises(UnreachableGoal, match='the pose on the map is unknown'):
            request()


def test_separate_map_lists_components_and_joined_map_does_not() -> None:
    drive = Drive(config())
    drive.forward(15)
    assert 'components' not in json.loads(encode_map(0, drive.slam.experience_map))
    drive.carry(15)
    drive.forward(30)
    graph = drive.slam.experience_map
    assert json.loads(encode_map(0, graph))['components'] == graph.components
    drive.forward(60)
    drive.finish()
    assert 'components' not in json.loads(encode_map(0, graph))


def test_relaxation_of_separate_components_equals_one_of_each_alone() -> None:
    """The first experience of each component is held, before and after a new plan is made."""
    drive = Drive(config())
    drive.forward(15)
    drive.carry(15)
    drive.forward(30)
    graph = drive.finish().experience_map
    apart = graph.components.index(1)
    held, free = (graph.pose_of(0), graph.pose_of(apart)), graph.pose_of(apart + 8)
    graph.apply(MapAction('link', len(graph) - 1, apart + 3, apart, 0.0, Place(0.0, 0.0, 0.0)))
    graph.settle()
    assert (graph.pose_of(0), graph.pose_of(apart)) == held
    assert math.dist(graph.pose_of(apart + 8)[:2], free[:2]) > 0.1
