# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stage local_view: images to templates."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import ClassVar

from ratslam_ros.core.common.odometry import Odometry, odometry_from_state, odometry_state
from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.core.config.additions import uses_odometry
from ratslam_ros.core.vision.local_view import UNDECODABLE, EncodedView, LocalView
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.descriptors import encoder_of
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.pipeline.commands import (
    Command,
    Configure,
    NewSession,
    Relocated,
    Reset,
    SetMapping,
)
from ratslam_ros.pipeline.stage import OF_HOST, Output, Reader

ODOMETRY_DELAY_NS = 1_000_000_000
"""Delay of the odometry that a local view follows. Odometry of a later stamp than the image is
therefore at hand, and no image waits for it. Displacements are the same."""


def delayed_ns(stamp_ns: int) -> int:
    """Return where an odometry message is among the stamps of the images."""
    return stamp_ns + ODOMETRY_DELAY_NS


class LocalViewStage(Saved):
    """Matches each image with the learned templates."""

    SAVED = (
        Field('core', 'core', LocalView),
        Field('has_matched', '_has_matched', bool, of_session=True, optional=True),
        Field('ahead', '_ahead', list, optional=True,
              save=lambda ahead: [odometry_state(one) for one in ahead],
              load=lambda rows: [odometry_from_state(one) for one in rows]),
        Field('memory_ns', '', int, of_session=True, optional=True), *OF_HOST,
    )

    NAME: ClassVar[str] = 'local_view'
    WRITES: ClassVar[tuple[str, ...]] = ('template',)

    def __init__(self, config: Config) -> None:
        self._created_with, self._config = config, config.local_view
        self._encoder = encoder_of(self._config)
        self._mapping = True
        self._has_matched = False
        self._begin()

    def _begin(self) -> None:
        config = self._created_with
        self.core = LocalView(config.local_view, self._encoder, config.inputs, config.memory)
        self.core.reconfigure(self._config)
        self.core.mapping = self._mapping
        self._ahead: deque[Odometry] = deque()
        """Odometry that the local view has not followed yet: it does so a second later."""

    def readers(self) -> dict[str, Reader]:
        """Return the readers; odometry is needed to tell look-alikes apart."""
        follow: dict[str, Reader] = (
            {'odometry': self._hold} if uses_odometry(self._config) else {}
        )
        return {'command': self._obey, **follow, 'image': self._match}

    def _obey(self, stamp_ns: int, command: Command) -> None:
        match command:
            case Configure():
                self._config = command.config.local_view
                self.core.reconfigure(self._config)
            case SetMapping():
                self.core.mapping = self._mapping = command.mapping
            case Reset():
                self._begin()
            case NewSession() | Relocated():
                self._relocated()

    def _relocated(self) -> None:
        self._ahead.clear()  # stamps may have jumped back
        self.core.relocated()

    def _hold(self, stamp_ns: int, odometry: Odometry) -> None:
        self._ahead.append(odometry)

    def _match(self, stamp_ns: int, image: PreparedImage | None) -> tuple[Output, ...]:
        while self._ahead and delayed_ns(self._ahead[0].stamp_ns) <= stamp_ns:
            self.core.follow(self._ahead.popleft())
        match = UNDECODABLE
        if image is not None:
            try:
                encoded = image.encoded or self._encoded(image)
                match = self.core.match(image.pixels, stamp_ns, encoded)
                self._has_matched = True
            except UnusableParameter as error:
                self._unusable(error)
        return (Output('template', stamp_ns, match),)

    def prepare(self, image: PreparedImage) -> PreparedImage:
        """Return the image with its view, unless a model is bound to the thread of the stage."""
        if not self.core.encodes_ahead:
            return image
        return replace(image, encoded=self._encoded(image))

    def _encoded(self, image: PreparedImage) -> EncodedView:
        return EncodedView(self.core.encode(image.pixels, image.colour))

    @property
    def wants_colour(self) -> bool:
        """Whether images should have their colour."""
        return self.core.wants_colour

    def _unusable(self, error: UnusableParameter) -> None:
        """Treat an image of a size that no window fits as undecodable, except for the first."""
        if not self._has_matched:
            raise error  # the crop or template does not fit this camera

    def _restored(self, state: State) -> None:
        self._has_matched = state.get('has_matched', True)
