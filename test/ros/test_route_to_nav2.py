# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node that has Nav2 drive, with an action server in place of the controller server of Nav2."""

from __future__ import annotations

import math
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from helpers import START_NS
from nav_msgs.msg import Path
from ros_messages import MakeWorld, stamped_pose
from std_msgs.msg import String

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnusableInput
from ratslam_ros.messages.goals import BehaviourReport
from ratslam_ros.messages.json_schema import decode
from ratslam_ros.ros.convert import path_of
from ratslam_ros.ros.navigation.route_to_nav2_node import RouteToNav2Node
from ratslam_ros.ros.qos import LATCHED

HAS_NAV2 = find_spec('nav2_msgs') is not None
needs_nav2 = pytest.mark.skipif(not HAS_NAV2, reason='needs ROS 2 with nav2_msgs')
ROUTE = ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0))


class Controller:
    """Accepts paths, and ends them as the test asks."""

    def __init__(self, world: MakeWorld, *arguments: str) -> None:
        from nav2_msgs.action import FollowPath
        from rclpy.action import ActionServer, CancelResponse, GoalResponse

        self.world = world(RouteToNav2Node, arguments=arguments)
        self.kind = FollowPath
        self.accepts = True
        self.goals: list[Any] = []
        self.cancelled: list[Any] = []
        self.server = ActionServer(
            self.world.tester, FollowPath, 'follow_path', execute_callback=lambda handle: None,
            goal_callback=lambda goal: (
                GoalResponse.ACCEPT if self.accepts else GoalResponse.REJECT
            ),
            handle_accepted_callback=self.goals.append,
            cancel_callback=lambda handle: (
                self.cancelled.append(handle) or CancelResponse.ACCEPT  # type: ignore[func-returns-value]
            ),
        )
        self.reports = self.world.listen(String, 'goal_follower/behaviour')
        self.world.until(self.world.nodes[0]._client.server_is_ready)

    def pose(self, x: float, y: float) -> None:
        self.world.send('experience_map/pose', stamped_pose(x, y, stamp_ns=START_NS))
        self.world.until(lambda: self.world.nodes[0]._pose == Pose(x, y, 0.0))

    def route(self, *places: tuple[float, float]) -> None:
        positions = np.array(places, np.float64).reshape(-1, 2)
        path = path_of(positions, [5.0] * len(places), START_NS, 'map')
        self.world.send('experience_map/route', path, LATCHED)

    def next_goal(self, *places: tuple[float, float]) -> Any:
        """Send a route; return the handle of the path that arrives."""
        count = len(self.goals)
        self.route(*places)
        self.world.until(lambda: len(self.goals) > count)
        # The node gets the answer later than the server the goal.
        self.world.until(lambda: self.world.nodes[0]._handle is not None)
        return self.goals[-1]

    def end(self, handle: Any, action: str, code: int = 0) -> None:
        def finish(handle: Any) -> Any:
            getattr(handle, action)()
            return self.kind.Result(error_code=code)

        handle.execute(finish)
        self.world.until(lambda: not self.world.nodes[0]._requests.is_driving)


@pytest.fixture
def controller(world: MakeWorld) -> Iterator[Controller]:
    made = Controller(world, '-p', 'controller_id:=Mine')
    yield made
    made.server.destroy()


@needs_nav2
def test_route_becomes_a_path_without_stamps(controller: Controller) -> None:
    goal = controller.next_goal(*ROUTE).request
    assert (goal.controller_id, goal.goal_checker_id) == ('Mine', '')
    at = [(pose.pose.position.x, pose.pose.position.y) for pose in goal.path.poses]
    assert at == list(ROUTE)
    assert goal.path.header.frame_id == 'map'
    assert {pose.header.stamp.sec for pose in goal.path.poses} == {0}


@needs_nav2
def test_only_changed_routes_replace_the_path(controller: Controller) -> None:
    controller.next_goal(*ROUTE)
    controller.route(*ROUTE[1:])
    controller.world.spin(0.3)
    assert len(controller.goals) == 1
    controller.next_goal(*ROUTE[1:], (5.0, 2.0))
    assert len(controller.goals) == 2
    controller.end(controller.goals[-1], 'succeed')
    controller.next_goal(*ROUTE[1:], (5.0, 2.0))  # the map has not counted it as reached yet
    assert controller.reports == []


@needs_nav2
def test_empty_route_cancels_the_path(controller: Controller) -> None:
    handle = controller.next_goal(*ROUTE)
    controller.route()
    controller.world.until(lambda: controller.cancelled)
    assert controller.cancelled == [handle]


@needs_nav2
def test_blocked_path_is_reported_and_sent_again(controller: Controller) -> None:
    controller.pose(2.0, 0.5)
    handle = controller.next_goal(*ROUTE)
    controller.end(handle, 'abort', controller.kind.Result.FAILED_TO_MAKE_PROGRESS)
    controller.world.until(lambda: controller.reports)
    [report] = [decode(BehaviourReport, one.data) for one in controller.reports]
    assert report.failed
    assert report.behaviour  # The map counts no attempt without one.
    assert report.stamp.ns == START_NS
    assert report.ahead_rad == pytest.approx(math.pi / 2)
    controller.next_goal(*ROUTE)


@needs_nav2
def test_fault_of_the_setup_blames_no_way(controller: Controller) -> None:
    controller.pose(0.0, 0.0)
    handle = controller.next_goal(*ROUTE)
    controller.end(handle, 'abort', controller.kind.Result.INVALID_CONTROLLER)
    shown = controller.world.diagnostics()['route_to_nav2']
    assert (shown['failed'], shown['blocked']) == ('1', '0')
    assert '101' in shown['message']
    assert controller.reports == []


@needs_nav2
def test_refused_path_is_sent_again(controller: Controller) -> None:
    controller.accepts = False
    controller.route(*ROUTE)
    node = controller.world.nodes[0]
    controller.world.until(lambda: node._counts['failed'] == 1)
    controller.accepts = True
    controller.next_goal(*ROUTE)


@needs_nav2
def test_missing_controller_is_reported(world: MakeWorld) -> None:
    made = world(RouteToNav2Node)
    route: Path = path_of(np.array(ROUTE), [0.0] * 3, START_NS, 'map')
    made.send('experience_map/route', route, LATCHED)
    made.until(lambda: made.nodes[0].diagnostics.missing)
    assert 'follow_path' in made.diagnostics()['route_to_nav2']['message']


def test_without_nav2_the_error_names_the_package(world: MakeWorld) -> None:
    if HAS_NAV2:
        pytest.skip('nav2_msgs is installed')
    with pytest.raises(UnusableInput, match='nav2_msgs'):
        world(RouteToNav2Node)
