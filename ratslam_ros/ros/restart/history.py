# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The last messages of a source, for nodes that are restarted and missed them."""

from __future__ import annotations

import time
from typing import Any

from ratslam_ros.ros.qos import history

CUT = 'ratslam/cut'
"""Topic with the number of each state that a node saves in a map file."""

KEPT_BYTES = 256 * 2**20
"""Limit of the messages that are kept for each topic, and of those that arrive at a restarted
process until it has caught up: ten seconds of raw colour images of 640x480 at 30 Hz, minutes of
compressed ones. Nodes are interrupted for a few seconds."""

MAX_KEPT = 3000
"""Limit of their number: a minute of odometry at 50 Hz."""

NEED_CHECK_PERIOD_S = 1.0
"""Period of the checks whether there are nodes with a map file; nothing is kept before."""

MESSAGE_BYTES = 1000
"""Size at which a message without image or scan is counted."""


def history_topic(topic: str) -> str:
    """Return the topic that keeps the last messages of a topic, for nodes that were restarted."""
    return f'ratslam/history/{topic.lstrip("/")}'


def size_of(message: Any) -> int:
    """Return about how many bytes a message takes."""
    return MESSAGE_BYTES + len(getattr(message, 'data', ()))


class History:
    """Publishes messages on topics that keep the last of them."""

    def __init__(self, node: Any) -> None:
        """Keep nothing yet.

        Args:
            node: the node that publishes the messages.
        """
        self._node = node
        self._publishers: dict[str, Any] = {}
        self._is_needed, self._next_check_s = False, 0.0

    def add(self, topic: str, message: Any) -> None:
        """Keep a message that is being published, once there was a node with a map file.

        If it is not there any more, it may be restarted, and then needs all messages since.
        """
        if not self._is_needed and (now_s := time.monotonic()) >= self._next_check_s:
            self._next_check_s = now_s + NEED_CHECK_PERIOD_S
            name = self._node.resolve_topic_name(CUT)
            self._is_needed = self._node.count_publishers(name) > 0
        if not self._is_needed:
            return
        if topic not in self._publishers:
            depth = max(1, min(KEPT_BYTES // size_of(message), MAX_KEPT))
            self._publishers[topic] = self._node.create_publisher(
                type(message), history_topic(topic), history(depth)
            )
        self._publishers[topic].publish(message)
