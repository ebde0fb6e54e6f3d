# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Standard types beside JSON: occupancy grid, pose with covariance, and poses of an operator."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from ros_messages import MakeWorld
from std_msgs.msg import String
from test_goal_navigation import Robot
from test_scan_alignment_node import learn

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.messages.json_schema import decode
from ratslam_ros.messages.map_changes import ClosurePayload
from ratslam_ros.messages.mapping import Correction
from ratslam_ros.ros.qos import LATCHED, RESULT


def test_grid_of_the_scans_is_latched_and_placed_on_the_map(world: MakeWorld) -> None:
    robot = Robot(world, '-p', 'exp_align_scans:=true')
    learn(robot)
    grids = robot.made.listen(OccupancyGrid, 'experience_map/grid', LATCHED)
    robot.made.until(lambda: grids)
    [grid] = grids[-1:]
    assert grid.header.frame_id == 'map'
    assert grid.info.resolution == pytest.approx(0.05)
    percent = np.array(grid.data, np.int8).reshape(grid.info.height, grid.info.width)
    assert set(np.unique(percent).tolist()) == {-1, 40, 70}
    # The robot looks along y of the map from (0, 5): the wall 4 m ahead is at y = 9.
    assert robot.node._core.pose[:2] == pytest.approx((0.0, 5.0), abs=1e-6)
    row = int((9.02 - grid.info.origin.position.y) / 0.05)
    column = int((0.02 - grid.info.origin.position.x) / 0.05)
    assert percent[row - 1 : row + 2, column].max() == 70
    assert percent[row - 10, column] == 40
    late = robot.made.listen(OccupancyGrid, 'experience_map/grid', LATCHED)
    robot.made.until(lambda: late)


def test_grid_is_not_drawn_without_a_subscriber(world: MakeWorld) -> None:
    robot = Robot(world, '-p', 'exp_align_scans:=true')
    learn(robot)
    robot.made.spin(0.3)
    assert robot.node._grid._grid.is_empty


def test_correction_is_reported_once_and_pose_once_per_stamp(world: MakeWorld) -> None:
    robot = Robot(world)
    poses = robot.made.listen(PoseStamped, 'experience_map/pose')
    corrections = robot.made.listen(String, 'experience_map/correction', RESULT)
    for n in range(3):
        robot.drive(0.4, 0.5)
        robot.made.until(lambda n=n: len(poses) == n + 1)
    robot.arrive(2)  # 3 m and 1.2 m back
    robot.made.until(lambda: corrections)
    robot.drive(0.1)
    robot.made.until(lambda: len(poses) == 4)
    [correction] = [decode(Correction, message.data) for message in corrections]
    assert correction.experience_id == 2
    assert correction.stamp.ns == robot.stamp_ns - 10**9
    assert correction.before.pose == pytest.approx(Pose(0.0, 6.2, math.pi / 2))
    assert math.dist(correction.after.pose[:2], robot.node._core.pose_of(2)[:2]) < 1e-9
    stamps = [(p.header.stamp.sec, p.header.stamp.nanosec) for p in poses]
    assert len(set(stamps)) == 4
    y_m = correction.after.y_m + 0.1
    assert poses[-1].pose.position.y == pytest.approx(y_m)


def test_covariance_grows_with_the_distance_and_shrinks_at_known_places(world: MakeWorld) -> None:
    robot = Robot(world)
    poses = robot.made.listen(
        PoseWithCovarianceStamped, 'experience_map/pose_with_covariance'
    )
    for n in range(10):
        robot.drive(9.5)
        robot.arrive(6 + n)
    robot.drive(1.0)
    robot.made.until(lambda: len(poses) == 11)
    matrix = np.array(poses[-1].pose.covariance).reshape(6, 6)
    assert np.array_equal(matrix, matrix.T)
    assert matrix[1, 1] == pytest.approx(0.003 * 100.0)  # along the drive
    assert matrix[0, 0] > 20.0  # across it, by the drift of the heading
    assert matrix[0, 5] < -0.4
    assert matrix[5, 5] == pytest.approx(9e-5 * 100.0)
    assert not matrix[2:5].any()
    robot.arrive(2)
    robot.drive(0.1)
    robot.made.until(lambda: len(poses) == 12)
    assert poses[-1].pose.covariance[0] == pytest.approx(0.16, abs=1e-3)
    assert poses[-1].pose.covariance[35] == pytest.approx(math.radians(6.0) ** 2, abs=1e-4)


def given(x_m: float, y_m: float, frame: str = 'map', variance: float = 0.25) -> Any:
    """Return a pose as RViz's "2D Pose Estimate" gives it, heading along y."""
    message = PoseWithCovarianceStamped()
    message.header.frame_id = frame
    message.header.stamp.sec = 2**31 - 1  # another clock
    message.pose.pose.position.x, message.pose.pose.position.y = x_m, y_m
    message.pose.pose.orientation.z = message.pose.pose.orientation.w = math.sqrt(0.5)
    message.pose.covariance[0] = message.pose.covariance[7] = variance
    message.pose.covariance[35] = 0.07
    return message


def outcomes(robot: Robot, targets: tuple[int, ...]) -> list[str]:
    """Return the outcomes of closures with experiences 1 m apart."""
    found = robot.made.listen(String, 'experience_map/closures')
    for n, target in enumerate(targets):
        robot.drive(1.0)
        robot.send_action(target)
        robot.made.until(lambda n=n: len(found) == n + 1)
    return [decode(ClosurePayload, message.data).outcome for message in found]


@pytest.mark.parametrize(
    ('y_m', 'expected'), [(0.0, ['relocated']), (-30.0, ['rejected', 'relocated'])]
)
def test_initialpose_moves_the_robot_and_places_decide(
    world: MakeWorld, y_m: float, expected: list[str]
) -> None:
    robot = Robot(world, '-p', 'exp_gate_closures:=true')
    robot.drive(15.0)
    robot.arrive(6)
    robot.made.send('initialpose', given(0.0, y_m))
    robot.made.until(lambda: robot.node._core.hint is not None)
    assert robot.node._core.pose[:2] == pytest.approx((0.0, y_m))
    assert outcomes(robot, (1, 2)[: len(expected)]) == expected
    assert robot.node._core.localisation == 'localised'


def test_unusable_initialpose_is_refused(world: MakeWorld) -> None:
    robot = Robot(world, '-p', 'exp_gate_closures:=true')
    for message in (given(0.0, 0.0, 'odom'), given(math.nan, 0.0), given(0.0, 0.0, 'map', -1.0)):
        refused = robot.node.diagnostics.counts['refused']
        robot.made.send('initialpose', message)
        robot.made.until(
            lambda refused=refused: robot.node.diagnostics.counts['refused'] > refused
        )
    assert robot.node._core.hint is None
