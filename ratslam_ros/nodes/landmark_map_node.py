# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node of the landmark map: odom, scan -> landmark_map/map, markers and TF."""

from __future__ import annotations

import math
import time
from typing import Any

from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from ratslam_ros.core.common.odometry import MotionFromOdometry, Odometry
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.core.landmarks.laser_map import STREAMS, LaserMap
from ratslam_ros.messages.landmarks import encode_landmarks
from ratslam_ros.messages.logged import (
    decode_odometry,
    decode_scan,
    encode_odometry,
    encode_scan,
)
from ratslam_ros.nodes.convert import accepted_odometry, transform
from ratslam_ros.nodes.markers import landmark_markers
from ratslam_ros.nodes.node import FLUSH_CHECK_PERIOD_S, RatslamNode
from ratslam_ros.nodes.odometry_frames import FROM_ODOMETRY, OdometryFrames
from ratslam_ros.nodes.qos import LATCHED, STATE
from ratslam_ros.nodes.run import run
from ratslam_ros.nodes.scans import ScanInput

MAX_MAP_LOAD_RATIO = 0.1
"""Largest share of a core for sending the map: a large map is sent at a longer period."""


class LandmarkMapNode(RatslamNode[Odometry | Scan]):
    """Maps corners and edges of walls by a laser, independently of the experience map."""

    SECTION = 'landmark_map'
    PARTS = ('line_extraction',)
    MAPS = True

    def __init__(self, initial: Config = Config()) -> None:
        super().__init__(STREAMS, initial)
        self._map_publisher = self.create_publisher(String, 'landmark_map/map', LATCHED)
        self._markers = self.create_publisher(MarkerArray, 'landmark_map/markers', LATCHED)
        self._tf = self.create_publisher(TFMessage, '/tf', STATE)
        self._next_map_s = 0.0
        self._sent = False
        self._viewers = 0
        self._reset_state()
        self._add_input(
            'odometry', {'odom': OdometryMessage}, self._on_odometry,
            lambda data: self._take_odometry(decode_odometry(data)),
        )  # fmt: skip
        self._frames = OdometryFrames(
            self._section.odom_frame, FROM_ODOMETRY, self._diagnostics.note
        )
        self._laser = ScanInput(
            self, self._diagnostics.note, lambda: self._frames.known_base, self._refuse,
            self._use_scan,
        )  # fmt: skip
        self._add_input(
            'scan', {'scan': LaserScan}, self._laser.receive,
            lambda data: self._use_scan(decode_scan(data)),
        )  # fmt: skip
        self.create_timer(FLUSH_CHECK_PERIOD_S, self._on_timer, clock=self._steady)

    def _reset_state(self) -> None:
        self._core = LaserMap(self._section, self.config.line_extraction)
        self._core.mapping = self._mapping
        self._motion = MotionFromOdometry(
            self._section.odom_source, self._section.max_odom_gap_s,
            self._section.turn_correction,
        )
        self._scan_ns = 0
        self._changed = self._sent  # subscribers that have the old map get the empty one

    def _on_relocated(self) -> None:
        self._motion.restart()
        self._core.lose()

    def _set_mapping(self, mapping: bool) -> None:
        self._core.mapping = mapping

    def _memory_state(self) -> State:
        return {
            'scan_ns': self._scan_ns, 'core': self._core.state(), 'motion': self._motion.state(),
        }  # fmt: skip

    def _restore(self, state: State) -> None:
        core = LaserMap(self._section, self.config.line_extraction)
        core.restore(state['core'])
        self._scan_ns = int(state['scan_ns'])
        self._core = core
        self._core.mapping = self._mapping
        if 'motion' in state:
            self._motion.restore(state['motion'])
        else:
            self._motion.restart()
        self._changed = True

    def close(self) -> None:
        """Process the messages that are still held, and publish the last map."""
        super().close()
        self._send_map()

    def _on_odometry(self, message: OdometryMessage) -> None:
        self._frames.update(message)
        odometry = accepted_odometry(message, self._motion, self._refuse)
        if odometry is not None:
            self._take_odometry(odometry)

    def _take_odometry(self, odometry: Odometry) -> None:
        self._push('odometry', odometry.stamp_ns, odometry)
        self._log('odometry', odometry.stamp_ns, lambda: encode_odometry(odometry))
        if not self._is_halted:
            self._publish_tf(odometry)

    def _use_scan(self, scan: Scan) -> None:
        self._push('scan', scan.stamp_ns, scan)
        self._log('scan', scan.stamp_ns, lambda: encode_scan(scan))

    def _process_item(self, stamp_ns: int, stream: str, item: Odometry | Scan) -> None:
        if isinstance(item, Odometry):
            motion = self._motion.update(item)
            if motion is not None:
                self._core.integrate(motion)
            return
        with self._diagnostics.times('landmark_map'):
            is_used = self._core.scan(item)
        if is_used:
            self._scan_ns = stamp_ns
            self._changed = True

    def _publish_tf(self, odometry: Odometry) -> None:
        """Publish odom_frame -> map_frame, so that the map is shown where the robot sees it."""
        p = self._section
        if odometry.stamp_ns != self._order.newest_of('odometry'):
            return  # refused, late, or not confirmed by the stamp order
        if p.publish_tf and not self._core.is_lost and all(map(math.isfinite, odometry.pose)):
            held = (o for o in self._order.waiting('odometry') if isinstance(o, Odometry))
            ahead = self._motion.ahead(held, Pose(0.0, 0.0, 0.0))
            pose = composed(self._core.pose, ahead)
            self._tf.publish(TFMessage(transforms=[
                transform(
                    odometry.stamp_ns, self._frames.odom, p.map_frame,
                    composed(odometry.pose, inverse(pose)),
                )
            ]))  # fmt: skip

    def _on_timer(self) -> None:
        self._laser.update()
        self._flush()
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
        text = encode_landmarks(self._scan_ns, self._core, self._section.map_frame)
        self._map_publisher.publish(String(data=text))
        if self._viewers > 0:
            self._send_markers()
        worked_s = time.thread_time() - worked_s  # and not the pauses of a busy machine
        self._next_map_s = start_s + max(
            self._section.map_period_s, worked_s / MAX_MAP_LOAD_RATIO
        )

    def _send_markers(self) -> None:
        features = self._core.memory.map.features()
        self._markers.publish(
            landmark_markers(features, self._scan_ns, self._section.map_frame)
        )

    def _diagnostic_values(self) -> dict[str, Any]:
        return {
            'landmarks': len(self._core),
            'scans_used': self._core.scan_count,
            'outliers': self._core.memory.map.outlier_count,
            'is_lost': self._core.is_lost,
            'relocated': self._core.relocated_count,
        }


def main(args: list[str] | None = None) -> int:
    """Run the node until it is interrupted."""
    return run(LandmarkMapNode, args=args)
