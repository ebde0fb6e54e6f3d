# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stages as a user would write them in a file, for the option --stage."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

import ratslam_ros as rs
from ratslam_ros.core.common.state import State
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.pipeline.commands import Reset


class Brightness:
    """Counts images and actions, and adds up the brightness of the images."""

    NAME: ClassVar[str] = 'brightness'
    WRITES: ClassVar[tuple[str, ...]] = ()

    def __init__(self, config: rs.Config) -> None:
        self.counts = np.zeros(2, np.int64)

    def readers(self) -> dict[str, Any]:
        return {'command': self._obey, 'image': self._see, 'action': self._note}

    def _obey(self, stamp_ns: int, command: Any) -> None:
        if isinstance(command, Reset):
            self.counts = np.zeros(2, np.int64)

    def _see(self, stamp_ns: int, image: PreparedImage) -> None:
        self.counts[0] += int(image.pixels.sum())

    def _note(self, stamp_ns: int, action: Any) -> None:
        self.counts[1] += 1

    def state(self) -> State:
        return {'counts': self.counts.copy()}

    def restore(self, state: State) -> None:
        self.counts = np.array(state['counts'])


class Other(Brightness):
    """Has the name of another stage of the user."""
