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

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.messages.mapping import map_text
from ratslam_ros.ros.convert import serialised_text
from ratslam_ros.ros.mapping.sliced_publisher import SlicedPublisher
from ratslam_ros.ros.qos import LATCHED


class MapSender(SlicedPublisher):
    """Sends the map after changes, at a limited rate and load."""

    def __init__(self, node: Node) -> None:
        """Create the topic of a node."""
        super().__init__(node.create_publisher(String, 'experience_map/map', LATCHED))
        self.has_changed = False
        """Whether the map differs from the one that was sent last, or is being written."""
        self.has_sent = False
        """Whether a map was ever sent."""
        self._parts: list[bytes] = []
        self._steps: Iterator[bytes] | None = None
        self._next_s = 0.0

    def reset(self) -> None:
        """Stop writing: the map was replaced by another one."""
        self._steps = None

    def advance(self, experience_map: ExperienceMap, stamp_ns: int, period_s: float) -> bool:
        """Write a slice of the map if one is due, and publish the map after the last one.

        Args:
            experience_map: the map.
            stamp_ns: stamp of its last action.
            period_s: shortest time between two maps.

        Returns:
            Whether the map was published.
        """
        if not self._may_work():
            return False
        if self._steps is None:
            now_s = time.monotonic()
            if not self.has_changed or now_s < self._next_s:
                return False
            self._next_s = now_s + period_s
            self.has_changed = False
            self._parts, self._steps = [], map_text(stamp_ns, experience_map)
        self._work(self._write)
        if self._steps is not None:
            return False
        self.has_sent = True
        self._send(sum(map(len, self._parts)), partial(serialised_text, self._parts))
        return True

    def finish(self, experience_map: ExperienceMap, stamp_ns: int) -> None:
        """Publish the last map at once if it was not published yet."""
        self.close()
        if self.has_changed or self._steps is not None:
            self.reset()
            self.has_changed = False
            self._publisher.publish(serialised_text([*map_text(stamp_ns, experience_map)]))

    def _write(self) -> bool:
        """Write a part of the text; return whether it is not complete."""
        assert self._steps is not None
        part = next(self._steps, None)
        if part is None:
            self._steps = None
            return False
        self._parts.append(part)
        return True
