# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Subscription to the changes of the experience map."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ratslam_ros.messages.map_changes import MapChangeFollower, MapChangePayload
from ratslam_ros.ros.payloads import decoded
from ratslam_ros.ros.qos import STATE

REQUEST_PERIOD_S = 1.0
"""Time to wait for the whole map before it is requested, and requested again."""


class FollowedMap:
    """The changes of the map of experience_map, for another node."""

    def __init__(
        self, node: Node, refuse: Callable[[str, str], None],
        use: Callable[[MapChangePayload], None],
    ) -> None:
        """Subscribe.

        Args:
            node: the node.
            refuse: called with the stream and the reason if a message cannot be used.
            use: called with each change that follows the one before.
        """
        self.is_complete = False
        """Whether all of the map has arrived since it was last sent from the beginning."""
        self._node, self._use = node, use
        self._client = node.create_client(Trigger, 'experience_map/send_all')
        self._subscription = node.create_subscription(
            String, MapChangePayload.TOPIC,
            decoded(MapChangePayload, self._on_change, refuse, 'changes'), STATE,
        )
        self.restart()

    def restart(self) -> None:
        """Wait for the whole map."""
        self._follower = MapChangeFollower()
        self._requested_s = time.monotonic()

    def close(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self._subscription)
        self._node.destroy_client(self._client)

    def request_if_needed(self) -> None:
        """Request the whole map if none has arrived or changes have been lost."""
        now_s = time.monotonic()
        if not self._follower.needs_all or now_s - self._requested_s < REQUEST_PERIOD_S:
            return
        if self._client.service_is_ready():
            self._requested_s = now_s
            self._client.call_async(Trigger.Request())

    def _on_change(self, received: MapChangePayload) -> None:
        if not self._follower.accepts(received):
            self.is_complete = False
            return
        self._use(received)
        if received.restart:
            self.is_complete = False
        self.is_complete |= received.pending == 0
