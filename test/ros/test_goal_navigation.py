# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goals on topics and services: names, queue, waypoint, status, arrival times, behaviours."""

from __future__ import annotations

import json
import math
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from helpers import START_NS, S
from nav_msgs.msg import Path
from ros_messages import MakeWorld, action_text, odometry, string
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ratslam_ros.core.pose_cells.map_action import Action
from ratslam_ros.messages.goals import BehaviourReport, GoalStatus
from ratslam_ros.messages.json_schema import decode, encode
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.qos import LATCHED


class Robot:
    """A node of the experience map, and the odometry and actions sent to it.

    The robot drives along y of the map and creates an experience at each metre, from 0 to 5.
    """

    def __init__(self, world: MakeWorld, *arguments: str) -> None:
        self.made = world(ExperienceMapNode, arguments=('-p', 'flush_after_s:=0.1', *arguments))
        [self.node] = self.made.nodes
        self.statuses = self.made.listen(String, 'experience_map/status', LATCHED)
        self.stamp_ns = START_NS
        self.sequence = 0
        self.known = 0
        self.odometry(0.0)
        for n in range(6):
            self.drive(1.0 if n else 0.0)
            self.arrive(n)

    def odometry(self, speed: float) -> None:
        self.made.send('odom', odometry(self.stamp_ns, speed))

    def drive(self, way_m: float, seconds: float = 1.0) -> None:
        self.stamp_ns += round(seconds * S)
        self.odometry(way_m / seconds)

    def arrive(self, target: int) -> None:
        """Send the action of an experience, and wait until it is the current one."""
        self.send_action(target)
        self.made.until(lambda: self.node._core.current_id == target)

    def send_action(self, target: int) -> None:
        """Send the action of an experience."""
        kind: Action = 'create' if target == self.known else 'link'
        self.known = max(self.known, target + 1)
        source = self.node._core.current_id
        text = action_text(self.stamp_ns, self.sequence, kind, source, target)
        self.text('pose_cells/action', text)
        self.sequence += 1

    def text(self, topic: str, text: str) -> None:
        self.made.send(topic, string(text))

    def call(self, service: str) -> Any:
        return self.made.call(Trigger, f'experience_map/{service}')

    def until_status(self, **expected: Any) -> GoalStatus:
        """Return the next status with the expected values."""

        def has_arrived() -> bool:
            if not self.statuses:
                return False
            status = decode(GoalStatus, self.statuses[-1].data)
            return all(getattr(status, key) == value for key, value in expected.items())

        self.made.until(has_arrived)
        return decode(GoalStatus, self.statuses[-1].data)


def test_queued_goals_are_followed_in_order(world: MakeWorld) -> None:
    robot = Robot(world)
    waypoints = robot.made.listen(PoseStamped, 'experience_map/waypoint')
    routes = robot.made.listen(Path, 'experience_map/route', LATCHED)
    robot.text('experience_map/name_place', '{"name":"end"}')
    robot.made.until(lambda: len(robot.node._goals._navigator.goals) == 1)
    assert robot.call('name_place').message == 'place_1'
    robot.text('experience_map/goal', '{"goals":[{"experience_id":2},{"name":"end"}]}')
    robot.until_status(status='following')
    robot.made.until(lambda: waypoints and routes)
    assert [p.pose.position.y for p in routes[-1].poses] == pytest.approx([5, 4, 3, 2])
    waypoint = waypoints[-1].pose
    assert (waypoints[-1].header.frame_id, waypoint.position.y) == ('map', pytest.approx(4.0))
    assert 2 * math.atan2(waypoint.orientation.z, waypoint.orientation.w) == pytest.approx(
        -math.pi / 2
    )
    for n in (4, 3, 2):
        robot.drive(-1.0)
        robot.arrive(n)
    status = robot.until_status(status='following', experience_id=2)
    robot.made.until(lambda: routes[-1].poses and routes[-1].poses[-1].pose.position.y > 4.9)
    assert [(task.goal, task.status) for task in status.outcomes] == [
        ('experience 2', 'succeeded')
    ]
    assert {near.id for near in status.neighbours} == {1, 3}
    assert {round(near.distance_m, 6) for near in status.neighbours} == {1.0}
    for n in (3, 4, 5):
        robot.drive(1.0)
        robot.arrive(n)
    status = robot.until_status(status='idle')
    assert [task.goal for task in status.outcomes] == ['experience 2', 'end']
    robot.made.until(lambda: not routes[-1].poses)


def test_unreachable_goal_has_reason_and_goals_are_cancelled(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.text('experience_map/goal', '{"experience_id":1}')
    robot.until_status(status='following')
    robot.text('experience_map/goal', '{"name":"nowhere","append":true}')
    status = robot.until_status(
        reason="no place is called 'nowhere'; those that have a name: none yet. Name the place "
        'while the robot is there'
    )
    assert [task.goal for task in status.queue] == ['experience 1']
    assert robot.call('cancel_goal').message == '1 goal cancelled'
    status = robot.until_status(status='idle')
    assert [task.status for task in status.outcomes] == ['cancelled']
    robot.text('experience_map/goal', '{"name":1}')
    robot.text('experience_map/name_place', '{"name":" "}')
    robot.text('experience_map/name_place', '{"name":"a","remove":true}')
    robot.made.reported('experience_map', refused='3', goal='none')


def test_named_places_are_listed_saved_and_loaded(world: MakeWorld, tmp_path: FilePath) -> None:
    robot = Robot(world, '-p', f'memory_folder:={tmp_path}')
    robot.drive(0.25)
    robot.made.until(lambda: robot.node._goals._stamp_ns == robot.stamp_ns)
    robot.text('experience_map/name_place', '{"name":"first"}')
    robot.text('experience_map/name_place', '{"name":"first","rename_to":"dock"}')
    robot.made.until(lambda: [g.name for g in robot.node._goals._navigator.goals] == ['dock'])
    before = robot.call('list_goals').message
    [place] = json.loads(before)['goals']
    assert (place['name'], place['y_m']) == ('dock', pytest.approx(5.25))
    assert robot.call('save').success
    robot.text('experience_map/goal', '{"experience_id":0}')
    robot.until_status(status='following')
    assert robot.call('reset').success
    assert json.loads(robot.call('list_goals').message)['goals'] == []
    assert not robot.call('name_place').success
    assert robot.call('load').success
    assert robot.call('list_goals').message == before
    robot.until_status(status='idle')


def test_loaded_map_ignores_behaviours_of_its_time(world: MakeWorld) -> None:
    robot = Robot(world)
    stage = robot.node._stage
    before = encode(BehaviourReport.of(robot.stamp_ns, 'left_wall'))
    robot.text('goal_follower/behaviour', before)
    robot.made.until(lambda: stage.behaviour == 'left_wall')
    robot.node.operations.replace_memory(robot.node.host.live.state_of(robot.node.SECTION))
    assert stage.behaviour == ''
    robot.drive(1.0)
    now = encode(BehaviourReport.of(robot.stamp_ns, 'centreline'))
    robot.text('goal_follower/behaviour', now)
    robot.made.until(lambda: stage.behaviour == 'centreline')


def test_map_with_unusable_goals_changes_nothing(world: MakeWorld) -> None:
    robot = Robot(world)
    state = robot.node.host.live.state_of(robot.node.SECTION)
    state['goals']['queue'] = [['unknown']]
    with pytest.raises(ValueError):
        robot.node.operations.replace_memory(state)
    assert robot.node._goals._map is robot.node._core
    robot.drive(1.0)
    robot.arrive(6)


def test_temporal_map_is_answered_and_published(world: MakeWorld) -> None:
    robot = Robot(world)
    clouds = robot.made.listen(PointCloud2, 'experience_map/times')
    values = json.loads(robot.call('temporal_map').message)
    assert values['arrival_s'] == pytest.approx([5.0, 4.0, 3.0, 2.0, 1.0, 0.0])
    robot.made.until(lambda: clouds)
    cloud = clouds[-1]
    assert [field.name for field in cloud.fields] == ['x', 'y', 'z', 'time']
    points = np.frombuffer(bytes(cloud.data), '<f4').reshape(-1, 4)
    assert points[:, 1] == pytest.approx(np.arange(6.0), abs=1e-6)
    assert points[:, 3] == pytest.approx(np.arange(6.0)[::-1])


def test_reported_behaviour_labels_links_created_meanwhile(world: MakeWorld) -> None:
    robot = Robot(world)
    for n, behaviour in ((6, 'left_wall'), (7, 'centreline'), (8, ''), (9, '')):
        if behaviour:
            report = BehaviourReport.of(robot.stamp_ns + S // 2, behaviour)
            robot.text('goal_follower/behaviour', encode(report))
            robot.made.until(lambda: robot.node.host.pipeline._commands)
        robot.drive(1.0)
        robot.arrive(n)
    behaviours = {link.target_id: link.behaviour for link in robot.node._core.links()}
    assert [behaviours[n] for n in (5, 6, 7)] == ['', 'left_wall', 'centreline']
    assert [behaviours[n] for n in (8, 9)] == ['centreline', '']  # after 1.5 s and 2.5 s


def test_blocked_attempts_unlearn_links_and_the_route(world: MakeWorld) -> None:
    robot = Robot(world)
    robot.text('experience_map/goal', '{"experience_id":0}')
    robot.until_status(status='following')
    before = robot.node._core.link_count
    for _ in range(50):
        robot.drive(0.0, 0.1)
        report = BehaviourReport.of(robot.stamp_ns, 'centreline', True, ahead_rad=-math.pi / 2)
        robot.text('goal_follower/behaviour', encode(report))
    robot.drive(0.0)
    status = robot.until_status(status='lost')
    assert status.explore
    robot.made.until(lambda: robot.node._core.link_count < before)
    robot.text('goal_follower/behaviour', '{"behaviour":"left_wall"}')
    robot.made.reported('experience_map', refused='1')
