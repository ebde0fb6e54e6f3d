# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publisher of ``experience_map/grid``, which draws the scans in short slices between messages."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

from nav_msgs.msg import OccupancyGrid as GridMessage
from rclpy.node import Node

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.occupancy import Picture
from ratslam_ros.core.mapping.occupancy_grid import OccupancyGrid
from ratslam_ros.core.mapping.scan_matching import ScanMatcher
from ratslam_ros.ros.convert import grid_message
from ratslam_ros.ros.qos import LATCHED

MAX_LOAD_RATIO = 0.1
"""Largest share of a core for drawing. The processor time of drawing is measured, because the time
for which a busy machine stops it may be a thousand times as long."""

SLICE_S = 0.002
"""Time after which a slice ends. One more step takes up to 1 ms, so that no message is delayed by
more than 5 ms."""

SCANS_AT_ONCE = 2
"""Scans that are drawn in one step: each is removed and added in up to 0.3 ms per 720 beams."""

PERIOD_S = 2.0
"""Shortest time between two pictures, which are large."""

LONGEST_WAIT_S = 5.0
"""Time after which a picture is sent although the map is still being drawn."""

THREAD_BYTES = 2**18
"""Size of a picture above which a thread publishes it; a smaller one takes less than 1 ms."""


class GridPublisher:
    """Keeps a picture of the map up to date while there is a subscriber."""

    def __init__(self, node: Node) -> None:
        """Create the topic."""
        self._publisher = node.create_publisher(GridMessage, 'experience_map/grid', LATCHED)
        self._thread: threading.Thread | None = None
        self._has_sent = False
        self.reset()

    def reset(self) -> None:
        """Draw another map from the beginning."""
        self._grid = OccupancyGrid()
        self._rows: Iterator[Picture] | None = None
        self._picture: Picture | None = None
        self._has_changed = True
        self._next_slice_s = self._next_s = 0.0
        self._sent_s = time.monotonic()

    def advance(self, graph: ExperienceMap, scans: ScanMatcher, stamp_ns: int) -> bool:
        """Draw a slice if one is due, and publish the picture after the last one.

        Args:
            graph: the map.
            scans: scans of its experiences.
            stamp_ns: stamp of its last action.

        Returns:
            Whether a slice was drawn.
        """
        start_s, worked_s = time.monotonic(), time.thread_time()
        if start_s < self._next_slice_s or self._publisher.get_subscription_count() == 0:
            return False
        if self._thread is not None and self._thread.is_alive():
            return False
        while (now_s := time.monotonic()) < start_s + SLICE_S:
            if self._rows is not None:
                written = next(self._rows, None)
                if written is None:
                    self._finish(stamp_ns, graph.frame_id)
                self._picture = written or self._picture
                continue
            remaining = self._grid.update(graph, scans, SCANS_AT_ONCE)
            self._has_changed |= self._grid.has_changed
            is_due = now_s >= self._next_s and self._has_changed
            is_due &= self._has_sent or not self._grid.is_empty
            if is_due and (remaining == 0 or now_s - self._sent_s > LONGEST_WAIT_S):
                self._rows = self._grid.picture()
                self._has_changed, self._next_s = False, now_s + PERIOD_S
            elif remaining == 0:
                break
        worked_s = time.thread_time() - worked_s
        self._next_slice_s = time.monotonic() + worked_s / MAX_LOAD_RATIO
        return True

    def _finish(self, stamp_ns: int, frame_id: str) -> None:
        """Publish the complete picture."""
        assert self._picture is not None
        picture, self._rows, self._sent_s = self._picture, None, time.monotonic()
        self._has_sent = True
        if picture.percent.nbytes < THREAD_BYTES:
            self._send(picture, stamp_ns, frame_id)
            return
        self._thread = threading.Thread(target=self._send, args=(picture, stamp_ns, frame_id))
        self._thread.start()

    def _send(self, picture: Picture, stamp_ns: int, frame_id: str) -> None:
        self._publisher.publish(grid_message(picture, stamp_ns, frame_id))
