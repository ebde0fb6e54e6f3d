# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses that an operator gives on ``initialpose``."""

from __future__ import annotations

from collections.abc import Callable

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.pose_hint import PoseHint
from ratslam_ros.errors import UnusableInput
from ratslam_ros.pipeline.commands import NOW
from ratslam_ros.ros.convert import planar_pose, stamp_ns
from ratslam_ros.ros.qos import GOAL

STREAM = 'initialpose'
"""Name of the topic."""

AHEAD_NS = 2_000_000_000
"""A stamp this far ahead of the inputs is of another clock: the pose holds from now on."""

X, Y, YAW = 0, 1, 5
"""Rows of the (6, 6) covariance of a message."""


class PoseHints:
    """Receives poses, and checks them."""

    def __init__(
        self, node: Node, frame_id: str, newest_ns: Callable[[], int],
        refuse: Callable[[str, str], None], give: Callable[[int, PoseHint], None],
    ) -> None:  # fmt: skip
        """Subscribe.

        Args:
            node: the node that subscribes.
            frame_id: frame of the map, in which poses must be given.
            newest_ns: returns the newest stamp of the inputs.
            refuse: called with the stream and the reason for a message that cannot be used.
            give: called with the stamp, 0 for now, and each pose.
        """
        self._node, self._frame_id, self._newest_ns = node, frame_id, newest_ns
        self._refuse, self._give = refuse, give
        node.create_subscription(PoseWithCovarianceStamped, STREAM, self._on_pose, GOAL)

    def report(self, at_ns: int, hint: PoseHint, graph: ExperienceMap) -> None:
        """Log what a pose means for a map that has got it."""
        is_used = graph.hint is not None and graph.hint.hint == hint
        effect = (
            'the robot is there until recognised places confirm or refute it' if is_used
            else 'it has no effect: the map is empty, or the pose on it agrees already'
        )  # fmt: skip
        self._node.get_logger().info(f'a pose was given at {at_ns * 1e-9:.3f} s; {effect}')

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        frame = message.header.frame_id.lstrip('/')
        if frame not in ('', self._frame_id):
            self._refuse(STREAM, f'its frame is {frame!r:.100}; expected {self._frame_id}')
            return
        values = message.pose.covariance
        hint = PoseHint(
            planar_pose(message.pose.pose), float(values[6 * X + X]), float(values[6 * X + Y]),
            float(values[6 * Y + Y]), float(values[6 * YAW + YAW]),
        )  # fmt: skip
        try:
            hint.checked()
        except UnusableInput as error:
            self._refuse(STREAM, str(error))
            return
        given_ns = stamp_ns(message.header)
        is_other_clock = given_ns > self._newest_ns() + AHEAD_NS
        self._give(NOW if is_other_clock else given_ns, hint)
