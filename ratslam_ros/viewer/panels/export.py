# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Export: a screenshot of the map, and further exports that the app offers."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from ratslam_ros.viewer.panels.desk import Desk
from ratslam_ros.viewer.panels.html import block, dim
from ratslam_ros.viewer.panels.texts import time_text
from ratslam_ros.viewer.run_source import Answer

if TYPE_CHECKING:
    import viser

RENDER_TIMEOUT_S = 20.0
"""Time after which a browser counts as unable to draw a picture; software rendering is slow."""


class ExportPanel:
    """Buttons that give the user a file."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self.screenshot = desk.gui.add_button(
            'Screenshot (PNG)', hint='Download a picture of the map as it is shown.'
        )
        self.screenshot.on_click(lambda event: self._start(event.client))
        desk.gui.add_html(
            block(dim('One file to show to others: ratslam view RUN --export FILE.html'))
        )

    def _start(self, client: viser.ClientHandle | None) -> None:
        """Have a browser draw; it answers through the thread of viser, so the loop must not."""
        if client is not None:
            self._desk.post(
                lambda: self._desk.ask('screenshot', lambda: send_screenshot(client, self._name()))
            )

    def _name(self) -> str:
        playback = self._desk.playback
        at_s = (playback.cursor_ns - playback.begin_ns) / 1e9
        return file_name(playback.source.title, time_text(at_s))


def file_name(title: str, when: str) -> str:
    """Return the name of a picture, of characters that every system permits."""
    return re.sub(r'[^A-Za-z0-9.-]+', '-', f'{title} {when}').strip('-.') + '.png'


def send_screenshot(client: Any, name: str) -> Answer:
    """Have a browser draw its view of the map and download it as PNG."""
    import cv2

    camera = client.camera
    picture = client.get_render(
        camera.image_height, camera.image_width, transport_format='png', timeout=RENDER_TIMEOUT_S
    )
    ok, data = cv2.imencode('.png', np.ascontiguousarray(picture[:, :, [2, 1, 0, 3]]))
    if not ok:
        return Answer(False, f'a picture of {picture.shape} could not be encoded')
    client.send_file_download(name, data.tobytes(), save_immediately=True)
    return Answer(True, name)
