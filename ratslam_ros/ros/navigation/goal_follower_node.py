# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node that drives the robot: scan, and a route or a direction -> cmd_vel, or exploration."""

from __future__ import annotations

import math
import time
from typing import Any, ClassVar

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, inverse
from ratslam_ros.core.common.saved import Saved
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config import Config
from ratslam_ros.core.driving.exploration import Exploration
from ratslam_ros.core.driving.goal_follower import GoalFollower, in_robot_frame, remaining_route
from ratslam_ros.core.driving.goal_queue import route_towards
from ratslam_ros.core.driving.steering import Command
from ratslam_ros.errors import UnusableInput
from ratslam_ros.limits import MAX_COORDINATE_M
from ratslam_ros.messages.goals import BehaviourReport, GoalStatus
from ratslam_ros.messages.mapping import Correction
from ratslam_ros.messages.pose_cells import GoalMemoryPayload
from ratslam_ros.pipeline.commands import Relocated
from ratslam_ros.pipeline.pipeline import COMMAND, Pipeline
from ratslam_ros.pipeline.stage import Reader, Stage
from ratslam_ros.ros.convert import NO_POSITIONS, planar_pose, route_points, stamp_ns
from ratslam_ros.ros.navigation.navigation_actions import offer_actions
from ratslam_ros.ros.node import RatslamNode
from ratslam_ros.ros.payloads import refusing
from ratslam_ros.ros.qos import INPUT, LATCHED, RESULT, STATE

EXPLORING_SEED = 1
"""Seed of the exploration, so that it is repeatable."""

INPUT_CHECK_PERIOD_S = 0.05
"""Period of the checks whether the inputs needed for driving have arrived."""

POSE_TIMEOUT_S = 1.0
"""Age of the pose on the map or of the direction to a goal, and of the odometry for exploring, at
which the robot is stopped."""


class SteeringStage(Saved):
    """Orders the scans by their stamps; the node observes them. It has no memory."""

    NAME: ClassVar[str] = 'goal_follower'
    WRITES: ClassVar[tuple[str, ...]] = ()

    def readers(self) -> dict[str, Reader]:
        """Return the readers."""
        return {'scan': lambda stamp_ns, scan: None}


class GoalFollowerNode(RatslamNode):
    """Drives the robot along its route, or explores if that is requested.

    With ``steer_by: goal_memory`` the route is a line in the direction of the goal memory.
    Without a task it publishes no velocities, so that another node may drive.
    """

    SECTION = 'goal_follower'
    SHARED = ('inputs',)
    TAKES = ('scan',)

    def connect(self, pipeline: Pipeline) -> None:
        """Drive by the scans, and along the routes."""
        self._velocity = self.create_publisher(Twist, 'cmd_vel', STATE)
        self._behaviour = self.create_payload_publisher(BehaviourReport, RESULT)
        self._task = 'none'
        self._tries_failed = 0
        self._reset_state()
        self._map_frame = ''
        self._add_input('odometry', {'odom': OdometryMessage}, self._on_odometry)
        receive = refusing(self._on_pose, self._refuse, 'pose')
        self.create_subscription(PoseStamped, 'experience_map/pose', receive, STATE)
        self.create_payload_subscription(Correction, self._on_correction, INPUT, 'correction')
        if self.section.explore_by != 'walls':  # the map is in another node
            self.get_logger().warning('explore_by is for simulations: this node follows walls')
        self._by_memory = self.section.steer_by == 'goal_memory'
        self._actions = None
        if self._by_memory:
            self.create_payload_subscription(
                GoalMemoryPayload, self._on_direction, STATE, 'goal_memory'
            )
        else:
            receive = refusing(self._on_route, self._refuse, 'route')
            self.create_subscription(Path, 'experience_map/route', receive, LATCHED)
            self.create_payload_subscription(GoalStatus, self._on_status, LATCHED, 'status')
            self._actions = offer_actions(self)
        self.create_timer(INPUT_CHECK_PERIOD_S, self._check_inputs, clock=self.steady)
        pipeline.observe('scan', self._drive)
        pipeline.observe(COMMAND, self._obey)

    def new_stage(self, config: Config) -> Stage:
        """Return what orders the scans."""
        return SteeringStage()

    def _obey(self, stamp_ns: int, command: object) -> None:
        if isinstance(command, Relocated):
            self._moved()

    def started_over(self) -> None:
        """Continue after the memory was emptied."""
        super().started_over()
        self._reset_state()

    def close(self) -> None:
        """Stop the robot."""
        super().close()
        if self._actions is not None:
            self._actions.close()
        self._stop_robot()

    def _reset_state(self) -> None:
        rng = np.random.Generator(np.random.PCG64(EXPLORING_SEED))
        self._exploration = Exploration(self.section, rng)
        self.pose = self._odom_pose = Pose(0.0, 0.0, 0.0)
        self._scan_s = self._pose_s = self._odom_s = self._direction_s = -math.inf
        self.route, self._route_ns = NO_POSITIONS, 0
        self._explore_requested, self._wall = False, ''
        self.stamped_pose: PoseStamped | None = None
        self._has_map = self._is_localised = False
        self._moved()

    def _moved(self) -> None:
        self._follower = GoalFollower(self.section)
        self._exploration.restart()

    # Inputs

    def _on_odometry(self, message: OdometryMessage) -> None:
        self.frames.update(message)
        pose = planar_pose(message.pose.pose)
        if not all(math.isfinite(value) for value in pose):
            self._refuse('odometry', f'its pose is not finite: {pose}')
            return
        self._odom_pose, self._odom_s = pose, time.monotonic()

    def _on_pose(self, message: PoseStamped) -> None:
        pose = planar_pose(message.pose)
        if not all(abs(value) <= MAX_COORDINATE_M for value in pose):  # NaN is not
            raise UnusableInput(f'it is {pose}; expected finite numbers')
        self.pose, self._pose_s = pose, time.monotonic()
        self.stamped_pose, self._map_frame = message, message.header.frame_id

    def _on_correction(self, correction: Correction) -> None:
        """Use a corrected pose at once: the routes on the map are corrected too."""
        after = correction.after.pose
        if all(abs(value) <= MAX_COORDINATE_M for value in after):
            self.pose = after

    def _on_route(self, message: Path) -> None:
        self.route, self._route_ns = route_points(message), stamp_ns(message.header)

    def _on_direction(self, direction: GoalMemoryPayload) -> None:
        """Follow the direction in the frame of the odometry until the next one comes."""
        self._direction_s = time.monotonic()
        is_over = direction.reached or direction.given_up != ''
        bearing_rad = None if is_over else direction.bearing_rad
        self._explore_requested = bearing_rad is None and not is_over
        self.route = NO_POSITIONS
        if bearing_rad is not None:
            self.route = in_robot_frame(inverse(self._odom_pose), route_towards(bearing_rad))

    def _on_status(self, status: GoalStatus) -> None:
        self._explore_requested, self._wall = status.explore, status.behaviour
        self._has_map, self._is_localised = True, status.localisation != 'unknown'
        has_route = status.status in ('following', 'recovering')
        # A restarted map sends no empty route: its status ends the route of the previous one.
        if not has_route and status.stamp.ns > self._route_ns:
            self.route = NO_POSITIONS
        if self._actions is not None:
            self._actions.on_status(status)

    # Goals of actions

    def goal_on_map(self, message: PoseStamped) -> Pose:
        """Return a goal on the map; raise UnreachableGoal if its frame is unknown."""
        here = self.pose if self._is_localised and self.stamped_pose is not None else None
        return self.frames.pose_on_map(message, self._map_frame, here, self._odom_pose)

    def refusal(self) -> str:
        """Return why the robot cannot drive to goals now, or an empty string."""
        if self._is_halted:
            return f'goal_follower is {"paused" if self._is_active else "not active"}'
        if not self._has_map or self.stamped_pose is None:
            missing = 'pose' if self._has_map else 'status'
            return f'no experience_map/{missing} has arrived: is experience_map running?'
        return ''

    # Driving

    def _drive(self, stamp_ns: int, scan: Scan) -> None:
        self._scan_s = time.monotonic()
        self._choose_task()
        if self._task == 'none' or self._missing_input():
            return  # _check_inputs stops the robot
        with self.diagnostics.times('steer'):
            command = self._steer(scan)
        self._publish_velocity(command.speed_mps, command.turn_rate_radps)
        self._publish_behaviour(stamp_ns, command)

    def _choose_task(self) -> None:
        task = 'none'
        if not self._is_halted:
            if len(self.route):
                task = 'following'
            elif self._explore_requested or self.section.explore:
                task = 'exploring'
        if task != self._task:
            if task == 'none':
                self._stop_robot()
            self._moved()  # another node may have moved the robot
            self._task = task

    def _steer(self, scan: Scan) -> Command:
        if self._task == 'exploring':
            return self._exploration.command(scan, self._odom_pose)
        pose = self._odom_pose if self._by_memory else self.pose
        self.route = remaining_route(self.route, pose.x_m, pose.y_m)
        return self._follower.command(scan, in_robot_frame(pose, self.route), self._wall)

    def _publish_behaviour(self, stamp_ns: int, command: Command) -> None:
        self._tries_failed += command.failed
        ahead_rad = wrap(self.pose.heading_rad + command.ahead_rad)
        self._behaviour.publish(
            BehaviourReport.of(stamp_ns, command.behaviour, command.failed, ahead_rad)
        )

    def _publish_velocity(self, speed_mps: float, turn_rate_radps: float) -> None:
        twist = Twist()
        twist.linear.x, twist.angular.z = float(speed_mps), float(turn_rate_radps)
        self._velocity.publish(twist)

    def _stop_robot(self) -> None:
        self._publish_velocity(0.0, 0.0)

    # Safety

    def _check_inputs(self) -> None:
        """Stop the robot at every check while it has a task but an input is missing."""
        self._choose_task()
        missing = self._missing_input() if self._task != 'none' else ''
        if not missing:
            self.diagnostics.missing.pop('steering', None)
            return
        self._stop_robot()
        self.diagnostics.lacks('steering', f'the robot is stopped: {missing}')

    def _missing_input(self) -> str:
        """Return which input must arrive before the robot may move, or an empty string."""
        now_s = time.monotonic()
        if now_s - self._scan_s > self.section.scan_timeout_s:
            return 'no scan arrives'
        if (self._task == 'exploring' or self._by_memory) and (
            now_s - self._odom_s > POSE_TIMEOUT_S
        ):
            return 'no odometry arrives'
        if self._task == 'following' or self._explore_requested:
            if self._by_memory and now_s - self._direction_s > POSE_TIMEOUT_S:
                return f'no {GoalMemoryPayload.TOPIC} arrives'
            if not self._by_memory and now_s - self._pose_s > POSE_TIMEOUT_S:
                return 'no experience_map/pose arrives'
        return ''

    def _on_pause(self, is_paused: bool) -> str:
        text = super()._on_pause(is_paused)
        if is_paused:
            self._stop_robot()
        return text

    def _on_reset(self) -> str:
        text = super()._on_reset()
        self._stop_robot()
        return text

    def _diagnostic_values(self) -> dict[str, Any]:
        return {'task': self._task, 'tries_failed': self._tries_failed}
