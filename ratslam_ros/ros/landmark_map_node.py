# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node of the landmark map: odom, scan -> landmark_map/map, markers and TF."""

from __future__ import annotations

import math
import time
from typing import Any

from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.landmarks.laser_map import LaserMap
from ratslam_ros.messages.landmarks import LandmarksPayload
from ratslam_ros.pipeline.landmark_map import LandmarkMapStage
from ratslam_ros.pipeline.pipeline import Pipeline
from ratslam_ros.ros.convert import transform
from ratslam_ros.ros.mapping.markers import landmark_markers
from ratslam_ros.ros.node import RatslamNode
from ratslam_ros.ros.qos import LATCHED, STATE

MAP_PERIOD_S = 1.0
"""Minimum time between two messages with all landmarks; the latest are always sent."""

MAX_MAP_LOAD_RATIO = 0.1
"""Largest share of a core for sending the map: a large map is sent at a longer period."""


class LandmarkMapNode(RatslamNode):
    """Maps corners and edges of walls by a laser, independently of the experience map."""

    SECTION = 'landmark_map'
    MAPS = True
    TAKES = ('odometry', 'scan')
    _stage: LandmarkMapStage

    def connect(self, pipeline: Pipeline) -> None:
        """Publish the map when it has changed."""
        self._map_publisher = self.create_payload_publisher(LandmarksPayload, LATCHED)
        self._markers = self.create_publisher(MarkerArray, 'landmark_map/markers', LATCHED)
        self._tf = self.create_publisher(TFMessage, '/tf', STATE)
        self._next_map_s = 0.0
        self._sent = self._changed = False
        self._viewers = 0
        pipeline.observe('landmarks', self._note_change)

    @property
    def _core(self) -> LaserMap:
        return self._stage.core

    def started_over(self) -> None:
        """Continue after the memory was emptied."""
        super().started_over()
        self._changed = self._sent  # subscribers that have the old map get the empty one

    def restored(self) -> None:
        """Continue after the stage was restored from a state."""
        self._changed = True

    def close(self) -> None:
        """Process the messages that are still held, and publish the last map."""
        super().close()
        self._send_map()

    def _note_change(self, stamp_ns: int, count: int) -> None:
        self._changed = True

    def _locate(self, odometry: Odometry) -> None:
        """Publish odom_frame -> map_frame, so that the map is shown where the robot sees it."""
        if not self._core.is_lost and all(map(math.isfinite, odometry.pose)):
            held = self.host.pipeline.waiting('odometry')
            ahead = self._stage.motion.ahead(held, Pose(0.0, 0.0, 0.0))
            pose = composed(self._core.pose, ahead)
            self._tf.publish(TFMessage(transforms=[
                transform(
                    odometry.stamp_ns, self.frames.odom, self.section.map_frame,
                    composed(odometry.pose, inverse(pose)),
                )
            ]))

    def _on_timer(self) -> None:
        super()._on_timer()
        if self._changed and time.monotonic() >= self._next_map_s:
            self._send_map()
        viewers = self._markers.get_subscription_count()
        if viewers > self._viewers and self._sent:
            self._send_markers()
        self._viewers = viewers

    def _send_map(self) -> None:
        """Publish the whole map if it has changed since the last time."""
        if not self._changed:
            return
        self._changed, self._sent = False, True
        start_s, worked_s = time.monotonic(), time.thread_time()
        found = LandmarksPayload.of(self._stage.scan_ns, self._core, self.section.map_frame)
        self._map_publisher.publish(found)
        if self._viewers > 0:
            self._send_markers()
        worked_s = time.thread_time() - worked_s  # and not the pauses of a busy machine
        self._next_map_s = start_s + max(
            MAP_PERIOD_S, worked_s / MAX_MAP_LOAD_RATIO
        )

    def _send_markers(self) -> None:
        features = self._core.memory.map.features()
        self._markers.publish(
            landmark_markers(features, self._stage.scan_ns, self.section.map_frame)
        )

    def _diagnostic_values(self) -> dict[str, Any]:
        return {
            'landmarks': len(self._core),
            'scans_used': self._core.scan_count,
            'outliers': self._core.memory.map.outlier_count,
            'is_lost': self._core.is_lost,
            'relocated': self._core.relocated_count,
        }
