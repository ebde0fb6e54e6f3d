# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmark map of a recording: what the node landmark_map builds from the same messages."""

from __future__ import annotations

from collections.abc import Iterable

from ratslam_ros.core.common.odometry import (
    MotionFromOdometry,
    Odometry,
    odometry_from_state,
    odometry_state,
)
from ratslam_ros.core.common.scan import Scan, scan_from_state, scan_state
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.core.landmarks.laser_map import STREAMS, LaserMap
from ratslam_ros.errors import UnusableInput
from ratslam_ros.messages.landmarks import encode_landmarks
from ratslam_ros.pipeline.order import Released, StampOrder


class LandmarkMapping:
    """Landmark map, fed with odometry and scans in the order in which they were received."""

    def __init__(self, config: Config) -> None:
        p = config.landmark_map
        self.laser_map = LaserMap(p, config.line_extraction)
        self._frame_id = p.map_frame
        self._motion = MotionFromOdometry(p.odom_source, p.max_odom_gap_s, p.turn_correction)
        self._lateness_ns = round(p.max_lateness_s * 1e9)
        self._order = self._new_order()
        self._scan_ns = 0

    def _new_order(self) -> StampOrder[Odometry | Scan]:
        return StampOrder(STREAMS, self._lateness_ns, 'odometry')

    def odometry(self, odometry: Odometry) -> None:
        """Process one odometry message; one with a value that is not finite is dropped."""
        if self._motion.accepts(odometry):
            self._process(self._order.push('odometry', odometry.stamp_ns, odometry))

    def scan(self, scan: Scan) -> None:
        """Process one scan."""
        self._process(self._order.push('scan', scan.stamp_ns, scan))

    def state(self) -> State:
        """Return everything, for ``restore``; what the node saves, and what only a replay has."""
        return {
            'scan_ns': self._scan_ns, 'core': self.laser_map.state(),
            'motion': self._motion.state(), 'order': self._order.state(_item_state),
        }  # fmt: skip

    def restore(self, state: State) -> None:
        """Restore what ``state`` returned, or the state of the node; nothing must be learned.

        Raises:
            UnusableInput: the state is damaged, or of another version.
        """
        try:
            self.laser_map.restore(state['core'])
            self._scan_ns = int(state['scan_ns'])
            if 'order' in state:
                self._motion.restore(state['motion'])
                self._order.restore(state['order'], _item_from_state)
        except (KeyError, ValueError, TypeError, IndexError, AttributeError) as error:
            raise UnusableInput(
                f'the saved landmarks are damaged, or of another version ({error!r})'
            ) from None

    def begin_session(self) -> None:
        """Process all held messages, and continue with inputs that do not follow them."""
        self._process(self._order.flush())
        self._order = self._new_order()
        self._motion.restart()
        self.laser_map.lose()

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


def _item_state(item: Odometry | Scan) -> State:
    """Return a held message for a saved state."""
    if isinstance(item, Scan):
        return {'scan': scan_state(item)}
    return {'odometry': odometry_state(item)}


def _item_from_state(state: State) -> Odometry | Scan:
    """Return a held message from ``_item_state``."""
    if 'scan' in state:
        return scan_from_state(state['scan'])
    return odometry_from_state(state['odometry'])
