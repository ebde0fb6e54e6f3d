# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goals in the node of the experience map: requests, guidance and named places."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from msgspec import UNSET
from nav_msgs.msg import Path
from nav_msgs.srv import GetPlan
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Goal, Position, Target
from ratslam_ros.core.navigation.navigator import Navigator
from ratslam_ros.core.navigation.route_following import Guidance
from ratslam_ros.errors import UnreachableGoal
from ratslam_ros.messages.goals import (
    ArrivalTimes,
    GoalRequest,
    GoalStatus,
    NamedPlaces,
    NameRequest,
)
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.pipeline.commands import NamePlace
from ratslam_ros.pipeline.live_stages import LiveExperienceMap
from ratslam_ros.ros.convert import NO_POSITIONS, header_of, path_of, point_cloud, pose_message
from ratslam_ros.ros.node import RatslamNode
from ratslam_ros.ros.qos import GOAL, LATCHED, STATE, VIEW

UPDATE_PERIOD_NS = 50_000_000
"""Shortest time between two updates of the guidance, by the stamps of the odometry."""

REPUBLISH_PERIOD_NS = 1_000_000_000
"""Period at which an unchanged route and status are sent again, as the poses of the map change."""

TIMES_PERIOD_S = 1.0
"""Shortest time between two messages with the temporal map."""


class GoalNavigation:
    """Receives goals and names of places, and publishes the guidance to the goals.

    The node passes the robot's pose by ``locate`` and calls ``update`` when the map may have
    changed.
    """

    def __init__(self, node: RatslamNode, stage: LiveExperienceMap) -> None:
        """Create the topics and services.

        Args:
            node: the node of the map.
            stage: its stage.
        """
        self._node, self._stage = node, stage
        self._diagnostics = node.diagnostics
        self._route = node.create_publisher(Path, 'experience_map/route', LATCHED)
        self._waypoint = node.create_publisher(PoseStamped, 'experience_map/waypoint', STATE)
        self._status = node.create_payload_publisher(GoalStatus, LATCHED)
        self._times = node.create_publisher(PointCloud2, 'experience_map/times', VIEW)
        self._has_route = False
        self.reason = ''
        """Why the last requested goal has no route, else empty."""
        self._refused = ''
        """Name of the request that was refused for this reason, '' for none."""
        self._next_times_s = 0.0
        node.create_subscription(PoseStamped, 'goal_pose', self._on_goal_pose, GOAL)
        node.create_payload_subscription(GoalRequest, self._on_goal, GOAL, 'goal')
        node.create_payload_subscription(NameRequest, self._on_name, GOAL, 'name_place')
        node.offer('experience_map/name_place', self._on_name_place)
        node.offer('experience_map/list_goals', self._on_list)
        node.offer('experience_map/cancel_goal', self._on_cancel)
        node.offer('experience_map/temporal_map', self._on_temporal_map)
        node.create_service(GetPlan, 'experience_map/recall_goal', self._on_recall_goal)
        self._restart()

    @property
    def _map(self) -> ExperienceMap:
        return self._stage.core

    @property
    def _navigator(self) -> Navigator:
        navigator = self._stage.navigator
        navigator.planner.parameters = self._node.config.goal_recall  # may change at run time
        return navigator

    def use_other_map(self) -> None:
        """End the route: the map was replaced, and the goals on it."""
        self._restart()
        self._end_route()

    def _restart(self) -> None:
        self._pose: Pose | None = None
        self._odom_pose = Pose(0.0, 0.0, 0.0)
        self._stamp_ns = 0
        self._logged_count = 0
        self._times_key: tuple[Any, ...] = ()
        self._route_key: tuple[Any, ...] = ()
        self._status_key: tuple[Any, ...] = ()

    def drop_goals(self) -> None:
        """Drop the goals of an earlier session: the robot must not start to drive by itself."""
        self._cancel('the map was loaded')

    def locate(self, stamp_ns: int, pose: Pose, odom_pose: Pose) -> None:
        """Set the robot's pose and update the guidance if it is due.

        Args:
            stamp_ns: stamp of the odometry.
            pose: pose on the map.
            odom_pose: pose in the frame of the odometry.
        """
        self._stamp_ns, self._pose, self._odom_pose = stamp_ns, pose, odom_pose
        if stamp_ns < self._navigator.stamp_ns:
            self._cancel('the stamps have jumped back')
        if not 0 <= stamp_ns - self._navigator.stamp_ns < UPDATE_PERIOD_NS:
            self.update()

    def update(self) -> None:
        """Compute the guidance, and publish what has changed."""
        with self._diagnostics.times('goals'):
            guidance = self._navigator.update(self._stamp_ns, self._pose)
        self._publish_route(guidance)
        self._log_outcomes()
        self._publish_status()
        self._publish_times()

    def _publish_route(self, guidance: Guidance) -> None:
        """Publish the waypoint, and the route if it has changed; end a route that is lost."""
        if guidance.waypoint is None:
            self._end_route()
            return
        header = header_of(self._stamp_ns, self._map.frame_id)
        self._waypoint.publish(PoseStamped(header=header, pose=pose_message(guidance.waypoint)))
        period = self._stamp_ns // REPUBLISH_PERIOD_NS
        key = guidance.status, guidance.replanned, self._map.current_id, guidance.goal, period
        if key != self._route_key:
            self._route_key, self._has_route = key, True
            self._route.publish(self._path(guidance.positions_m, guidance.arrival_s.tolist()))

    def _end_route(self) -> None:
        """Publish an empty route if the last one was not empty."""
        self._route_key = ()
        if self._has_route:
            self._has_route = False
            self._route.publish(self._path())

    def _path(
        self, positions_m: NDArray[np.float64] = NO_POSITIONS, arrival_s: Sequence[float] = ()
    ) -> Path:
        return path_of(positions_m, arrival_s, self._stamp_ns, self._map.frame_id)

    def _publish_status(self) -> None:
        """Publish the status if it has changed, and periodically while there is a goal."""
        guidance, navigator, graph = self._navigator.guidance, self._navigator, self._map
        key = (
            guidance.status, guidance.replanned, guidance.behaviour, graph.current_id,
            navigator.ended, self.reason, self._refused, len(navigator.queue), graph.localisation,
            guidance.reason,
            self._stamp_ns // REPUBLISH_PERIOD_NS if navigator.queue else 0,
        )
        if key != self._status_key:
            self._status_key = key
            self._status.publish(GoalStatus.of(
                self._stamp_ns, graph, guidance, navigator.queue, navigator.outcomes, self.reason,
                self._refused,
            ))

    def _log_outcomes(self) -> None:
        navigator = self._navigator
        new = min(navigator.ended - self._logged_count, len(navigator.outcomes))
        self._logged_count = navigator.ended
        for task in list(navigator.outcomes)[len(navigator.outcomes) - new :]:
            reason = f': {task.reason}' if task.reason else ''
            self._node.get_logger().info(f'goal {task.asked} {task.status}{reason}')

    def _publish_times(self) -> None:
        """Publish the temporal map if it has subscribers and has changed."""
        if self._times.get_subscription_count() == 0 or self._map.current_id < 0:
            self._times_key = ()
            return
        key = self._map.current_id, self._map.link_table.version, len(self._map)
        if key == self._times_key or time.monotonic() < self._next_times_s:
            return
        self._times_key, self._next_times_s = key, time.monotonic() + TIMES_PERIOD_S
        times = self._navigator.planner.temporal_map()
        is_reachable = np.isfinite(times.arrival_s)
        points = np.zeros((np.count_nonzero(is_reachable), 4))
        points[:, :2] = self._map.poses[is_reachable, :2]
        points[:, 3] = times.arrival_s[is_reachable]
        self._times.publish(point_cloud(self._stamp_ns, self._map.frame_id, points, 'time'))

    def diagnostic_values(self) -> dict[str, Any]:
        """Return the values for the diagnostics."""
        queue = self._navigator.queue
        return {
            'goal': queue[0].asked if queue else 'none',
            'goals_waiting': max(len(queue) - 1, 0),
            'goal_status': self._navigator.guidance.status,
            'no_route_because': self.reason,
        }

    # Requests

    def _on_goal_pose(self, message: PoseStamped) -> None:
        try:
            place = self._on_map(message)
        except UnreachableGoal as error:
            self._refuse_goal(error, append=False)
            return
        self._go_to(Position(place.x_m, place.y_m))

    def _on_goal(self, request: GoalRequest) -> None:
        if request.cancel:
            self._cancel('on request', request.cancel)
            self.update()
            return
        timeout_s = None if request.timeout_s is UNSET else request.timeout_s
        self._go_to(
            *request.targets, append=request.append, timeout_s=timeout_s, request=request.request
        )

    def _go_to(
        self, *targets: Target, append: bool = False, timeout_s: float | None = None,
        request: str = '',
    ) -> None:
        try:
            self._navigator.go_to(*targets, append=append, timeout_s=timeout_s, request=request)
        except UnreachableGoal as error:
            self._refuse_goal(error, append, request)
            return
        self.reason = self._refused = ''
        self.update()

    def _refuse_goal(self, error: UnreachableGoal, append: bool, request: str = '') -> None:
        """Report an unreachable goal; unless it was appended, cancel the earlier goals too."""
        self.reason, self._refused = str(error), request
        self._diagnostics.warn(f'no route: {error}')
        if not append:
            self._cancel('another goal was requested, which cannot be reached')
        self.update()

    def _cancel(self, reason: str, request: str | None = None) -> int:
        """Cancel the goals of a request, or all; return how many."""
        number = self._navigator.cancel(reason, request=request)
        if number > 0 and not self._navigator.queue:
            self._end_route()
        return number

    def _on_name(self, request: NameRequest) -> None:
        if request.remove:
            self._name(NamePlace(request.name, remove=True))
            text = f'the name {request.name} is removed'
        elif request.rename_to:
            self._name(NamePlace(request.name, request.rename_to))
            text = f'{request.name} is renamed to {request.rename_to}'
        else:
            text = f'this place is named {self._name_place(request.name).name}'
        self._node.get_logger().info(text)

    def _name(self, command: NamePlace) -> Goal:
        """Carry out a command for a named place, and return the place."""
        self._node.host.command(command)
        named = self._stage.named
        assert named is not None  # nothing that this host takes waits for an answer
        if isinstance(named, UnreachableGoal):
            raise named
        return named

    def _name_place(self, name: str) -> Goal:
        offset = None
        if self._pose is not None and self._map.current_id >= 0:
            # The pose includes the motion of messages that the map has not processed yet.
            offset = composed(inverse(self._map.pose_of(self._map.current_id)), self._pose)
        return self._name(NamePlace(name, offset=offset))

    def _on_name_place(self) -> str:
        name = self._name_place('').name
        self._node.get_logger().info(f'this place is named {name}')
        return name

    def _on_list(self) -> str:
        return encode(NamedPlaces.of(self._map, self._navigator.goals))

    def _on_cancel(self) -> str:
        number = self._cancel('on request')
        self.update()
        return f'{number} goal{"s" * (number != 1)} cancelled'

    def _on_temporal_map(self) -> str:
        return encode(ArrivalTimes.of(self._navigator.planner.temporal_map()))

    def _on_recall_goal(self, request: Any, response: Any) -> Any:
        planner, start, reason = self._navigator.planner, None, ''
        response.plan = self._path()
        try:
            if request.start.header.frame_id:
                place = self._on_map(request.start)
                start = planner.nearest(place.x_m, place.y_m)
            goal = self._on_map(request.goal)
            tolerance_m = float(request.tolerance)
            if not 0.0 <= tolerance_m < math.inf:
                raise UnreachableGoal(f'the tolerance is {tolerance_m}; expected 0 or more m')
            route = planner.route_to_place(goal.x_m, goal.y_m, tolerance_m, start)
            positions_m = self._map.poses[list(route.experience_ids), :2]
            response.plan = self._path(positions_m, route.arrival_s)
        except UnreachableGoal as error:
            reason = str(error)
            self._diagnostics.warn(f'no route: {reason}')
        self.reason, self._refused = reason, ''
        self._publish_status()  # also if no odometry arrives: nav_msgs has no field for the reason
        return response

    # Frames

    def _on_map(self, message: PoseStamped) -> Pose:
        """Transform a pose to the map's frame; raise UnreachableGoal if that is impossible."""
        here = None if self._map.localisation == 'unknown' else self._pose
        return self._node.frames.pose_on_map(message, self._map.frame_id, here, self._odom_pose)
