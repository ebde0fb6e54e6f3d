# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frames of odometry and laser as nodes find them in messages and on /tf_static."""

from __future__ import annotations

import math
from typing import Any

import pytest
from helpers import PERIOD_NS, START_NS
from ros_messages import MakeWorld, even_scan, laser_scan, odometry
from tf2_msgs.msg import TFMessage

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import points_of
from ratslam_ros.core.config.experience_map import ExperienceMapParameters
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.ros.convert import transform
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.mapping import scans
from ratslam_ros.ros.qos import STATIC


class Robot:
    """A node that uses scans, and a robot with frames of its own."""

    def __init__(self, world: MakeWorld, *arguments: str) -> None:
        self.made = world(
            ExperienceMapNode, arguments=('-p', 'exp_align_scans:=true', *arguments)
        )
        [self.node] = self.made.nodes
        self.transforms = self.made.listen(TFMessage, '/tf')
        self.used: list[Any] = []
        push = self.node._push

        def pushed(stream: str, stamp_ns: int, item: Any) -> None:
            if stream.startswith('scan'):
                self.used.append(item)
            push(stream, stamp_ns, item)

        self.node._push = pushed

    def odometry(self, tick: int, odom: str = 'robot_odom', base: str = 'base_footprint') -> None:
        message = odometry(START_NS + tick * PERIOD_NS, frames=(odom, base))
        self.made.send('odom', message)

    def scan(self, tick: int, frame: str = 'laser', topic: str = 'scan') -> None:
        scan = even_scan(START_NS + tick * PERIOD_NS, 2.0)
        self.made.send(topic, laser_scan(scan, frame))

    def mount(self, pose: Pose, parent: str = 'base_footprint', child: str = 'laser') -> None:
        message = TFMessage(transforms=[transform(START_NS, parent, child, pose)])
        self.made.send('/tf_static', message, STATIC)


def test_scans_wait_for_the_transform_of_their_laser(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.odometry(0)
    for tick in range(3):
        robot.scan(tick)
    robot.made.until(lambda: len(robot.node._lasers[0]._waiting) == 3)
    assert robot.used == []
    robot.mount(Pose(0.3, 0.0, math.pi))
    robot.made.until(lambda: len(robot.used) == 3)
    points = points_of(robot.used[0])
    assert points[90] == pytest.approx([0.3 - 2.0, 0.0], abs=1e-6)  # it looks back
    assert points[0] == pytest.approx([0.3, 2.0], abs=1e-5)
    robot.scan(3)
    robot.made.until(lambda: len(robot.used) == 4)
    assert 'notice' not in robot.made.diagnostics()['experience_map']


def test_a_laser_without_a_transform_is_used_with_a_warning(
    world: MakeWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scans, 'MOUNT_TIMEOUT_S', 0.3)
    robot = Robot(world)
    robot.odometry(0)
    robot.scan(0)
    robot.made.until(lambda: robot.used)
    assert (robot.used[0].x_m, robot.used[0].y_m) == (0.0, 0.0)
    notice = robot.made.diagnostics()['experience_map']['notice']
    assert notice.startswith('there is no transform from base_footprint to laser on /tf_static')


def test_laser_is_placed_although_no_odometry_has_named_the_robot(
    world: MakeWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scans, 'MOUNT_TIMEOUT_S', 0.3)
    robot = Robot(world)
    robot.mount(Pose(0.3, 0.0, math.pi), parent='base_link')
    for tick in range(2):
        robot.scan(tick)
    robot.made.until(lambda: len(robot.used) == 2)
    assert [(one.x_m, one.y_m) for one in robot.used] == [(0.3, 0.0)] * 2
    assert 'notice' not in robot.made.diagnostics()['experience_map']


def test_frames_of_the_odometry_are_taken_from_its_messages(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.odometry(0)
    robot.made.until(lambda: robot.transforms)
    [transform] = robot.transforms[0].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ('map', 'robot_odom')


def test_a_parameter_that_contradicts_the_odometry_is_named(world: MakeWorld) -> None:
    robot = Robot(world, '-p', 'odom_frame:=odom')
    robot.odometry(0)
    robot.made.until(lambda: robot.transforms)
    [transform] = robot.transforms[0].transforms
    assert transform.child_frame_id == 'odom'
    notice = robot.made.diagnostics()['experience_map']['notice']
    assert 'the odometry has the frame_id robot_odom, but odom_frame is odom' in notice


def test_each_of_two_lasers_is_placed_through_its_own_frame(world: MakeWorld) -> None:
    robot = Robot(world, '-p', 'scan_topics:=scan,scan_rear')
    robot.odometry(0)
    robot.mount(Pose(0.2, 0.0, 0.0))
    robot.scan(0)
    robot.scan(0, 'rear', 'scan_rear')  # of the same stamp
    robot.made.until(lambda: len(robot.used) == 1)
    assert (robot.used[0].laser, robot.used[0].x_m) == (0, 0.2)
    robot.mount(Pose(-0.2, 0.0, math.pi), child='rear')
    robot.made.until(lambda: len(robot.used) == 2)
    assert (robot.used[1].laser, robot.used[1].x_m) == (1, -0.2)
    assert points_of(robot.used[1])[90] == pytest.approx([-2.2, 0.0], abs=1e-6)
    assert robot.node.diagnostics.counts['refused'] == 0


@pytest.mark.parametrize('topics', ['scan,', 'scan,scan', ','.join(map(str, range(9)))])
def test_unusable_lists_of_lasers_are_refused(topics: str) -> None:
    with pytest.raises(UnusableParameter, match='expected 1 to 8 different topics'):
        ExperienceMapParameters(scan_topics=topics)
