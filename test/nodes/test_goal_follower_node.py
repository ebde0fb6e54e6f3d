# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node that moves the robot: where to, and when it must not."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers import START_NS

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.route_following import Guidance
from ratslam_ros.messages.goals import decode_behaviour, encode_status

MakeWorld = Callable[..., Any]
BEAMS = 181
STEP_NS = 100_000_000


class Robot:
    """Sends what the node wants, and hears what it says."""

    def __init__(self, world: MakeWorld, *arguments: str) -> None:
        from geometry_msgs.msg import Twist
        from std_msgs.msg import String

        from ratslam_ros.nodes.goal_follower_node import GoalFollowerNode

        self.world = world(GoalFollowerNode, arguments=arguments)
        self.velocities = self.world.listen(Twist, 'cmd_vel')
        self.notes = self.world.listen(String, 'goal_follower/behaviour')
        self.stamp_ns = START_NS

    def scan(self, ranges_m: Any = 5.0, **changed: Any) -> None:
        from sensor_msgs.msg import LaserScan

        from ratslam_ros.nodes.convert import header_of

        self.stamp_ns += STEP_NS
        fields = {
            'header': header_of(self.stamp_ns, 'laser'), 'angle_min': -math.pi / 2,
            'angle_max': math.pi / 2, 'angle_increment': math.pi / (BEAMS - 1), 'range_min': 0.02,
            'range_max': 8.0,
            'ranges': np.broadcast_to(ranges_m, BEAMS).astype(np.float32).tolist(),
        }  # fmt: skip
        self.world.send('scan', LaserScan(**{**fields, **changed}))

    def pose(self, x: float = 0.0, y: float = 0.0, heading: float = 0.0) -> None:
        from geometry_msgs.msg import PoseStamped

        from ratslam_ros.core.common.pose import Pose
        from ratslam_ros.nodes.convert import header_of, pose_message

        message = PoseStamped(header=header_of(self.stamp_ns, 'map'))
        message.pose = pose_message(Pose(x, y, heading))
        self.world.send('experience_map/pose', message)

    def odometry(self) -> None:
        from nav_msgs.msg import Odometry

        from ratslam_ros.nodes.convert import header_of

        message = Odometry(header=header_of(self.stamp_ns, 'odom'))
        message.pose.pose.orientation.w = 1.0
        self.world.send('odom', message)

    def route(self, *places: tuple[float, float]) -> None:
        from ratslam_ros.nodes.paths import path_of
        from ratslam_ros.nodes.qos import LATCHED

        positions = np.array(places, np.float64).reshape(-1, 2)
        path = path_of(positions, [0.0] * len(places), self.stamp_ns, 'map')
        self.world.send('experience_map/route', path, LATCHED)

    def status(self, status: Any, explore: bool = False, behaviour: str = '') -> None:
        from std_msgs.msg import String

        from ratslam_ros.core.config import ExperienceMapParameters
        from ratslam_ros.nodes.qos import LATCHED

        around = ExperienceMap(ExperienceMapParameters())
        guidance = Guidance(status, explore=explore, behaviour=behaviour)
        payload = encode_status(self.stamp_ns, around, guidance, [], [])
        self.world.send('experience_map/status', String(data=payload), LATCHED)

    def settle(self) -> None:
        """Let all that was sent arrive, in less time than anything needs to be over."""
        self.world.spin(0.15)

    def sense(self, ranges_m: Any = 5.0, **pose: float) -> Any:
        """Send place and scan; return the command that follows."""
        self.pose(**pose)
        self.settle()
        noted = len(self.notes)
        self.scan(ranges_m)
        self.world.until(lambda: len(self.notes) > noted)
        self.world.spin(0.05)  # what was sent before the note may come after it
        return self.velocities[-1]

    def clear(self) -> None:
        self.settle()
        self.velocities.clear()
        self.notes.clear()

    @property
    def stands(self) -> bool:
        last = self.velocities[-1]
        return bool(last.linear.x == 0.0 and last.angular.z == 0.0)


@pytest.mark.parametrize(('wall', 'side'), [('left_wall', 1.0), ('right_wall', -1.0)])
def test_the_wall_that_a_route_was_learned_along_is_followed_again(
    world: MakeWorld, wall: str, side: float
) -> None:
    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    robot.status('following', behaviour=wall)
    robot.settle()
    assert side * robot.sense().angular.z > 0.3  # it goes to look for it
    assert decode_behaviour(robot.notes[-1].data).behaviour == wall


def test_the_robot_follows_its_route_and_says_what_it_does(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    assert robot.sense().linear.x > 0.3
    assert robot.sense(x=1.0, heading=2.0).angular.z < -0.5  # the route leads to the right
    assert robot.sense(x=1.0, heading=2.0).linear.x == 0.0
    assert robot.sense(x=1.0, y=-0.3).angular.z > 0.0
    first, *_, last = [decode_behaviour(note.data) for note in robot.notes]
    assert first.stamp_ns == START_NS + STEP_NS
    assert last.stamp_ns == robot.stamp_ns
    assert {decode_behaviour(note.data).behaviour for note in robot.notes} >= {'turn'}
    assert not any(decode_behaviour(note.data).failed for note in robot.notes)


def test_what_is_passed_of_the_route_is_passed(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.route((0.0, 0.0), (1.5, 0.0), (1.5, 4.0))
    assert abs(robot.sense().angular.z) < 0.3
    for x in (0.5, 1.0, 1.5):
        robot.sense(x=x)
    # Seen from the corner on, the beginning of the route would lead back.
    assert robot.sense(x=1.5, y=0.5, heading=math.pi / 2).linear.x > 0.3


def test_without_anything_to_do_it_is_silent_and_lets_others_drive(world: MakeWorld) -> None:
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
    robot.clear()
    robot.scan()
    robot.settle()
    assert robot.velocities == []


def test_the_end_of_the_route_is_the_end_of_driving(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    assert robot.sense().linear.x > 0.0
    robot.route()
    robot.world.until(lambda: robot.stands)


def test_it_stops_at_once_when_no_scan_comes(world: MakeWorld) -> None:
    robot = Robot(world, '-p', 'scan_timeout_s:=0.3')
    robot.route((0.0, 0.0), (4.0, 0.0))
    assert robot.sense().linear.x > 0.0
    robot.world.until(lambda: robot.stands, 2.0)
    state = robot.world.diagnostics()['goal_follower']
    assert state['level'] == '1'
    assert 'no scan' in state['message']
    assert robot.sense().linear.x > 0.0
    robot.pose()
    robot.scan()
    robot.settle()
    assert 'steering' not in robot.world.nodes[0]._diagnostics.missing


def test_it_stops_when_nobody_tells_where_it_is(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    assert robot.sense().linear.x > 0.0

    def scan_until_it_stands() -> bool:
        robot.scan()
        robot.world.spin(0.05)
        return robot.stands

    robot.world.until(scan_until_it_stands, 5.0)
    state = robot.world.diagnostics()['goal_follower']
    assert 'experience_map/pose' in state['message'] or 'no scan' in state['message']
    assert state['task'] == 'following'


@pytest.mark.parametrize('gap_m', [0.3, 0.36])
def test_it_never_drives_towards_what_is_within_its_stop_distance(
    world: MakeWorld, gap_m: float
) -> None:
    """Robot radius and stop distance are 0.37 m in all."""
    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    ahead = np.full(BEAMS, 5.0)
    ahead[85:96] = gap_m
    for _ in range(3):
        assert robot.sense(ahead).linear.x == 0.0
    assert robot.sense().linear.x > 0.0


def test_what_is_too_close_to_measure_is_an_obstacle_and_what_is_far_is_none(
    world: MakeWorld,
) -> None:
    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    for nothing in (math.inf, math.nan, 9.0, 0.01):
        assert robot.sense(nothing).linear.x > 0.3
    assert robot.sense(-math.inf).linear.x == 0.0


def test_a_way_that_stays_blocked_is_a_failed_try_told_on_the_map(world: MakeWorld) -> None:
    robot = Robot(world, '-p', 'try_timeout_s:=0.5')
    robot.route((0.0, 0.0), (0.0, 4.0))
    for _ in range(7):
        robot.sense(0.45, heading=math.pi / 2)
    failed = [n for n in map(decode_behaviour, (m.data for m in robot.notes)) if n.failed]
    assert len(failed) == 1
    assert failed[0].ahead_rad == pytest.approx(math.pi / 2, abs=0.1)
    assert failed[0].stamp_ns >= START_NS + 6 * STEP_NS
    assert robot.world.diagnostics()['goal_follower']['tries_failed'] == '1'


def test_it_explores_if_it_shall_but_not_without_odometry(world: MakeWorld) -> None:
    robot = Robot(world, '-p', 'explore:=true')
    robot.scan()
    robot.world.until(lambda: robot.velocities)
    assert robot.stands
    assert robot.notes == []
    robot.odometry()
    robot.settle()
    robot.scan()
    robot.world.until(lambda: robot.notes)
    robot.world.until(lambda: any(v.angular.z > 0.0 for v in robot.velocities))  # to the wall
    # Which may be switched while it runs.
    from rclpy.parameter import Parameter

    [node] = robot.world.nodes
    [answer] = node.set_parameters([Parameter('explore', value=False)])
    assert answer.successful
    robot.world.until(lambda: robot.stands)


def test_a_robot_that_has_lost_its_way_explores_while_the_map_says_so(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.status('lost', explore=True)
    robot.odometry()
    assert robot.sense().angular.z > 0.0  # to the wall on the left
    robot.status('idle')
    robot.world.until(lambda: robot.stands)


def test_a_route_that_the_map_knows_nothing_of_is_dropped(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    robot.status('idle')  # of before: it may arrive after the route
    assert robot.sense().linear.x > 0.0
    robot.status('following')
    assert robot.sense().linear.x > 0.0
    robot.status('idle')
    robot.world.until(lambda: robot.stands)


def test_it_stops_for_a_pause_and_in_the_end(world: MakeWorld) -> None:
    from std_srvs.srv import SetBool

    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    assert robot.sense().linear.x > 0.0
    robot.world.call(SetBool, 'goal_follower/pause', data=True)
    robot.world.until(lambda: robot.stands)
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
    assert robot.stands


def test_reset_forgets_the_route(world: MakeWorld) -> None:
    from std_srvs.srv import Trigger

    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    assert robot.sense().linear.x > 0.0
    assert robot.world.call(Trigger, 'goal_follower/reset').success
    robot.world.until(lambda: robot.stands)


def test_scans_and_places_that_are_wrong_are_refused_and_counted(world: MakeWorld) -> None:
    from nav_msgs.msg import Odometry
    from std_msgs.msg import String

    from ratslam_ros.nodes.qos import LATCHED

    robot = Robot(world)
    robot.route((0.0, 0.0), (4.0, 0.0))
    assert robot.sense().linear.x > 0.0
    robot.clear()
    wrong: list[dict[str, Any]] = [
        {'ranges': []}, {'angle_min': math.nan}, {'angle_increment': 0.0},
        {'angle_increment': math.inf}, {'angle_increment': 1.0}, {'range_max': 0.0},
        {'range_min': math.nan},
    ]  # fmt: skip
    for fields in wrong:
        robot.scan(**fields)
    robot.route((math.nan, 0.0))
    broken = Odometry()
    broken.pose.pose.position.x = math.nan
    robot.world.send('odom', broken)
    robot.world.send('experience_map/status', String(data='{}'), LATCHED)
    robot.settle()
    state = robot.world.diagnostics()['goal_follower']
    assert int(state['refused']) >= len(wrong) + 3
    assert json.loads(state['scan_received']) == len(wrong) + 1
    assert all(v.linear.x == 0.0 for v in robot.velocities)  # as none of the scans counts
