# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node that has Nav2 drive the robot: experience_map/route -> action follow_path."""

from __future__ import annotations

import math
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config.nav2 import RouteToNav2Parameters
from ratslam_ros.core.driving.path_requests import PathRequests
from ratslam_ros.errors import UnusableInput
from ratslam_ros.limits import MAX_COORDINATE_M
from ratslam_ros.messages.goals import BehaviourReport, GoalStatus
from ratslam_ros.ros.convert import planar_pose, route_points, stamp_ns
from ratslam_ros.ros.payloads import refusing
from ratslam_ros.ros.plain_node import PlainNode
from ratslam_ros.ros.qos import LATCHED, RESULT, STATE

BLOCKED = {104: 'patience exceeded', 105: 'failed to make progress', 106: 'no valid control'}
"""Error codes of FollowPath that report an obstacle; all others are faults of the setup."""

BEHAVIOUR = 'nav2'
"""Behaviour that the reports of blocked attempts name."""


class RouteToNav2Node(PlainNode):
    """Sends each new route to the controller server of Nav2, and reports blocked attempts."""

    SECTION = 'route_to_nav2'
    PARAMETERS = RouteToNav2Parameters

    def __init__(self) -> None:
        try:
            from action_msgs.msg import GoalStatus as ActionStatus
            from nav2_msgs.action import FollowPath
            from rclpy.action import ActionClient
        except ImportError as error:
            raise UnusableInput(
                f'route_to_nav2 needs ROS 2 with nav2_msgs ({error}): '
                'sudo apt install ros-jazzy-navigation2'
            ) from None
        super().__init__()
        self._type, self._statuses = FollowPath, ActionStatus
        self._client = ActionClient(self, FollowPath, 'follow_path')
        self._requests = PathRequests()
        self._pose: Pose | None = None
        self._stamp_ns = 0
        self._number = 0
        self._handle: Any = None
        self._counts = {'paths_sent': 0, 'blocked': 0, 'failed': 0}
        self._distance_m = math.nan
        self._is_lost = False
        self._behaviour = self.create_payload_publisher(BehaviourReport, RESULT)
        self.create_subscription(PoseStamped, 'experience_map/pose', self._on_pose, STATE)
        receive = refusing(self._on_route, self._refuse, 'route')
        self.create_subscription(Path, 'experience_map/route', receive, LATCHED)
        self.create_payload_subscription(GoalStatus, self._on_status, LATCHED, 'status')

    def close(self) -> None:
        """Have Nav2 stop the robot."""
        self._cancel()
        self._client.destroy()

    # Inputs

    def _on_pose(self, message: PoseStamped) -> None:
        pose = planar_pose(message.pose)
        if all(abs(value) <= MAX_COORDINATE_M for value in pose):  # NaN is not
            self._pose, self._stamp_ns = pose, stamp_ns(message.header)

    def _on_status(self, status: GoalStatus) -> None:
        is_lost = status.explore
        if is_lost and not self._is_lost:
            self.diagnostics.warn(
                'the route is lost: move the robot until it recognises a place; Nav2 does not '
                'explore'
            )
        self._is_lost = is_lost

    def _on_route(self, route: Path) -> None:
        action = self._requests.on_route(route_points(route))
        if action == 'cancel':
            self._cancel()
        elif action == 'send':
            self._send(route)

    # Nav2

    def _send(self, route: Path) -> None:
        if not self._client.server_is_ready():
            self._requests.is_driving = False  # The next route is sent again.
            self.diagnostics.lacks(
                'follow_path',
                'the action follow_path is not served: is the controller server of Nav2 active?',
            )
            return
        self.diagnostics.missing.pop('follow_path', None)
        for stamped in (route, *route.poses):  # The stamps of the route are times of arrival.
            stamped.header.stamp = Time()
        goal = self._type.Goal(path=route, controller_id=self._p.controller_id)
        goal.goal_checker_id = self._p.goal_checker_id
        goal.progress_checker_id = self._p.progress_checker_id
        self._number += 1
        self._counts['paths_sent'] += 1
        number = self._number
        future = self._client.send_goal_async(goal, feedback_callback=self._on_feedback)
        future.add_done_callback(lambda answer: self._on_answer(number, answer.result()))

    def _on_feedback(self, message: Any) -> None:
        self._distance_m = message.feedback.distance_to_goal

    def _on_answer(self, number: int, handle: Any) -> None:
        if not handle.accepted:
            if number == self._number:
                self._requests.is_driving = False
                self._fail('Nav2 has refused a path; its log has the reason')
            return
        if number != self._number or not self._requests.is_driving:
            handle.cancel_goal_async()  # Cancelled or replaced before the answer.
            return
        self._handle = handle
        result = handle.get_result_async()
        result.add_done_callback(lambda answer: self._on_result(number, answer.result()))

    def _on_result(self, number: int, answer: Any) -> None:
        if number != self._number:
            return  # of a path that a newer one has replaced
        self._handle, self._requests.is_driving = None, False
        if answer.status != self._statuses.STATUS_ABORTED:
            return
        code = answer.result.error_code
        text = getattr(answer.result, 'error_msg', '')
        if code in BLOCKED:
            self._report_blocked(BLOCKED[code])
        else:
            self._fail(f'Nav2 has ended a path with error {code}{": " if text else ""}{text}')

    def _report_blocked(self, reason: str) -> None:
        """Report a blocked attempt: the experience map then unlearns the link and replans."""
        self._counts['blocked'] += 1
        self.diagnostics.warn(f'Nav2 cannot follow the route ({reason}): the way is blocked')
        if self._pose is None:
            return
        ahead_rad = self._requests.blocked_direction_rad(self._pose)
        self._behaviour.publish(BehaviourReport.of(self._stamp_ns, BEHAVIOUR, True, ahead_rad))

    def _fail(self, text: str) -> None:
        self._counts['failed'] += 1
        self.diagnostics.warn(f'{text}; the next route is sent again')

    def _cancel(self) -> None:
        self._requests.is_driving = False
        if self._handle is not None:
            self._handle.cancel_goal_async()
            self._handle = None

    def _publish_diagnostics(self) -> None:
        is_driving = self._requests.is_driving
        values: dict[str, Any] = {**self._counts, 'lost': self._is_lost}
        if is_driving:
            values['distance_to_goal_m'] = round(self._distance_m, 2)
        self.diagnostics.publish(values, 'driving' if is_driving else 'waiting for a route')
