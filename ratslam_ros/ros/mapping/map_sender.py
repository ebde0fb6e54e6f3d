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

import threading
import time
from collections.abc import Iterator

from rclpy.node import Node
from std_msgs.msg import String

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.messages.mapping import map_text
from ratslam_ros.ros.convert import serialised_text
from ratslam_ros.ros.qos import LATCHED

MAX_LOAD_RATIO = 0.1
"""Largest share of a core for sending the map: a large map is sent at a longer period. Only
processor time counts, and not the time for which a busy machine stops the node."""

MIN_SLICE_S, MAX_SLICE_S = 0.0005, 0.003
"""Least and largest time of writing at once: the time of one step, and with another step less than
the 5 ms by which a message may be delayed. In between it is the permitted share of the time since
the last slice, so that slices are short while many messages arrive."""

THREAD_BYTES = 2**18
"""Length of a text above which a thread publishes it; a shorter one takes less than 1 ms."""


class MapSender:
    """Sends the map after changes, at a limited rate and load."""

    def __init__(self, node: Node) -> None:
        """Create the topic of a node."""
        self.has_changed = False
        """Whether the map differs from the one that was sent last, or is being written."""
        self.has_sent = False
        """Whether a map was ever sent."""
        self._publisher = node.create_publisher(String, 'experience_map/map', LATCHED)
        self._parts: list[bytes] = []
        self._steps: Iterator[bytes] | None = None
        self._thread: threading.Thread | None = None
        self._next_s = self._begun_s = self._paused_s = self._worked_s = 0.0

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
        start_s = time.monotonic()
        if self._thread is not None and self._thread.is_alive():
            return False
        if self._steps is None:
            if not self.has_changed or start_s < self._next_s:
                return False
            self._begin(experience_map, stamp_ns)
            self._begun_s, self._worked_s = start_s, 0.0
            self._paused_s = start_s - MAX_SLICE_S / MAX_LOAD_RATIO
        slice_s = min(MAX_LOAD_RATIO * (start_s - self._paused_s), MAX_SLICE_S)
        if slice_s < MIN_SLICE_S:
            return False
        worked_s = time.thread_time()
        is_complete = self._write(start_s + slice_s)
        self._paused_s = time.monotonic()
        self._worked_s += time.thread_time() - worked_s
        if is_complete:
            self._publish()
            self._next_s = max(
                self._begun_s + period_s, self._begun_s + self._worked_s / MAX_LOAD_RATIO
            )
        return is_complete

    def finish(self, experience_map: ExperienceMap, stamp_ns: int) -> None:
        """Publish the last map at once if it was not published yet."""
        if self._thread is not None:
            self._thread.join()
        if self.has_changed or self._steps is not None:
            self._begin(experience_map, stamp_ns)
            self._write(float('inf'))
            self._send(self._parts)

    def _begin(self, experience_map: ExperienceMap, stamp_ns: int) -> None:
        self.has_changed = False
        self._parts, self._steps = [], map_text(stamp_ns, experience_map)

    def _write(self, until_s: float) -> bool:
        """Write until a time or the end; return whether the text is complete."""
        assert self._steps is not None
        for part in self._steps:
            self._parts.append(part)
            if time.monotonic() >= until_s:
                return False
        self._steps = None
        return True

    def _publish(self) -> None:
        self.has_sent = True
        if sum(map(len, self._parts)) < THREAD_BYTES:
            self._send(self._parts)
            return
        self._thread = threading.Thread(target=self._send, args=(self._parts,))
        self._thread.start()

    def _send(self, parts: list[bytes]) -> None:
        self._publisher.publish(serialised_text(parts))
