# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Appearance: layers, colours, theme and camera; and help."""

from __future__ import annotations

import sys
from functools import partial

import numpy as np

from ratslam_ros.history.run_state import RunState
from ratslam_ros.viewer.panels.desk import Desk, assign, put
from ratslam_ros.viewer.panels.html import ORANGE, block, dim, legend, mark, strong
from ratslam_ros.viewer.scene import COLOURINGS


class AppearancePanel:
    """What the map shows, and how."""

    def __init__(self, desk: Desk) -> None:
        self._desk, gui, scene = desk, desk.gui, desk.scene
        self.colouring = gui.add_dropdown(
            'Colour by', COLOURINGS, initial_value=scene.colouring,
            hint='What the colours of experiences and links stand for.',
        )
        self.legend = gui.add_html('')
        self.detail = gui.add_html('', visible=False)
        self.overview = gui.add_button(
            'Show the whole map', hint='Move the view back to where all is seen. (O)'
        )
        self.full = gui.add_checkbox(
            'Full detail', False,
            hint='Draw large maps completely: smooth with a graphics card, slow without.',
        )
        self.follow = gui.add_checkbox(
            'Follow robot', False, hint='The view moves along with the robot. (F)'
        )
        self.dark = gui.add_checkbox('Dark theme', scene.dark, hint='Colours for dark rooms. (T)')
        with gui.add_folder('Layers'):
            self.layers = {
                layer: gui.add_checkbox(layer.capitalize(), True, hint=f'Show or hide: {layer}.')
                for layer in scene.layers
            }
        self._robot: np.ndarray | None = None
        self._limit = scene.limit
        desk.on_click(self.overview, scene.look_at_all)
        desk.on_change(self.colouring, partial(setattr, scene, 'colouring'))
        desk.on_change(self.dark, self.set_dark)
        desk.on_change(self.full, self._draw_fully)
        for layer, box in self.layers.items():
            desk.on_change(box, partial(scene.show, layer))
        self.set_dark(scene.dark)

    def update(self, state: RunState) -> None:
        """Show the legend, and move the view along with the robot."""
        scene = self._desk.scene
        put(self.legend, 'content', block(strong('Legend'), legend(scene.legend())))
        put(self.detail, 'visible', bool(scene.detail))
        put(self.detail, 'content', block(f'{mark("▲", ORANGE)} {dim(scene.detail)}'))
        robot = None if state.pose is None else np.array([*state.pose.pose[:2], 0.0])
        if self.follow.value and robot is not None and self._robot is not None:
            moved = robot - self._robot
            if moved.any():
                self._move_views(moved)
        self._robot = robot

    def set_dark(self, dark: bool) -> None:
        """Choose the dark or the light theme."""
        assign(self.dark, dark)
        self._desk.scene.dark = dark
        self._desk.gui.configure_theme(
            dark_mode=dark, show_logo=False, show_share_button=False, control_width='medium'
        )

    def _draw_fully(self, on: bool) -> None:
        self._desk.scene.limit = sys.maxsize if on else self._limit

    def _move_views(self, moved: np.ndarray) -> None:
        for client in self._desk.server.get_clients().values():
            if client.camera.update_timestamp:  # 0 until the page has sent its view
                # viser moves the point looked at along.
                client.camera.position = np.asarray(client.camera.position) + moved
