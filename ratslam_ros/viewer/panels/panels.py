# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The panels beside the map."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ratslam_ros.history.run_state import RunState
from ratslam_ros.viewer.panels.camera import CameraPanel
from ratslam_ros.viewer.panels.desk import Desk, Post, Scene
from ratslam_ros.viewer.panels.time_control import TimeControl
from ratslam_ros.viewer.playback import Playback
from ratslam_ros.viewer.run_source import Controls, RunSource

if TYPE_CHECKING:
    import viser

LEFT_WIDTH_PX, RIGHT_WIDTH_PX = 290, 340
"""Widths of the panels; at 1280 px they leave half of the page to the map."""


class Panels:
    """All panels: left what the robot perceives, right what the user can do."""

    def __init__(
        self, server: viser.ViserServer, playback: Playback, scene: Scene, source: RunSource,
        controls: Controls, post: Post,
    ) -> None:  # fmt: skip
        self._desk = desk = Desk(server, playback, scene, controls, post)
        gui = server.gui
        gui.set_panel_label('RatSLAM')
        left = gui.add_panel()
        with left.add_tab('Camera and match'):
            self.camera = CameraPanel(desk)
        left.dock_left()
        left.set_width(LEFT_WIDTH_PX)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(RIGHT_WIDTH_PX)
        self.time = TimeControl(desk)

    def update(self, state: RunState) -> None:
        """Show a state; called by the loop after the scene has been updated."""
        self._desk.updates += 1
        self.time.update(state)
        self.camera.update(state)
