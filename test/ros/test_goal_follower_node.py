# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node that drives the robot: tasks, commands and safety stops."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Twist
from helpers import PERIOD_NS, START_NS
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from ros_messages import MakeWorld, even_scan, laser_scan, odometry, stamped_pose, string
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.driving.goal_queue import SoughtGoal
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.route_following import Guidance
from ratslam_ros.messages.goals import BehaviourReport, GoalStatus
from ratslam_ros.messages.json_schema import decode, encode
from ratslam_ros.messages.pose_cells import GoalMemoryPayload
from ratslam_ros.ros.convert import path_of
from ratslam_ros.ros.navigation.goal_follower_node import GoalFollowerNode
from ratslam_ros.ros.qos import LATCHED, STATE

BEAMS = 181


class Robot:
    """Sends the inputs of the node, and receives its commands."""

    def __init__(self, world: MakeWorld, *arguments: str) -> None:
        self.world = world(GoalFollowerNode, arguments=arguments)
        self.velocities = self.world.listen(Twist, 'cmd_vel')
        self.reports = self.world.listen(String, 'goal_follower/behaviour')
        self.stamp_ns = START_NS

    def scan(self, ranges_m: Any = 5.0, **changed: Any) -> None:
        self.stamp_ns += PERIOD_NS
        scan = even_scan(self.stamp_ns, ranges_m)
        self.world.send('scan', laser_scan(scan, **changed))

    def pose(self, x: float = 0.0, y: float = 0.0, heading: float = 0.0) -> None:
        message = stamped_pose(x, y, heading_rad=heading, stamp_ns=self.stamp_ns)
        self.world.send('experience_map/pose', message)

    def odometry(self) -> None:
        self.world.send('odom', odometry(self.stamp_ns))

    def route(self, *places: tuple[float, float]) -> None:
        positions = np.array(places, np.float64).reshape(-1, 2)
        path = path_of(positions, [0.0] * len(places), self.stamp_ns, 'map')
        self.world.send('experience_map/route', path, LATCHED)

    def status(self, status: Any, explore: bool = False, behaviour: str = '') -> None:
        around = ExperienceMap(ExperienceMapParameters())
        guidance = Guidance(status, explore=explore, behaviour=behaviour)
        payload = encode(GoalStatus.of(self.stamp_ns, around, guidance, [], []))
        self.world.send('experience_map/status', string(payload), LATCHED)

    def settle(self) -> None:
        """Wait until sent messages have arrived, for less time than any timeout."""
        for _ in range(3):  # a stall ends one of them
            self.world.spin(0.02)

    def sense(self, ranges_m: Any = 5.0, **pose: float) -> Any:
        """Send pose and scan; return the resulting command."""
        self.pose(**pose)
        self.settle()
        count = len(self.reports)
        self.scan(ranges_m)
        self.world.until(lambda: len(self.reports) > count)
        self.world.spin(0.05)  # the command may arrive after the report
        return self.velocities[-1]

    def clear(self) -> None:
        self.settle()
        self.velocities.clear()
        self.reports.clear()

    @property
    def is_stopped(self) -> bool:
        last = self.velocities[-1]
        return bool(last.linear.x == 0.0 and last.angular.z == 0.0)


def test_route_is_followed_and_behaviour_reported(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    assert robot.sense().linear.x > 0.3
    assert robot.sense(x=1.0, heading=2.0).angular.z < -0.5  # the route leads to the right
    assert robot.sense(x=1.0, heading=2.0).linear.x == 0.0
    assert robot.sense(x=1.0, y=-0.3).angular.z > 0.0
    first, *_, last = [decode(BehaviourReport, report.data) for report in robot.reports]
    assert first.stamp.ns == START_NS + PERIOD_NS
    assert last.stamp.ns == robot.stamp_ns
    assert {decode(BehaviourReport, report.data).behaviour for report in robot.reports} >= {'turn'}
    assert not any(decode(BehaviourReport, report.data).failed for report in robot.reports)


def test_without_task_no_velocities_are_published(world: MakeWorld) -> None:
    robot = Robot(world)
    for _ in range(3):
        robot.pose()
        robot.odometry()
        robot.scan()
        robot.settle()
    assert robot.velocities == []
    robot.route((0.0, 0.0), (4.0, 0.0))
    assert robot.sense().linear.x > 0.0
    robot.route()
    robot.world.until(lambda: robot.is_stopped)
    robot.clear()
    robot.scan()
    robot.settle()
    assert robot.velocities == []


def test_missing_scans_stop_the_robot(world: MakeWorld) -> None:
    robot = Robot(world, '-p', 'scan_timeout_s:=0.3')
    robot.route((0.0, 0.0), (4.0, 0.0))
    assert robot.sense().linear.x > 0.0
    robot.world.until(lambda: robot.is_stopped, 2.0)
    state = robot.world.diagnostics()['goal_follower']
    assert state['level'] == '1'
    assert 'no scan' in state['message']
    assert robot.sense().linear.x > 0.0
    robot.pose()
    robot.scan()
    robot.settle()
    assert 'steering' not in robot.world.nodes[0].diagnostics.missing


def test_missing_pose_stops_the_robot(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    assert robot.sense().linear.x > 0.0

    def scan_until_stopped() -> bool:
        robot.scan()
        robot.world.spin(0.05)
        return robot.is_stopped

    robot.world.until(scan_until_stopped, 5.0)
    state = robot.world.diagnostics()['goal_follower']
    assert 'experience_map/pose' in state['message'] or 'no scan' in state['message']
    assert state['task'] == 'following'


def test_blocked_route_is_reported_as_failed_attempt(
    world: MakeWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('ratslam_ros.core.driving.goal_follower.TRY_TIMEOUT_S', 0.5)
    robot = Robot(world)
    robot.route((0.0, 0.0), (0.0, 4.0))
    for _ in range(7):
        robot.sense(0.45, heading=math.pi / 2)
    reports = [decode(BehaviourReport, message.data) for message in robot.reports]
    failed = [report for report in reports if report.failed]
    assert len(failed) == 1
    assert failed[0].ahead_rad == pytest.approx(math.pi / 2, abs=0.1)
    assert failed[0].stamp.ns >= START_NS + 6 * PERIOD_NS
    assert robot.world.diagnostics()['goal_follower']['tries_failed'] == '1'


def test_exploration_needs_odometry_and_is_settable(world: MakeWorld) -> None:
    robot = Robot(world, '-p', 'explore:=true')
    robot.scan()
    robot.world.until(lambda: robot.velocities)
    assert robot.is_stopped
    assert robot.reports == []
    robot.odometry()
    robot.settle()
    robot.scan()
    robot.world.until(lambda: robot.reports)
    robot.world.until(lambda: any(v.angular.z > 0.0 for v in robot.velocities))  # to the wall
    # The parameter may be changed at run time.

    [node] = robot.world.nodes
    [answer] = node.set_parameters([Parameter('explore', value=False)])
    assert answer.successful
    robot.world.until(lambda: robot.is_stopped)


def test_lost_route_explores_while_status_requests_it(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.status('lost', explore=True)
    robot.odometry()
    assert robot.sense().angular.z > 0.0  # to the wall on the left
    robot.status('idle')
    robot.world.until(lambda: robot.is_stopped)


def test_newer_status_without_route_drops_the_route(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    robot.status('idle')  # sent before the route; it may arrive after it
    assert robot.sense().linear.x > 0.0
    robot.status('following')
    assert robot.sense().linear.x > 0.0
    robot.status('idle')
    robot.world.until(lambda: robot.is_stopped)


def test_pause_and_close_stop_the_robot(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    assert robot.sense().linear.x > 0.0
    robot.world.call(SetBool, 'goal_follower/pause', data=True)
    robot.world.until(lambda: robot.is_stopped)
    robot.clear()
    robot.pose()
    robot.scan()
    robot.settle()
    assert all(v.linear.x == 0.0 for v in robot.velocities)
    robot.world.call(SetBool, 'goal_follower/pause', data=False)
    assert robot.sense().linear.x > 0.0
    robot.clear()
    robot.world.nodes[0].close()
    robot.world.until(lambda: robot.velocities)
    assert robot.is_stopped


def test_reset_drops_the_route(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    assert robot.sense().linear.x > 0.0
    assert robot.world.call(Trigger, 'goal_follower/reset').success
    robot.world.until(lambda: robot.is_stopped)


def test_invalid_scans_and_poses_are_refused_and_counted(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    assert robot.sense().linear.x > 0.0
    robot.clear()
    wrong: list[dict[str, Any]] = [
        {'ranges': []}, {'angle_min': math.nan}, {'angle_increment': 0.0},
        {'angle_increment': math.inf}, {'angle_increment': 1.0}, {'range_max': 0.0},
        {'range_min': math.nan},
    ]
    for fields in wrong:
        robot.scan(**fields)
    robot.route((math.nan, 0.0))
    broken = Odometry()
    broken.pose.pose.position.x = math.nan
    robot.world.send('odom', broken)
    robot.world.send('experience_map/status', string('{}'), LATCHED)
    robot.settle()
    state = robot.world.diagnostics()['goal_follower']
    assert int(state['refused']) >= len(wrong) + 3
    assert json.loads(state['scan_received']) == len(wrong) + 1
    assert all(v.linear.x == 0.0 for v in robot.velocities)  # no scan was used


# By the goal memory

BY_MEMORY = '-p', 'steer_by:=goal_memory'


class Seeker(Robot):
    """A robot that is led by the goal memory."""

    def lead(self, bearing_rad: float | None, **state: Any) -> None:
        sought = SoughtGoal('goal_1', bearing_rad, 5.0, **state)
        payload = encode(GoalMemoryPayload.of(self.stamp_ns, sought))
        self.world.send('pose_cells/goal_memory', string(payload), STATE)

    def led(self, bearing_rad: float | None, ranges_m: Any = 5.0) -> Any:
        """Send odometry, direction and scan; return the resulting command."""
        self.odometry()
        self.settle()
        self.lead(bearing_rad)
        return self.sense(ranges_m)


def test_direction_of_goal_memory_is_followed_until_reached(world: MakeWorld) -> None:
    robot = Seeker(world, *BY_MEMORY)
    assert robot.led(0.0).linear.x > 0.3
    assert robot.led(2.0).angular.z > 0.5
    assert robot.led(-2.0).angular.z < -0.5  # at once
    assert robot.led(0.0).linear.x > 0.3
    assert robot.led(0.0, 0.3).linear.x == 0.0  # an obstacle
    robot.lead(None, is_reached=True)
    robot.world.until(lambda: robot.is_stopped)
    robot.clear()
    robot.scan()
    robot.settle()
    assert robot.velocities == []
    assert robot.world.diagnostics()['goal_follower']['task'] == 'none'


def test_goal_that_is_given_up_stops_the_robot(world: MakeWorld) -> None:
    robot = Seeker(world, *BY_MEMORY)
    assert robot.led(0.0).linear.x > 0.3
    robot.lead(None, given_up='cancelled')
    robot.world.until(lambda: robot.is_stopped)
    assert robot.led(0.0).linear.x > 0.3  # the next goal


def test_goal_without_direction_is_explored_for(world: MakeWorld) -> None:
    robot = Seeker(world, *BY_MEMORY)
    assert robot.led(None).angular.z > 0.0  # to the wall on the left
    assert robot.world.diagnostics()['goal_follower']['task'] == 'exploring'


def test_direction_is_kept_in_the_frame_of_the_odometry(world: MakeWorld) -> None:
    robot = Seeker(world, *BY_MEMORY)
    robot.led(0.0)
    turned = odometry(robot.stamp_ns, pose=Pose(0.0, 0.0, 2.0))
    robot.world.send('odom', turned)
    assert robot.sense().angular.z < -0.5


@pytest.mark.parametrize('missing', ['no odometry', 'no pose_cells/goal_memory'])
def test_missing_direction_or_odometry_stops_the_robot(world: MakeWorld, missing: str) -> None:
    robot = Seeker(world, *BY_MEMORY)
    assert robot.led(0.0).linear.x > 0.3

    def stopped() -> bool:
        if 'odometry' in missing:
            robot.lead(0.0)
        else:
            robot.odometry()
        robot.scan()
        robot.world.spin(0.05)
        return robot.is_stopped

    robot.world.until(stopped, 5.0)
    assert missing in robot.world.diagnostics()['goal_follower']['message']


def test_route_of_the_map_is_not_followed_by_the_goal_memory(world: MakeWorld) -> None:
    robot = Seeker(world, *BY_MEMORY)
    topics = {one.topic_name.lstrip('/') for one in robot.world.nodes[0].subscriptions}
    assert 'pose_cells/goal_memory' in topics
    assert not topics & {'experience_map/route', 'experience_map/status'}
