# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The panels beside the map."""

from __future__ import annotations

from ratslam_ros.history.run_state import RunState
from ratslam_ros.viewer.panels.appearance import AppearancePanel
from ratslam_ros.viewer.panels.camera import CameraPanel
from ratslam_ros.viewer.panels.cells import CellsPanel
from ratslam_ros.viewer.panels.desk import Desk, assign
from ratslam_ros.viewer.panels.drive import DrivePanel
from ratslam_ros.viewer.panels.export import ExportPanel
from ratslam_ros.viewer.panels.parameters import ParametersPanel
from ratslam_ros.viewer.panels.selection import SelectionPanel
from ratslam_ros.viewer.panels.shortcuts import Shortcut, add_shortcuts, help_html
from ratslam_ros.viewer.panels.time_control import TimeControl

LEFT_WIDTH_PX, RIGHT_WIDTH_PX = 290, 350
"""Widths of the panels; at 1280 px they leave half of the page to the map."""

MANY_VIEWS = 10
"""Number of views of a long step."""


class Panels:
    """All panels: left what the robot perceives, right what the user can do."""

    def __init__(self, desk: Desk) -> None:
        self.desk, gui = desk, desk.gui
        self._source = desk.playback.source
        gui.set_panel_label('RatSLAM')
        left = gui.add_panel()
        with left.add_tab('Camera and match'):
            self.camera = CameraPanel(desk)
        with left.add_tab('Pose cells'):
            self.cells = CellsPanel(desk)
        left.dock_left()
        left.set_width(LEFT_WIDTH_PX)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(RIGHT_WIDTH_PX)
        self.time = TimeControl(desk)
        tabs = gui.add_tab_group()
        with tabs.add_tab('Map'):
            self.appearance = AppearancePanel(desk)
        select = tabs.add_tab('Select')
        with select:
            self.selection = SelectionPanel(desk)
        with tabs.add_tab('Drive'):
            self.drive = DrivePanel(desk, self.selection)
        with select:
            self.drive.add_go_buttons('Send robot', order=self.selection.text.order + 0.5)
        with tabs.add_tab('Parameters'):
            self.parameters = ParametersPanel(desk)
        shortcuts = self._shortcuts()
        self.commands = add_shortcuts(desk, shortcuts)
        with tabs.add_tab('Help'):
            self.export = ExportPanel(desk)
            self.help = gui.add_html(help_html(shortcuts))

    def update(self, state: RunState) -> None:
        """Show a state; called by the loop after the scene has been updated."""
        self.desk.updates += 1
        if self.desk.playback.source is not self._source:
            self._source = self.desk.playback.source
            self.selection.clear()
            self.camera.forget()
        self.time.update(state)
        self.camera.update(state)
        self.cells.update(state)
        self.appearance.update(state)
        self.selection.update(state)
        self.drive.update(state)
        self.parameters.update(state)

    def _shortcuts(self) -> list[Shortcut]:
        playback, appearance = self.desk.playback, self.appearance

        return [
            # A tab that has the focus keeps the space key to itself.
            Shortcut('K', 'Play or pause', playback.toggle),
            Shortcut('space', 'Play or pause, unless a tab has the focus', playback.toggle),
            Shortcut('L', 'Next view', lambda: playback.step(1)),
            Shortcut('J', 'Previous view', lambda: playback.step(-1)),
            Shortcut('L', f'{MANY_VIEWS} views on', lambda: playback.step(MANY_VIEWS), 'shift'),
            Shortcut('J', f'{MANY_VIEWS} views back', lambda: playback.step(-MANY_VIEWS), 'shift'),
            Shortcut('home', 'Begin', lambda: playback.seek(playback.begin_ns)),
            Shortcut('end', 'End, or live', playback.follow),
            Shortcut('pageup', 'Faster', lambda: self.time.faster(1)),
            Shortcut('pagedown', 'Slower', lambda: self.time.faster(-1)),
            Shortcut('O', 'Show the whole map', self.desk.scene.look_at_all),
            Shortcut(
                'F', 'Follow the robot, or not',
                lambda: assign(appearance.follow, not appearance.follow.value),
            ),
            Shortcut(
                'T', 'Dark or light theme', lambda: appearance.set_dark(not appearance.dark.value)
            ),
            Shortcut('X', 'Clear the selection', self.selection.clear),
            Shortcut('G', 'Go to the selected point', self.drive.go_here),
            Shortcut('C', 'Cancel all goals', self.drive.cancel),
        ]
