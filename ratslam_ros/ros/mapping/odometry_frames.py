# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frames of the odometry: those that its messages name, or those of the parameters."""

from __future__ import annotations

import math
from collections.abc import Callable

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry as OdometryMessage

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.errors import UnreachableGoal
from ratslam_ros.ros.convert import planar_pose

ODOM_FRAME, BASE_FRAME = 'odom', 'base_link'
"""Frames if neither the messages nor the parameters name them (REP 105)."""

FROM_ODOMETRY = 'auto'
"""Value of the parameters for the frames that the messages name."""


class OdometryFrames:
    """Names of the frames in which the odometry is given, and that it tracks."""

    def __init__(
        self, warn: Callable[[str], None], odom_frame: str = FROM_ODOMETRY,
        base_frame: str = FROM_ODOMETRY,
    ) -> None:
        """Take the values of the parameters.

        Args:
            warn: called once for each message that contradicts a parameter.
            odom_frame, base_frame: names of the frames, or ``FROM_ODOMETRY``.
        """
        self._given = {'odom_frame': odom_frame, 'base_frame': base_frame}
        self._warn = warn
        self._named: tuple[str, str] | None = None

    @property
    def known_base(self) -> str | None:
        """Frame of the robot; None while a message is needed to know it."""
        is_known = self._named is not None or self._given['base_frame'] != FROM_ODOMETRY
        return self.base if is_known else None

    @property
    def odom(self) -> str:
        """Frame in which the odometry is given."""
        return self._frame('odom_frame', 0, ODOM_FRAME)

    @property
    def base(self) -> str:
        """Frame of the robot."""
        return self._frame('base_frame', 1, BASE_FRAME)

    def update(self, message: OdometryMessage) -> None:
        """Take the names from a message."""
        named = message.header.frame_id.lstrip('/'), message.child_frame_id.lstrip('/')
        if named == self._named:
            return
        self._named = named
        for (parameter, given), name, field in zip(
            self._given.items(), named, ('frame_id', 'child_frame_id'), strict=True
        ):
            if given != FROM_ODOMETRY and name and name != given:
                self._warn(
                    f'the odometry has the {field} {name}, but {parameter} is {given}: the TF '
                    f'tree is broken unless another node publishes a transform between them; set '
                    f'{parameter} to {FROM_ODOMETRY}, or correct the odometry'
                )

    def pose_on_map(
        self, message: PoseStamped, map_frame: str, here: Pose | None, odom_pose: Pose
    ) -> Pose:
        """Transform the pose of a goal to the frame of the map.

        Args:
            message: pose in the frame of the map, the odometry or the robot; no frame: the map's.
            map_frame: the frame of the map.
            here: pose of the robot on the map; None: unknown.
            odom_pose: pose of the robot in the frame of the odometry.

        Raises:
            UnreachableGoal: it is not finite, or its frame has no transform to the map.
        """
        frame = message.header.frame_id.lstrip('/')
        pose = planar_pose(message.pose)
        if not all(map(math.isfinite, pose)):
            raise UnreachableGoal('its position or orientation is not finite')
        if frame in ('', map_frame):
            return pose
        if here is not None and frame == self.base:
            return composed(here, pose)
        if here is not None and frame == self.odom:
            return composed(composed(here, inverse(odom_pose)), pose)
        reason = f'expected {map_frame}, {self.odom} or {self.base}'
        if frame in (self.odom, self.base):
            reason = 'the pose of the robot on the map is unknown'
        raise UnreachableGoal(f'there is no transform from {frame!r} to {map_frame!r}: {reason}')

    def _frame(self, parameter: str, index: int, default: str) -> str:
        given = self._given[parameter]
        if given != FROM_ODOMETRY:
            return given
        return (self._named[index] if self._named is not None else '') or default
