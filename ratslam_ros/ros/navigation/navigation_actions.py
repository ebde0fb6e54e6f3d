# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Actions of Nav2 that send the robot to goals: ``navigate_to_pose`` and others.

The goals are passed on to the experience map, which plans the routes, and its status is the
source of feedback and results.
"""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration

from ratslam_ros.errors import UnreachableGoal
from ratslam_ros.messages.goal_progress import GoalProgress, refusal
from ratslam_ros.messages.goals import GoalRequest, GoalStatus
from ratslam_ros.ros.plain_node import PlainNode
from ratslam_ros.ros.qos import GOAL

FEEDBACK_PERIOD_S = 0.2

Poses = Callable[[Any], list[PoseStamped]]
"""Returns the poses of a goal."""


def offer_actions(node: PlainNode) -> NavigationActions | None:
    """Serve the actions, if this is ROS with nav2_msgs; otherwise log that they are not served."""
    try:
        from nav2_msgs.action import NavigateThroughPoses, NavigateToPose

        return NavigationActions(node, {
            'navigate_to_pose': (NavigateToPose, lambda goal: [goal.pose]),
            'navigate_through_poses': (NavigateThroughPoses, lambda goal: goal.poses),
        })
    except ImportError:
        node.get_logger().info(
            'the actions navigate_to_pose and navigate_through_poses are not served: they need '
            'ROS 2 with nav2_msgs; the topics goal_pose and experience_map/goal take goals'
        )
        return None


class NavigationActions:
    """Serves the actions; a newer goal of either one replaces the current one."""

    def __init__(self, node: PlainNode, kinds: Mapping[str, tuple[Any, Poses]]) -> None:
        """Create the action servers.

        Args:
            node: the GoalFollowerNode, which drives and has the servers.
            kinds: type and poses of the goal, by name of the action.

        Raises:
            ImportError: this client library has no actions.
        """
        from rclpy.action import ActionServer, CancelResponse, GoalResponse

        self._node = node
        self._responses, self._cancel_accepted = GoalResponse, CancelResponse.ACCEPT
        self._goals = node.create_payload_publisher(GoalRequest, GOAL)
        self._current: _Goal | None = None
        self._servers = [
            ActionServer(
                node, kind, name, execute_callback=_not_executed,
                goal_callback=partial(self._judge, name, poses),
                handle_accepted_callback=partial(self._accept, name, kind, poses),
                cancel_callback=self._cancel,
            )
            for name, (kind, poses) in kinds.items()
        ]
        node.create_timer(FEEDBACK_PERIOD_S, self._publish_feedback, clock=node.steady)

    def close(self) -> None:
        """Cancel the current goal, and end the servers; further calls do nothing."""
        if self._current is not None:
            self._goals.publish(GoalRequest(cancel=self._current.progress.request))
            self._current = None
        while self._servers:
            self._servers.pop().destroy()

    def on_status(self, status: GoalStatus) -> None:
        """Take a status of the experience map."""
        if self._current is not None:
            self._current.progress.on_status(status)
            self._end_if_done()

    def _judge(self, name: str, poses: Poses, goal: Any) -> Any:
        reason = self._node.refusal()
        try:
            reason = reason or refusal(self._places(poses(goal)), goal.behavior_tree)
        except UnreachableGoal as error:
            reason = str(error)
        if not reason:
            return self._responses.ACCEPT
        self._node.get_logger().warning(f'a goal of {name} was refused: {reason}')
        return self._responses.REJECT

    def _accept(self, name: str, kind: Any, poses: Poses, handle: Any) -> None:
        if self._current is not None:
            self._current.progress.replace()
            self._end_if_done()
        places = self._places(poses(handle.request))
        progress = GoalProgress(f'{name} {uuid.uuid4().hex}', places, time.monotonic())
        self._current = _Goal(handle, kind, progress)
        self._goals.publish(GoalRequest.of(places, progress.request))
        # The handle is executed when the outcome is known: rclpy repeats a coroutine that waits at
        # every step of its executor, which would use a whole core.

    def _places(self, poses: list[PoseStamped]) -> list[tuple[float, float]]:
        places = [self._node.goal_on_map(pose) for pose in poses]
        return [(place.x_m, place.y_m) for place in places]

    def _cancel(self, handle: Any) -> Any:
        current = self._current
        if current is not None and current.handle.goal_id == handle.goal_id:
            current.progress.is_cancelled = True
            self._goals.publish(GoalRequest(cancel=current.progress.request))
        return self._cancel_accepted

    def _publish_feedback(self) -> None:
        if self._current is None:
            return
        progress = self._current.progress
        progress.check(time.monotonic())
        if self._end_if_done():
            return
        node = self._node
        left = progress.estimate(
            node.route, node.pose.x_m, node.pose.y_m, node.section.speed_mps
        )
        feedback = self._current.kind.Feedback()
        if node.stamped_pose is not None:
            feedback.current_pose = node.stamped_pose
        driven_s = time.monotonic() - progress.started_s
        feedback.navigation_time = Duration(seconds=driven_s).to_msg()
        feedback.estimated_time_remaining = Duration(seconds=left.time_s).to_msg()
        feedback.distance_remaining = left.distance_m
        feedback.number_of_recoveries = min(progress.recoveries, 32767)  # int16
        if hasattr(feedback, 'number_of_poses_remaining'):
            feedback.number_of_poses_remaining = left.goals
        self._current.handle.publish_feedback(feedback)

    def _end_if_done(self) -> bool:
        """End the current goal if its outcome is known; return whether it is."""
        current = self._current
        if current is None or current.progress.outcome is None:
            return False
        self._current = None
        if current.progress.outcome.kind != 'succeeded':  # cancel further goals of the request
            self._goals.publish(GoalRequest(cancel=current.progress.request))
        current.handle.execute(partial(self._finish, current))
        return True

    def _finish(self, goal: _Goal, handle: Any) -> Any:
        """Set the final state of a goal; return its result."""
        outcome = goal.progress.outcome
        assert outcome is not None
        if outcome.kind == 'succeeded':
            handle.succeed()
        elif outcome.kind == 'cancelled' or handle.is_cancel_requested:
            handle.canceled()
        else:
            self._node.get_logger().warning(f'an action has ended: {outcome.text}')
            handle.abort()
        result = goal.kind.Result(error_code=outcome.code)
        if hasattr(result, 'error_msg'):  # Not in the first releases of Jazzy.
            result.error_msg = outcome.text
        return result


def _not_executed(handle: Any) -> None:
    """Take the place of a callback that every handle gets when it is executed."""


@dataclass(frozen=True)
class _Goal:
    """A goal that is being driven to: its handle, type of action and progress."""

    handle: Any
    kind: Any
    progress: GoalProgress
