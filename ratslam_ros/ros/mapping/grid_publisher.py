# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publisher of ``experience_map/grid``, which draws the scans in short slices between messages."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial

from nav_msgs.msg import OccupancyGrid as GridMessage
from rclpy.node import Node

from ratslam_ros.core.mapping.occupancy_grid import OccupancyGrid
from ratslam_ros.pipeline.live_stages import LiveExperienceMap
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

    def __init__(self, node: Node, stage: LiveExperienceMap) -> None:
        """Create the topic of the map of a stage."""
        super().__init__(node.create_publisher(GridMessage, 'experience_map/grid', LATCHED))
        self._stage, self._has_sent = stage, False
        self.reset()

    def reset(self) -> None:
        """Draw another map from the beginning."""
        self._grid, self._steps = OccupancyGrid(), self._drawn()
        self._next_slice_s = 0.0

    def advance(self) -> bool:
        """Draw a slice if one is due; return whether it was."""
        if not self._may_work() or self._publisher.get_subscription_count() == 0:
            return False
        self._work(self._steps)
        return True

    def _drawn(self) -> Iterator[bool]:
        """Draw some scans, or a part of the picture; yield whether more is to be drawn."""
        has_changed, next_s, sent_s = True, 0.0, time.monotonic()
        while True:
            graph, scans, now_s = self._stage.core, self._stage.scans, time.monotonic()
            assert scans is not None
            remaining = self._grid.update(graph, scans, SCANS_AT_ONCE)
            has_changed |= self._grid.has_changed
            is_due = now_s >= next_s and has_changed
            is_due &= self._has_sent or not self._grid.is_empty
            is_due &= remaining == 0 or now_s - sent_s > LONGEST_WAIT_S
            yield remaining > 0 or is_due
            if is_due:
                has_changed, next_s = False, now_s + PERIOD_S
                rows = self._grid.picture()
                picture = next(rows)
                for _ in rows:
                    yield True
                self._has_sent, sent_s = True, time.monotonic()
                self._send(picture.percent.nbytes, partial(
                    grid_message, picture, self._stage.action_ns, graph.frame_id
                ))
