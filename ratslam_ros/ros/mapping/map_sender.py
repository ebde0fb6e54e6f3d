# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publisher of ``experience_map/map``, which writes large maps without delaying the node.

The message of 20,000 experiences has 8 MB, and writing it takes 30 ms. The text is therefore
written in short steps between messages, from a copy of the map as it is at the first step. Joining
the parts of a large text and handing it to the middleware takes about 10 ms, which a thread does.
Python releases its interpreter lock during both (the stand-in; the binding of ROS 2 may hold it
while the middleware copies the message).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial

from rclpy.node import Node
from std_msgs.msg import String

from ratslam_ros.messages.mapping import map_text
from ratslam_ros.pipeline.live_stages import LiveExperienceMap
from ratslam_ros.ros.convert import serialised_text
from ratslam_ros.ros.mapping.sliced_publisher import SlicedPublisher
from ratslam_ros.ros.qos import LATCHED


class MapSender(SlicedPublisher):
    """Sends the map after changes, at a limited rate and load."""

    def __init__(self, node: Node, stage: LiveExperienceMap) -> None:
        """Create the topic of the map of a stage."""
        super().__init__(node.create_publisher(String, 'experience_map/map', LATCHED))
        self._stage = stage
        self.has_changed = False
        """Whether the map differs from the one that was sent last, or is being written."""
        self.has_sent = False
        """Whether a map was ever sent."""
        self._steps: Iterator[bool] | None = None
        self._next_s = 0.0

    def reset(self) -> None:
        """Stop writing: the map was replaced by another one."""
        self._steps = None

    def advance(self, period_s: float) -> bool:
        """Write a slice of the map if one is due; return whether the map was published.

        Args:
            period_s: shortest time between two maps.
        """
        if not self._may_work():
            return False
        if self._steps is None:
            now_s = time.monotonic()
            if not self.has_changed or now_s < self._next_s:
                return False
            self._next_s = now_s + period_s
            self.has_changed, self._steps = False, self._written()
        self._work(self._steps)
        return self._steps is None

    def _written(self) -> Iterator[bool]:
        """Write the text in parts, and publish it."""
        parts: list[bytes] = []
        for part in map_text(self._stage.action_ns, self._stage.core):
            parts.append(part)
            yield True
        self._steps, self.has_sent = None, True
        self._send(sum(map(len, parts)), partial(serialised_text, parts))

    def finish(self) -> None:
        """Publish the last map at once if it was not published yet."""
        self.close()
        if self.has_changed or self._steps is not None:
            self.reset()
            self.has_changed = False
            parts = [*map_text(self._stage.action_ns, self._stage.core)]
            self._publisher.publish(serialised_text(parts))
