# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publication of the navigator's guidance: route, waypoint and status."""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.node import Node
from std_msgs.msg import String

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.navigator import Navigator
from ratslam_ros.core.navigation.route_following import Guidance
from ratslam_ros.messages.goals import GoalStatus
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.ros.convert import header_of, pose_message
from ratslam_ros.ros.navigation.paths import path_of
from ratslam_ros.ros.qos import LATCHED, STATE

REPUBLISH_PERIOD_NS = 1_000_000_000
"""Period at which an unchanged route and status are sent again, as the poses of the map change."""

NO_POSITIONS = np.empty((0, 2))


class RoutePublisher:
    """Publishes the waypoint at every update, and route and status when they change."""

    def __init__(self, node: Node) -> None:
        self._route = node.create_publisher(Path, 'experience_map/route', LATCHED)
        self._waypoint = node.create_publisher(PoseStamped, 'experience_map/waypoint', STATE)
        self._status = node.create_publisher(String, 'experience_map/status', LATCHED)
        self._has_route = False
        self.reset()

    def reset(self) -> None:
        """Send the next route and status even if they are those sent last."""
        self._route_key: tuple[Any, ...] = ()
        self._status_key: tuple[Any, ...] = ()

    def publish_route(
        self, stamp_ns: int, frame_id: str, guidance: Guidance, current_id: int
    ) -> None:
        """Publish the waypoint and the route of the guidance, or end the route if it has none.

        Args:
            stamp_ns: stamp of the last odometry.
            frame_id: the frame of the map.
            guidance: the current guidance of the navigator.
            current_id: the current experience.
        """
        if guidance.waypoint is None:
            self.end_route(stamp_ns, frame_id)
            return
        header = header_of(stamp_ns, frame_id)
        self._waypoint.publish(PoseStamped(header=header, pose=pose_message(guidance.waypoint)))
        period = stamp_ns // REPUBLISH_PERIOD_NS
        key = guidance.status, guidance.replanned, current_id, guidance.goal, period
        if key != self._route_key:
            self._route_key, self._has_route = key, True
            arrival_s = guidance.arrival_s.tolist()
            self._route.publish(path_of(guidance.positions_m, arrival_s, stamp_ns, frame_id))

    def end_route(self, stamp_ns: int, frame_id: str) -> None:
        """Publish an empty route if the last one was not empty."""
        self._route_key = ()
        if self._has_route:
            self._has_route = False
            self._route.publish(path_of(NO_POSITIONS, [], stamp_ns, frame_id))

    def publish_status(
        self, stamp_ns: int, experience_map: ExperienceMap, guidance: Guidance,
        navigator: Navigator, reason: str, refused: str = '',
    ) -> None:  # fmt: skip
        """Publish the status if it has changed, and periodically while there is a goal.

        Args:
            stamp_ns: stamp of the last odometry.
            experience_map: the map.
            guidance: the current guidance of the navigator.
            navigator: the navigator, for its queue and the ended goals.
            reason: why the last requested goal has no route, else empty.
            refused: name of the request that was refused for this reason, '' for none.
        """
        key = (
            guidance.status, guidance.replanned, guidance.behaviour, experience_map.current_id,
            navigator.ended, reason, refused, len(navigator.queue), experience_map.localisation,
            guidance.reason,
            stamp_ns // REPUBLISH_PERIOD_NS if navigator.queue else 0,
        )  # fmt: skip
        if key != self._status_key:
            self._status_key = key
            status = GoalStatus.of(
                stamp_ns, experience_map, guidance, navigator.queue, navigator.outcomes, reason,
                refused,
            )  # fmt: skip
            self._status.publish(String(data=encode(status)))
