# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Alignment of scans in the node of the experience map, also after loading a map."""

from __future__ import annotations

import pytest
from rclpy.parameter import Parameter
from rooms import Line, scan_in
from ros_messages import MakeWorld, laser_scan
from test_goal_navigation import Robot

from ratslam_ros.core.common.pose import Pose

ROOM: list[Line] = [
    [(-2.0, -1.5), (4.0, -1.5), (4.0, 2.0), (1.0, 2.0), (1.0, 3.5), (-2.0, 3.5), (-2.0, -1.5)],
]


def scan(robot: Robot, x_m: float) -> None:
    seen = scan_in(ROOM, Pose(x_m, 0.0, 0.0), robot.stamp_ns, beams=181)
    robot.made.send('scan', laser_scan(seen))


def scan_received(robot: Robot, x_m: float) -> None:
    scan(robot, x_m)
    robot.made.until(lambda: robot.node.host.pipeline.order.newest_of('scan') == robot.stamp_ns)


def learn(robot: Robot) -> None:
    """Create an experience with a scan; the earlier ones have none."""
    scan(robot, 0.0)
    robot.drive(0.0)
    scan_received(robot, 0.0)
    robot.arrive(6)


def test_scan_that_arrives_after_the_action_is_still_used(world: MakeWorld) -> None:
    """The action waits for the scans; ``flush_after_s`` is longer than the test."""
    robot = Robot(world, '-p', 'exp_align_scans:=true')
    learn(robot)
    robot.drive(1.0)
    robot.arrive(5)
    robot.node.set_parameters([Parameter('flush_after_s', value=60.0)])
    robot.drive(-1.0)
    robot.send_action(6)
    robot.made.until(lambda: robot.node.host.pipeline.order.newest_of('action') == robot.stamp_ns)
    assert robot.node._core.current_id == 5
    scan(robot, 0.2)
    robot.made.until(lambda: robot.node._core.current_id == 6)
    assert robot.node._core.offset.x_m == pytest.approx(0.2, abs=0.03)


def test_without_exp_align_scans_scans_are_not_subscribed(world: MakeWorld) -> None:
    robot = Robot(world)
    assert 'scan' not in [one.name for one in robot.node.inputs]
