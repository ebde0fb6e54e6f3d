# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses that an operator gives on ``initialpose``."""

from __future__ import annotations

from geometry_msgs.msg import PoseWithCovarianceStamped

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.pose_hint import PoseHint
from ratslam_ros.errors import UnusableInput
from ratslam_ros.pipeline.commands import NOW, Hint
from ratslam_ros.ros.convert import planar_pose, stamp_ns
from ratslam_ros.ros.node import RatslamNode
from ratslam_ros.ros.payloads import refusing
from ratslam_ros.ros.qos import GOAL

STREAM = 'initialpose'
"""Name of the topic."""

AHEAD_NS = 2_000_000_000
"""A stamp this far ahead of the inputs is of another clock: the pose holds from now on."""

X, Y, YAW = 0, 1, 5
"""Rows of the (6, 6) covariance of a message."""


class PoseHints:
    """Receives poses, and checks them."""

    def __init__(self, node: RatslamNode) -> None:
        """Subscribe for the node of the map."""
        self._node = node
        receive = refusing(self._on_pose, node.diagnostics.refuse, STREAM)
        node.create_subscription(PoseWithCovarianceStamped, STREAM, receive, GOAL)

    def report(self, at_ns: int, hint: PoseHint, graph: ExperienceMap) -> None:
        """Log what a pose means for a map that has got it."""
        is_used = graph.hint is not None and graph.hint.hint == hint
        effect = (
            'the robot is there until recognised places confirm or refute it' if is_used
            else 'it has no effect: the map is empty, or the pose on it agrees already'
        )
        self._node.get_logger().info(f'a pose was given at {at_ns * 1e-9:.3f} s; {effect}')

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        frame, expected = message.header.frame_id.lstrip('/'), self._node.section.map_frame
        values = message.pose.covariance
        hint = PoseHint(
            planar_pose(message.pose.pose), float(values[6 * X + X]), float(values[6 * X + Y]),
            float(values[6 * Y + Y]), float(values[6 * YAW + YAW]),
        )
        if frame not in ('', expected):
            raise UnusableInput(f'its frame is {frame!r:.100}; expected {expected}')
        hint.checked()
        given_ns, newest_ns = stamp_ns(message.header), self._node.host.pipeline.order.newest_ns
        is_other_clock = given_ns > (newest_ns or 0) + AHEAD_NS
        self._node.host.command(Hint(hint), NOW if is_other_clock else given_ns)
