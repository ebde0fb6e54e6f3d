# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One sender per topic: if two nodes publish it, only the messages of one are used.

The numbers and ids in these messages belong to the memory of the sender, so messages of two
senders would corrupt the map. It happens if two launch files run at once.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.node import Node

from ratslam_ros.ros.inputs import publisher_count

HOLD_S = 2.0
"""Wall-clock time without a message after which another sender takes the place of the present one.
One that was killed remains in the graph for seconds. A node takes longer to start."""


class SingleSender:
    """Accepts the messages of one sender of a topic, and of its successor when it has ended."""

    def __init__(self, node: Node, topic: str, refuse: Callable[[str], None]) -> None:
        """Accept any sender.

        Args:
            node: the receiver.
            topic: the topic.
            refuse: called with a line about each message of another sender.
        """
        self._node, self._topic, self._refuse = node, topic, refuse
        self._sender, self._heard_s = 0, 0.0

    def accepts(self, sender: int) -> bool:
        """Return whether to use a message of a sender; 0 if it is unknown."""
        now_s = time.monotonic()
        if sender and sender != self._sender:
            if self._sender and now_s - self._heard_s < HOLD_S and (
                publisher_count(self._node, self._topic) > 1
            ):
                self._report()
                return False
            self._sender = sender
        self._heard_s = now_s
        return True

    def _report(self) -> None:
        topic = self._node.resolve_topic_name(self._topic)
        names = sorted(
            f'{info.node_namespace.rstrip("/")}/{info.node_name}'
            for info in self._node.get_publishers_info_by_topic(topic)
        )
        self._refuse(
            f'two nodes publish it ({" and ".join(names)}); the messages of the first one are '
            'used, and the others are ignored: end one of the two, such as a second launch file'
        )
