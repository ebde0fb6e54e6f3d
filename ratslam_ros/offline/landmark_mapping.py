# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmark map of a recording: what the node landmark_map builds from the same messages."""

from __future__ import annotations

from collections.abc import Iterable

from ratslam_ros.core.common.odometry import MotionFromOdometry, Odometry
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.common.stamp_order import Released, StampOrder
from ratslam_ros.core.config import Config
from ratslam_ros.core.landmarks.laser_map import STREAMS, LaserMap
from ratslam_ros.messages.landmarks import encode_landmarks


class LandmarkMapping:
    """Landmark map, fed with odometry and scans in the order in which they were received."""

    def __init__(self, config: Config) -> None:
        p = config.landmark_map
        self.laser_map = LaserMap(p, config.line_extraction)
        self._frame_id = p.map_frame
        self._motion = MotionFromOdometry(p.odom_source, p.max_odom_gap_s, p.turn_correction)
        self._order: StampOrder[Odometry | Scan] = StampOrder(
            STREAMS, round(p.max_lateness_s * 1e9)
        )
        self._scan_ns = 0

    def odometry(self, odometry: Odometry) -> None:
        """Process one odometry message; one with a value that is not finite is dropped."""
        if self._motion.accepts(odometry):
            self._process(self._order.push('odometry', odometry.stamp_ns, odometry))

    def scan(self, scan: Scan) -> None:
        """Process one scan."""
        self._process(self._order.push('scan', scan.stamp_ns, scan))

    def finish(self) -> str:
        """Process all held messages, and return the map as JSON."""
        self._process(self._order.flush())
        return encode_landmarks(self._scan_ns, self.laser_map, self._frame_id)

    def _process(self, released: Iterable[Released[Odometry | Scan]]) -> None:
        for stamp_ns, _, item in released:
            if isinstance(item, Scan):
                if self.laser_map.scan(item):
                    self._scan_ns = stamp_ns
            elif (motion := self._motion.update(item)) is not None:
                self.laser_map.integrate(motion)
