# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Experience map: the robot's pose, and the execution of map actions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from graphs import NONE, arrive, drive, go, new_map, pose_is_near
from helpers import ahead, restored, turning

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.graph import NotLinked
from ratslam_ros.core.mapping.scan_match import ScanMatch
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.pose_cells.torus import Place

# The first experience


def test_motion_before_first_experience_counts_once() -> None:
    """OpenRatSLAM counts it twice."""
    graph = new_map(exp_initial_em_deg=90.0)
    drive(graph, ahead(2.0), turning(-math.pi / 2), ahead(1.0))
    before = graph.pose
    assert pose_is_near(before, 1.0, 2.0, 0.0)
    arrive(graph, 0)
    assert pose_is_near(graph.pose_of(0), 1.0, 2.0, 0.0)
    assert pose_is_near(graph.pose, *before)
    drive(graph, ahead(1.0))
    assert pose_is_near(graph.pose, 2.0, 2.0, 0.0)


@pytest.mark.parametrize('relative_rad', [0.0, 0.8, -3.0])
def test_creating_an_experience_keeps_the_robot_pose(relative_rad: float) -> None:
    graph = new_map()
    drive(graph, ahead(1.0), turning(0.5))
    for target in range(4):
        before = graph.pose
        arrive(graph, target, relative_rad)
        assert pose_is_near(graph.pose, *before)
        assert pose_is_near(graph.pose_of(target), before.x_m, before.y_m,
                            before.heading_rad - relative_rad)
        drive(graph, turning(0.4), ahead(1.0))


# The pose between experiences


def test_offset_rotates_with_relaxed_experience() -> None:
    """In OpenRatSLAM the offset keeps its direction if relaxation turns the experience."""
    graph = new_map(exp_loops=0)
    arrive(graph, 0)
    go(graph, 1, ahead(1.0))
    go(graph, 0, turning(1.0), ahead(1.0))  # odometry that contradicts the first link
    go(graph, 1, ahead(1.0))
    drive(graph, ahead(2.0), turning(0.3))
    graph = restored(graph, ExperienceMapParameters(exp_relaxation='sweep', exp_loops=30))
    before = graph.pose_of(1)
    graph.apply(NONE)
    after = graph.pose_of(1)
    assert abs(wrap(after.heading_rad - before.heading_rad)) > 0.1
    assert pose_is_near(graph.pose, *composed(after, Pose(2.0, 0.0, 0.3)))
    assert pose_is_near(graph.pose, after.x_m + 2.0 * math.cos(after.heading_rad),
                        after.y_m + 2.0 * math.sin(after.heading_rad),
                        after.heading_rad + 0.3)


def test_pose_between_experiences_integrates_odometry() -> None:
    graph = new_map(exp_initial_em_deg=20.0, exp_loops=0)
    expected = graph.pose
    for step in range(500):
        motion = Motion(0.1, 0.05, 0.3 * math.sin(0.05 * step))
        expected = moved(expected, motion)
        drive(graph, motion)
        if step % 20 == 0:
            arrive(graph, len(graph))
        assert pose_is_near(graph.pose, *expected, 1e-9)


# Actions


def test_action_none_keeps_motion_and_duration() -> None:
    graph = new_map(exp_loops=0)
    arrive(graph, 0)
    for _ in range(3):
        drive(graph, ahead(0.5, 0.2))
        graph.apply(NONE)
    arrive(graph, 1)
    (link,) = graph.links()
    assert link.distance_m == pytest.approx(1.5)
    assert link.duration_s == pytest.approx(0.6)


def test_apply_with_scan_match_uses_its_poses() -> None:
    place = Place(0.0, 0.0, 0.0)
    graph = new_map()
    graph.apply(MapAction('create', NO_EXPERIENCE, 0, 0, 0.0, place))
    graph.integrate(Motion(1.0, 1.0, 0.0))
    graph.apply(MapAction('create', 0, 1, 1, 0.0, place))
    graph.integrate(Motion(1.0, -0.8, 0.0))
    scan_match = ScanMatch(Pose(-0.9, 0.0, 0.0), Pose(0.1, 0.0, 0.0))
    graph.apply(MapAction('link', 1, 0, 0, 0.0, place), scan_match=scan_match)
    assert graph.pose == pytest.approx((0.1, 0.0, 0.0))
    assert graph.links()[1].relative_pose == pytest.approx((-1.0, 0.0, 0.0))  # as the first
    graph.settle()
    assert graph.poses == pytest.approx(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))


# Neighbours seen from the robot


def test_status_contains_both_ends_of_links() -> None:
    graph = new_map()
    assert graph.status() == (NO_EXPERIENCE, [])
    arrive(graph, 0)
    assert graph.status() == (0, [])
    for target in (1, 2, 0):
        go(graph, target, ahead(1.0))
    assert graph.status() == (0, [1, 2])  # 0 -> 1 begins here, 2 -> 0 ends here
    go(graph, 3, ahead(1.0))
    assert graph.status() == (3, [0])


def test_distance_and_direction_use_the_shortest_link() -> None:
    graph = new_map()
    arrive(graph, 0)
    go(graph, 1, ahead(2.0), turning(math.pi / 2))
    drive(graph, ahead(1.0))
    distance, direction = graph.distance_and_direction(0)  # behind the robot, to the left
    assert distance == pytest.approx(math.sqrt(5.0))
    assert direction == pytest.approx(math.pi - math.atan2(2.0, 1.0))
    drive(graph, turning(math.pi / 2))
    assert graph.distance_and_direction(0).direction_rad == pytest.approx(math.atan2(1.0, 2.0))
    go(graph, 0, ahead(9.0))  # the link back is longer and contradicts the first one
    drive(graph, ahead(0.5))
    result = graph.distance_and_direction(1)
    assert result.distance_m == pytest.approx(1.5)
    assert result.direction_rad == pytest.approx(0.0)


def test_distance_and_direction_without_link_raise() -> None:
    graph = new_map()
    for target in (0, 1, 0, 2):
        go(graph, target, ahead(1.0))
    with pytest.raises(NotLinked, match=r'experience 1 and the current one, 2; .* are 0'):
        graph.distance_and_direction(1)
    with pytest.raises(NotLinked, match='neighbours are none'):
        new_map().distance_and_direction(0)
