# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stage visual_odometry: images to odometry."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.core.vision.visual_odometry import VisualOdometry
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.pipeline.commands import (
    Command,
    Configure,
    NewSession,
    Relocated,
    Reset,
    SetFieldOfView,
)
from ratslam_ros.pipeline.stage import OF_HOST, Output, Reader


class VisualOdometryStage(Saved):
    """Estimates the motion of the robot between successive images."""

    SAVED: ClassVar[tuple[Field, ...]] = (
        Field('core', 'core', VisualOdometry),
        Field('fov_deg', 'fov_deg', nullable=True, optional=True),
        Field('has_seen', '_has_seen', bool, of_session=True, optional=True),
        Field('last_ns', '', int, nullable=True, of_session=True, optional=True), *OF_HOST,
    )

    NAME: ClassVar[str] = 'visual_odometry'
    WRITES: ClassVar[tuple[str, ...]] = ('odometry',)

    def __init__(self, config: Config) -> None:
        self._config = config.visual_odometry
        self.core = VisualOdometry(self._config)
        self.fov_deg: float | None = None
        """Horizontal field of view of the camera by its calibration, None if it is unknown."""
        self._has_seen = False
        self.estimate: Odometry | None = None
        """Last estimate, whose conversion to a message and back is what the stream contains."""

    def readers(self) -> dict[str, Reader]:
        """Return the readers."""
        return {'command': self._obey, 'image': self._see}

    def _obey(self, stamp_ns: int, command: Command) -> None:
        match command:
            case Configure():
                self._config = command.config.visual_odometry
                self.core.reconfigure(self._config)
            case SetFieldOfView():
                self.fov_deg = command.fov_deg
                self.core.set_field_of_view(command.fov_deg)
            case Reset():
                self.core = VisualOdometry(self._config)
                if self.fov_deg is not None:
                    self.core.set_field_of_view(self.fov_deg)
            case NewSession() | Relocated():
                self.core.restart()

    def _see(self, stamp_ns: int, image: PreparedImage | None) -> tuple[Output, ...]:
        if image is None:
            return ()
        try:
            odometry = self.core.estimate(stamp_ns, image.pixels, image.profiles)
        except UnusableParameter as error:
            self._unusable(error)
            return ()
        self._has_seen = True
        self.estimate = odometry
        if odometry is None:
            return ()
        return (Output('odometry', stamp_ns, odometry.as_received()),)

    def prepare(self, image: PreparedImage) -> PreparedImage:
        """Return the image with its profiles."""
        return replace(image, profiles=self.core.profiles(image.pixels))

    def _unusable(self, error: UnusableParameter) -> None:
        """Skip an image of a size that no window fits, except for the first."""
        if not self._has_seen:
            raise error

    def _restored(self, state: State) -> None:
        self._has_seen = state.get('has_seen', True)
