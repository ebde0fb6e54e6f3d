# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmark map of a recording: what the node landmark_map builds from the same messages."""

from __future__ import annotations

from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.core.landmarks.laser_map import LaserMap
from ratslam_ros.errors import UnusableInput
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.landmarks import LandmarksPayload
from ratslam_ros.pipeline.commands import NOW, NewSession
from ratslam_ros.pipeline.landmark_map import LandmarkMapStage
from ratslam_ros.pipeline.pipeline import COMMAND, Pipeline, lateness_ns


class LandmarkMapping:
    """Landmark map, fed with odometry and scans in the order in which they were received."""

    def __init__(self, config: Config) -> None:
        self._frame_id = config.landmark_map.map_frame
        self._stage = LandmarkMapStage(config)
        self._pipeline = Pipeline([self._stage], lateness_ns(config))

    @property
    def laser_map(self) -> LaserMap:
        """The map."""
        return self._stage.core

    def odometry(self, odometry: Odometry) -> None:
        """Process one odometry message; one with a value that is not finite is dropped."""
        if self._stage.motion.accepts(odometry):
            self._pipeline.feed('odometry', odometry.stamp_ns, odometry)

    def scan(self, scan: Scan) -> None:
        """Process one scan."""
        self._pipeline.feed('scan', scan.stamp_ns, scan)

    def state(self) -> State:
        """Return everything, for ``restore``; what the node saves, and what only a replay has."""
        states = self._pipeline.state()
        return {**states['landmark_map'], 'inputs': states['inputs']}

    def restore(self, state: State) -> None:
        """Restore what ``state`` returned, or the state of the node; nothing must be learned.

        Raises:
            UnusableInput: the state is damaged, or of another version.
        """
        try:
            learned = {key: value for key, value in state.items() if key != 'inputs'}
            self._pipeline.restore({'landmark_map': learned, 'inputs': state.get('inputs', {})})
        except (KeyError, ValueError, TypeError, IndexError, AttributeError) as error:
            raise UnusableInput(
                f'the saved landmarks are damaged, or of another version ({error!r})'
            ) from None

    def begin_session(self) -> None:
        """Process all held messages, and continue with inputs that do not follow them."""
        self._pipeline.finish()
        self._pipeline.begin_inputs()
        self._pipeline.feed(COMMAND, NOW, NewSession())

    def finish(self) -> str:
        """Process all held messages, and return the map as JSON."""
        self._pipeline.finish()
        return encode(LandmarksPayload.of(self._stage.scan_ns, self.laser_map, self._frame_id))
