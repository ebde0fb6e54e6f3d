# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stand-in for ``viewer.scene`` until it is merged: the experiences as points."""

from __future__ import annotations

from typing import Any

import numpy as np

from ratslam_ros.history.run_state import RunState

COLOURINGS = ('plain',)


class RunScene:
    """Draws the experiences."""

    layers = ('map',)
    colouring = 'plain'
    detail = ''
    dark = False

    def __init__(self, server: Any) -> None:
        self._points = server.scene.add_point_cloud(
            '/map', np.zeros((0, 3), np.float32), np.zeros(3, np.uint8), point_size=0.15
        )
        self._version = -1

    def update(self, state: RunState) -> None:
        """Draw a state."""
        if state.map.version == self._version:
            return
        self._version = state.map.version
        poses = np.nan_to_num(state.map.poses).astype(np.float32)
        self._points.points = poses * np.array([1, 1, 0], np.float32)

    def show(self, layer: str, on: bool) -> None:
        """Show or hide a layer."""
        self._points.visible = on

    def pick(self, origin: Any, direction: Any, state: RunState) -> Any:
        """Return nothing."""

    def select(self, pick: Any) -> None:
        """Do nothing."""

    def legend(self) -> Any:
        """Return no colours."""
        return []
