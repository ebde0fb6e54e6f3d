# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Actions of Nav2 served by goal_follower, with a real action client."""

from __future__ import annotations

import json
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from helpers import START_NS
from ros_messages import MakeWorld, stamped_pose, string
from std_msgs.msg import String
from test_nodes import drive_straight, last_map

from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Goal
from ratslam_ros.core.navigation.navigator import GoalTask
from ratslam_ros.core.navigation.route_following import Guidance
from ratslam_ros.messages import goal_progress
from ratslam_ros.messages.goals import GoalStatus
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.ros.convert import path_of
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.navigation.goal_follower_node import GoalFollowerNode
from ratslam_ros.ros.navigation.route_to_nav2_node import BLOCKED
from ratslam_ros.ros.qos import GOAL, LATCHED

HAS_NAV2 = find_spec('nav2_msgs') is not None
needs_nav2 = pytest.mark.skipif(not HAS_NAV2, reason='needs ROS 2 with nav2_msgs')


class Map:
    """Stands in for the experience map: receives goals and publishes their status."""

    def __init__(self, world: MakeWorld) -> None:
        from nav2_msgs.action import NavigateThroughPoses, NavigateToPose
        from rclpy.action import ActionClient

        self.world = world(GoalFollowerNode)
        self.kinds = {'navigate_to_pose': NavigateToPose,
                      'navigate_through_poses': NavigateThroughPoses}
        self.clients = {
            name: ActionClient(self.world.tester, kind, name) for name, kind in self.kinds.items()
        }
        self.requests: list[dict[str, Any]] = []
        self.feedback: list[Any] = []
        self.world.tester.create_subscription(
            String, 'experience_map/goal', lambda m: self.requests.append(json.loads(m.data)), GOAL
        )
        for client in self.clients.values():
            self.world.until(client.server_is_ready)

    def close(self) -> None:
        for client in self.clients.values():
            client.destroy()

    def start(self) -> None:
        """Publish what an idle map publishes."""
        self.world.send('experience_map/pose', stamped_pose(0.5, 0.0))
        self.status()
        self.world.until(lambda: not self.world.nodes[0].refusal())

    def status(self, *queue: GoalTask, ended: tuple[GoalTask, ...] = (), **fields: Any) -> None:
        guidance = Guidance('following' if queue else 'idle', remaining_s=4.0)
        empty = ExperienceMap(ExperienceMapParameters())
        payload = encode(GoalStatus.of(START_NS, empty, guidance, queue, ended, **fields))
        self.world.send('experience_map/status', string(payload), LATCHED)

    def ask(self, name: str, **fields: Any) -> Any:
        """Send a goal; return its handle."""
        future = self.clients[name].send_goal_async(
            self.kinds[name].Goal(**fields),
            feedback_callback=lambda message: self.feedback.append(message.feedback),
        )
        self.world.until(future.done)
        return future.result()

    def drive_to(self, *places: tuple[float, float], name: str = '') -> tuple[Any, str]:
        """Send a goal that is accepted; return its handle and the name of its request."""
        count = len(self.requests)
        poses = [stamped_pose(*place) for place in places]
        if (name or 'navigate_to_pose') == 'navigate_to_pose':
            handle = self.ask('navigate_to_pose', pose=poses[0])
        else:
            handle = self.ask(name, poses=poses)
        assert handle.accepted
        self.world.until(lambda: any('goals' in one for one in self.requests[count:]))
        sent = next(one for one in self.requests[count:] if 'goals' in one)
        assert [(goal['x_m'], goal['y_m']) for goal in sent['goals']] == list(places)
        return handle, sent['request']

    def result(self, handle: Any) -> Any:
        future = handle.get_result_async()
        self.world.until(future.done)
        return future.result()

    def cancels(self) -> list[str]:
        return [one['cancel'] for one in self.requests if 'cancel' in one]


@pytest.fixture
def robot_map(world: MakeWorld) -> Any:
    made = Map(world)
    yield made
    made.close()


def task(number: int, status: str, request: str, reason: str = '') -> GoalTask:
    return GoalTask(number, Goal(number), f'goal{number}', status=status, reason=reason,
                    request=request)


@needs_nav2
def test_error_codes_are_those_of_nav2() -> None:
    from nav2_msgs.action import ComputePathToPose, FollowPath

    plan, follow = ComputePathToPose.Result, FollowPath.Result
    assert goal_progress.SUCCESS == plan.NONE
    assert goal_progress.UNKNOWN == plan.UNKNOWN
    assert goal_progress.NO_ROUTE == plan.NO_VALID_PATH
    assert goal_progress.NO_PROGRESS == follow.FAILED_TO_MAKE_PROGRESS
    assert set(BLOCKED) == {
        follow.PATIENCE_EXCEEDED, follow.FAILED_TO_MAKE_PROGRESS, follow.NO_VALID_CONTROL
    }


@needs_nav2
def test_goal_is_driven_to_with_feedback(robot_map: Map) -> None:
    robot_map.start()
    handle, request = robot_map.drive_to((0.5, 3.0))
    route = path_of(np.array([(0.5, 1.0), (0.5, 3.0)]), [0.0, 0.0], START_NS, 'map')
    robot_map.world.send('experience_map/route', route, LATCHED)
    robot_map.status(task(0, 'active', request))
    robot_map.world.until(
        lambda: any(one.estimated_time_remaining.sec == 4 for one in robot_map.feedback)
    )
    last = robot_map.feedback[-1]
    assert last.distance_remaining == pytest.approx(3.0)
    assert (last.current_pose.header.frame_id, last.current_pose.pose.position.x) == ('map', 0.5)
    assert last.number_of_recoveries == 0
    robot_map.status(ended=(task(0, 'succeeded', request),))
    result = robot_map.result(handle)
    assert (result.status, result.result.error_code) == (4, 0)  # STATUS_SUCCEEDED
    assert robot_map.cancels() == []


@needs_nav2
def test_poses_are_visited_in_order_and_failure_aborts(robot_map: Map) -> None:
    robot_map.start()
    handle, request = robot_map.drive_to(
        (1.0, 0.0), (2.0, 0.0), (3.0, 0.0), name='navigate_through_poses'
    )
    robot_map.status(task(1, 'active', request), task(2, 'queued', request),
                     ended=(task(0, 'succeeded', request),))
    robot_map.world.until(
        lambda: any(one.number_of_poses_remaining == 2 for one in robot_map.feedback)
    )
    robot_map.status(task(2, 'queued', request),
                     ended=(task(1, 'timed_out', request, 'not reached within 9 s'),))
    result = robot_map.result(handle)
    assert (result.status, result.result.error_code) == (6, goal_progress.NO_PROGRESS)
    assert 'not reached within 9 s' in result.result.error_msg
    robot_map.world.until(lambda: robot_map.cancels() == [request])


@needs_nav2
def test_cancel_ends_with_the_answer_of_the_map(robot_map: Map) -> None:
    robot_map.start()
    handle, request = robot_map.drive_to((1.0, 0.0))
    robot_map.status(task(0, 'active', request))
    future = handle.cancel_goal_async()
    robot_map.world.until(future.done)
    assert len(future.result().goals_canceling) == 1
    robot_map.world.until(lambda: robot_map.cancels() == [request])
    robot_map.status(ended=(task(0, 'cancelled', request),))
    assert robot_map.result(handle).status == 5  # STATUS_CANCELED


@needs_nav2
def test_newer_goal_of_either_action_replaces_the_current_one(robot_map: Map) -> None:
    robot_map.start()
    first, old = robot_map.drive_to((1.0, 0.0))
    robot_map.status(task(0, 'active', old))
    second, new = robot_map.drive_to((2.0, 0.0), name='navigate_through_poses')
    result = robot_map.result(first)
    assert result.status == 6  # STATUS_ABORTED
    assert 'replaced' in result.result.error_msg
    robot_map.status(ended=(task(0, 'cancelled', old), task(1, 'succeeded', new)))
    assert robot_map.result(second).status == 4
    # The old goal is cancelled before the new one is sent.
    kinds = [one.get('cancel', one.get('request')) for one in robot_map.requests]
    assert kinds == [old, old, new]


@needs_nav2
def test_goal_without_route_is_aborted_with_reason(robot_map: Map) -> None:
    robot_map.start()
    handle, request = robot_map.drive_to((50.0, 0.0))
    robot_map.status(reason='the nearest place is 45 m away', refused=request)
    result = robot_map.result(handle)
    assert (result.status, result.result.error_code) == (6, goal_progress.NO_ROUTE)
    assert result.result.error_msg == 'the nearest place is 45 m away'


@needs_nav2
def test_unusable_goals_are_refused(robot_map: Map) -> None:
    pose = stamped_pose(1.0, 0.0)
    assert not robot_map.ask('navigate_to_pose', pose=pose).accepted  # no map yet
    robot_map.start()
    far = stamped_pose(1.0, 0.0, 'mars')
    assert not robot_map.ask('navigate_to_pose', pose=far).accepted
    assert not robot_map.ask('navigate_through_poses', poses=[]).accepted
    assert not robot_map.ask('navigate_to_pose', pose=pose, behavior_tree='a.xml').accepted
    assert robot_map.ask('navigate_to_pose', pose=pose).accepted
    ahead = stamped_pose(1.0, 0.0, 'base_link')
    assert robot_map.ask('navigate_to_pose', pose=ahead).accepted
    on_map = [{'x_m': 1.5, 'y_m': 0.0}]  # the robot is at 0.5
    robot_map.world.until(lambda: any(one.get('goals') == on_map for one in robot_map.requests))


def test_without_nav2_one_line_names_the_topics(world: MakeWorld, capfd: Any) -> None:
    if HAS_NAV2:
        pytest.skip('nav2_msgs is installed')
    made = world(GoalFollowerNode)
    out, err = capfd.readouterr()
    assert (out + err).count('are not served') == 1
    assert not any('navigate' in name for name, _ in made.nodes[0].get_topic_names_and_types())


@needs_nav2
def test_real_map_drives_refuses_and_cancels_goals(world: MakeWorld) -> None:
    from nav2_msgs.action import NavigateToPose
    from rclpy.action import ActionClient

    made = world(ExperienceMapNode, GoalFollowerNode, arguments=('-p', 'map_period_s:=0.05'))
    received = made.listen(String, 'experience_map/map', LATCHED)
    client = ActionClient(made.tester, NavigateToPose, 'navigate_to_pose')
    drive_straight(made)
    last_map(made, received, 5)
    made.until(lambda: not made.nodes[1].refusal())
    made.until(client.server_is_ready)
    feedback: list[Any] = []

    def ask(x: float, y: float) -> Any:
        future = client.send_goal_async(
            NavigateToPose.Goal(pose=stamped_pose(x, y)),
            feedback_callback=lambda message: feedback.append(message.feedback),
        )
        made.until(future.done)
        assert future.result().accepted
        return future.result()

    def result(handle: Any) -> Any:
        future = handle.get_result_async()
        made.until(future.done)
        return future.result()

    far = result(ask(50.0, 1.0))
    assert (far.status, far.result.error_code) == (6, goal_progress.NO_ROUTE)
    assert 'away' in far.result.error_msg
    handle = ask(0.0, 1.0)
    # The robot is at (0, 4), and drove 1 m per second.
    made.until(lambda: any(one.estimated_time_remaining.sec == 3 for one in feedback))
    made.until(lambda: feedback[-1].distance_remaining == pytest.approx(3.0))
    made.until(handle.cancel_goal_async().done)
    assert result(handle).status == 5
    here = result(ask(0.0, 4.0))
    assert (here.status, here.result.error_code) == (4, 0)
    client.destroy()
