# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses that an operator gives on ``initialpose``, as evidence for the experience map."""

from __future__ import annotations

import json
import math
from collections.abc import Callable

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.pose_hint import PendingHints, PoseHint
from ratslam_ros.errors import UnusableInput
from ratslam_ros.ros.convert import planar_pose, stamp_ns
from ratslam_ros.ros.qos import GOAL

STREAM = 'initialpose'
"""Name of the topic, and of its messages in the log of a map file."""

AHEAD_NS = 2_000_000_000
"""A stamp this far ahead of the inputs is of another clock: the pose holds from now on."""

X, Y, YAW = 0, 1, 5
"""Rows of the (6, 6) covariance of a message."""


class PoseHints:
    """Receives poses, and passes each to the map before the message with its stamp."""

    def __init__(
        self, node: Node, frame_id: str, newest_ns: Callable[[], int],
        refuse: Callable[[str, str], None], log: Callable[[str, int, Callable[[], bytes]], None],
    ) -> None:  # fmt: skip
        """Subscribe.

        Args:
            node: the node that subscribes.
            frame_id: frame of the map, in which poses must be given.
            newest_ns: returns the newest stamp of the inputs.
            refuse: called with the stream and the reason for a message that cannot be used.
            log: called with the stream, the stamp and the message of each pose that is used.
        """
        self._node, self._frame_id, self._newest_ns = node, frame_id, newest_ns
        self._refuse, self._log = refuse, log
        self._waiting = PendingHints()
        node.create_subscription(PoseWithCovarianceStamped, STREAM, self._on_pose, GOAL)

    def reset(self) -> None:
        """Drop poses that were not used yet."""
        self._waiting = PendingHints()

    def repeat(self, at_ns: int, data: bytes) -> None:
        """Use a pose from the log again, from the same stamp on."""
        pose, *variances = json.loads(data)
        self._waiting.add(at_ns, PoseHint(Pose(*pose), *variances))

    def use(self, at_ns: int, graph: ExperienceMap) -> None:
        """Pass a pose to the map, if one is due before a message.

        Args:
            at_ns: stamp of the message.
            graph: the map.
        """
        hint = self._waiting.due(at_ns)
        if hint is None:
            return
        here = graph.pose
        is_used = graph.suggest(hint)
        away_m = math.dist(hint.pose[:2], here[:2])
        effect = (
            'it is evidence for the next recognised places' if is_used
            else 'it has no effect: it agrees with the estimate, or exp_jump_drift is 0'
        )  # fmt: skip
        self._node.get_logger().info(
            f'a pose was given at {at_ns * 1e-9:.3f} s, {away_m:.1f} m from the estimate; {effect}'
        )
        self._log(STREAM, at_ns, json.dumps([list(hint.pose), *hint[1:]]).encode)

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
        self._waiting.add(0 if is_other_clock else given_ns, hint)
