# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publisher of ``experience_map/grid``, which draws the scans in short slices between messages."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial

from nav_msgs.msg import OccupancyGrid as GridMessage
from rclpy.node import Node

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.occupancy import Picture
from ratslam_ros.core.mapping.occupancy_grid import OccupancyGrid
from ratslam_ros.core.mapping.scan_matching import ScanMatcher
from ratslam_ros.ros.convert import grid_message
from ratslam_ros.ros.mapping.sliced_publisher import SlicedPublisher
from ratslam_ros.ros.qos import LATCHED

SCANS_AT_ONCE = 2
"""Scans that are drawn in one step: each is removed and added in up to 0.3 ms per 720 beams."""

PERIOD_S = 2.0
"""Shortest time between two pictures, which are large."""

LONGEST_WAIT_S = 5.0
"""Time after which a picture is sent although the map is still being drawn."""


class GridPublisher(SlicedPublisher):
    """Keeps a picture of the map up to date while there is a subscriber."""

    def __init__(self, node: Node) -> None:
        """Create the topic."""
        super().__init__(node.create_publisher(GridMessage, 'experience_map/grid', LATCHED))
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
        if not self._may_work() or self._publisher.get_subscription_count() == 0:
            return False
        self._work(partial(self._draw, graph, scans, stamp_ns))
        return True

    def _draw(self, graph: ExperienceMap, scans: ScanMatcher, stamp_ns: int) -> bool:
        """Draw some scans, or a part of the picture; return whether more is to be drawn."""
        now_s = time.monotonic()
        if self._rows is not None:
            written = next(self._rows, None)
            if written is None:
                self._finish(stamp_ns, graph.frame_id)
            self._picture = written or self._picture
            return True
        remaining = self._grid.update(graph, scans, SCANS_AT_ONCE)
        self._has_changed |= self._grid.has_changed
        is_due = now_s >= self._next_s and self._has_changed
        is_due &= self._has_sent or not self._grid.is_empty
        if is_due and (remaining == 0 or now_s - self._sent_s > LONGEST_WAIT_S):
            self._rows = self._grid.picture()
            self._has_changed, self._next_s = False, now_s + PERIOD_S
        return remaining > 0 or self._rows is not None

    def _finish(self, stamp_ns: int, frame_id: str) -> None:
        """Publish the complete picture."""
        assert self._picture is not None
        self._rows, self._sent_s, self._has_sent = None, time.monotonic(), True
        make = partial(grid_message, self._picture, stamp_ns, frame_id)
        self._send(self._picture.percent.nbytes, make)
