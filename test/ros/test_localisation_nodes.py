# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the node of the map states about the robot's pose: diagnostics, status, TF and goals."""

from __future__ import annotations

from pathlib import Path

import pytest
from ros_messages import MakeWorld, stamped_pose
from std_msgs.msg import String
from test_goal_navigation import Robot, S
from test_standard_topics import given
from tf2_msgs.msg import TFMessage

from ratslam_ros.messages.goals import GoalStatus
from ratslam_ros.messages.json_schema import decode
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.qos import LATCHED

OK, WARN = 0, 1


class Statements:
    """What a map node says: transforms, and its diagnostics."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.transforms = robot.made.listen(TFMessage, '/tf')

    def publish(self) -> tuple[int, str]:
        """Return level and message of the diagnostics."""
        status = self.robot.made.diagnostics()['experience_map']
        return int(status['level']), status['message']

    def moves(self) -> int:
        """Drive 0.1 m; return the number of transforms that are published then."""
        count = len(self.transforms)
        before = self.robot.node._pose_ns
        self.robot.drive(0.1)
        self.robot.made.until(lambda: self.robot.node._pose_ns > before)
        self.robot.made.spin(0.1)
        return len(self.transforms) - count


def gap(robot: Robot) -> None:
    """Leave a gap of the odometry; a second message confirms the jump of the stamps."""
    robot.drive(1.0, 60.0)
    for _ in range(3):
        robot.drive(0.1)


def recognise(robot: Robot, target: int) -> None:
    """Send actions until the map accepts their stamps after a gap."""
    for _ in range(3):
        robot.drive(0.1)
        robot.send_action(target)
    robot.made.until(lambda: robot.node._core.current_id == target)


def started_again(robot: Robot, world: MakeWorld, *arguments: str) -> Robot:
    """Close the node, and start another one with the same map an hour later."""
    robot.made.close()
    robot.made.close = lambda: None
    again = Robot.__new__(Robot)
    again.made = world(ExperienceMapNode, arguments=('-p', 'flush_after_s:=0.1', *arguments))
    [again.node] = again.made.nodes
    again.node.host.map.open()
    again.made.until(lambda: not again.node.host.map.recovery.is_catching_up)
    again.statuses = again.made.listen(String, 'experience_map/status', LATCHED)
    again.stamp_ns, again.known = robot.stamp_ns + 3600 * S, robot.known
    again.sequence = robot.sequence
    return again


@pytest.fixture
def saved(world: MakeWorld, tmp_path: Path) -> tuple[Robot, tuple[str, ...]]:
    """Return a robot with a saved map of 6 places, and the arguments of its node."""
    arguments = '-p', f'map:={tmp_path / "office.ratslam"}'

    class Saving(Robot):
        def odometry(self, speed: float) -> None:
            if self.node.host.map.store is None:
                self.node.host.map.open()
                self.made.until(lambda: not self.node.host.map.recovery.is_catching_up)
            super().odometry(speed)

    return Saving(world, *arguments), arguments


def test_restart_in_a_saved_map_warns_until_a_place_is_recognised(
    world: MakeWorld, saved: tuple[Robot, tuple[str, ...]]
) -> None:
    first, arguments = saved
    assert Statements(first).publish()[0] == OK
    robot = started_again(first, world, *arguments)
    node = Statements(robot)
    level, text = node.publish()
    assert level == WARN
    assert 'has started in a saved map' in text
    assert node.moves() == 0
    robot.made.until(lambda: 'a session has begun' in node.publish()[1])
    assert node.publish()[0] == WARN
    robot.until_status(localisation='unknown')
    robot.arrive(2)
    assert node.moves() == 1
    robot.until_status(localisation='localised')
    assert 'the pose on the map is unknown' not in node.publish()[1]


def test_initialpose_is_shown_at_once_without_a_recognised_place(
    world: MakeWorld, saved: tuple[Robot, tuple[str, ...]]
) -> None:
    first, arguments = saved
    robot = started_again(first, world, *arguments)
    node = Statements(robot)
    robot.made.send('initialpose', given(0.2, 3.0))
    robot.made.until(lambda: robot.node._core.pose[:2] == pytest.approx((0.2, 3.0)))
    assert node.moves() == 1
    at = node.transforms[-1].transforms[0].transform
    # The first message of a session has no motion, and the odometry stays at its origin.
    assert (at.translation.x, at.translation.y) == pytest.approx((0.2, 3.0), abs=1e-6)
    assert robot.made.diagnostics()['experience_map']['localisation'] == 'uncertain'
    robot.until_status(localisation='uncertain')
    robot.arrive(3)
    robot.until_status(localisation='localised')


def test_goal_waits_while_localisation_is_lost(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.text('experience_map/goal', '{"experience_id": 1}')
    robot.until_status(status='following', reason='')
    gap(robot)
    lost = robot.until_status(localisation='unknown', status='lost')
    assert lost.explore
    assert 'the pose on the map is unknown' in lost.reason
    assert [task.status for task in lost.queue] == ['active']
    robot.text('experience_map/goal', '{"experience_id": 0, "append": true}')
    robot.made.until(lambda: len(robot.node._goals._navigator.queue) == 2)
    recognise(robot, 4)
    found = robot.until_status(localisation='localised', status='following')
    assert (found.reason, len(found.queue)) == ('', 2)


def test_goal_given_while_the_pose_is_unknown_waits_with_a_reason(world: MakeWorld) -> None:
    robot = Robot(world)
    gap(robot)
    robot.until_status(localisation='unknown')
    robot.text('experience_map/goal', '{"x_m": 0.1, "y_m": 1.0}')
    waiting = robot.until_status(status='lost')
    assert 'drive until a place is recognised' in waiting.reason
    robot.text('experience_map/goal', '{"x_m": 50.0, "y_m": 1.0}')  # off the map
    assert 'm away; expected at most' in robot.until_status(queue=[]).reason
    robot.text('experience_map/goal', '{"experience_id": 2}')
    robot.until_status(status='lost')
    recognise(robot, 4)
    robot.until_status(status='following', reason='')


def test_goal_in_the_frame_of_the_robot_needs_its_pose(world: MakeWorld) -> None:
    robot = Robot(world)
    gap(robot)
    robot.until_status(localisation='unknown')
    robot.made.send('goal_pose', stamped_pose(0.0, 0.0, 'base_link'))
    robot.made.until(lambda: 'is unknown' in decode(GoalStatus, robot.statuses[-1].data).reason)
    assert not robot.node._goals._navigator.queue
