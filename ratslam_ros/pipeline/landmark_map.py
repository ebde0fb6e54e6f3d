# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stage landmark_map: odometry and scans to a map of landmarks."""

from __future__ import annotations

from typing import ClassVar

from ratslam_ros.core.common.odometry import MotionFromOdometry, Odometry
from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config import Config
from ratslam_ros.core.landmarks.laser_map import LaserMap
from ratslam_ros.pipeline.commands import Command, NewSession, Relocated, Reset, SetMapping
from ratslam_ros.pipeline.stage import OF_HOST, Output, Reader


class LandmarkMapStage(Saved):
    """Maps corners and edges of walls by a laser, independently of the other stages."""

    SAVED = (
        Field('scan_ns', 'scan_ns', int), Field('core', 'core', LaserMap),
        Field('motion', 'motion', MotionFromOdometry, of_session=True, optional=True), *OF_HOST,
    )

    NAME: ClassVar[str] = 'landmark_map'
    WRITES: ClassVar[tuple[str, ...]] = ('landmarks',)

    def __init__(self, config: Config) -> None:
        self._config = config
        self._mapping = True
        self._begin()

    def _begin(self) -> None:
        inputs = self._config.inputs
        self.core = LaserMap(self._config.landmark_map.lm_max, self._config.memory)
        self.core.mapping = self._mapping
        # Without max_odom_gap_s: scans correct the pose after a gap, as after any other error.
        self.motion = MotionFromOdometry(inputs.odom_source, correction=inputs.turn_correction)
        self.scan_ns = 0
        """Stamp of the last scan that was used."""

    def readers(self) -> dict[str, Reader]:
        """Return the readers."""
        return {'command': self._obey, 'odometry': self._move, 'scan': self._scan}

    def _obey(self, stamp_ns: int, command: Command) -> None:
        match command:
            case SetMapping():
                self.core.mapping = self._mapping = command.mapping
            case Reset():
                self._begin()
            case NewSession() | Relocated():
                self._relocated()

    def _relocated(self) -> None:
        self.motion.restart()
        self.core.lose()

    def _move(self, stamp_ns: int, odometry: Odometry) -> None:
        motion = self.motion.update(odometry)
        if motion is not None:
            self.core.integrate(motion)

    def _scan(self, stamp_ns: int, scan: Scan) -> tuple[Output, ...]:
        if not self.core.scan(scan):
            return ()
        self.scan_ns = stamp_ns
        return (Output('landmarks', stamp_ns, len(self.core)),)
