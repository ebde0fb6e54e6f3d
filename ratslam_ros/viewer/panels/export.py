# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Export: a screenshot of the map, and a recording of the run."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ratslam_ros.history.run_state import NS_PER_S
from ratslam_ros.viewer.panels.desk import Desk
from ratslam_ros.viewer.panels.texts import time_text
from ratslam_ros.viewer.run_source import Answer, RunSource

RENDER_TIMEOUT_S = 20.0
"""Time after which a browser counts as unable to draw a picture; software rendering is slow."""


class ExportPanel:
    """Buttons that give the user a file."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self.screenshot = desk.gui.add_button(
            'Screenshot (PNG)', hint='Download a picture of the map as it is shown.'
        )
        self.recording = desk.gui.add_button(
            'Recording (HTML)',
            hint='Download the whole run as an animation: one file that any browser plays, '
            'without a network. It takes up to a minute.',
        )
        self.screenshot.on_click(lambda event: self._start(event.client, self._draw))
        self.recording.on_click(lambda event: self._start(event.client, self._record))

    def _start(self, client: Any, act: Callable[[Any], None]) -> None:
        if client is not None:
            self._desk.post(lambda: act(client))

    def _draw(self, client: Any) -> None:
        """Have a browser draw; its answer comes through viser, so the loop must not wait."""
        playback = self._desk.playback
        at_s = (playback.cursor_ns - playback.begin_ns) / NS_PER_S
        name = file_name(f'{playback.source.title} {time_text(at_s)}', '.png')
        background = self._desk.scene.background
        self._desk.ask('screenshot', lambda: send_screenshot(client, name, background))

    def _record(self, client: Any) -> None:
        source, scene = self._desk.playback.source, self._desk.scene
        name = file_name(source.title, '.html')
        dark, colouring = scene.dark, scene.colouring
        self.recording.disabled = True

        def answered(answer: Answer) -> None:
            self.recording.disabled = False

        self._desk.ask(
            'recording', lambda: send_recording(client, source, name, dark, colouring), answered
        )


def file_name(title: str, suffix: str) -> str:
    """Return the name of a file, of characters that every system permits."""
    return (re.sub(r'[^A-Za-z0-9.-]+', '-', title).strip('-.') or 'run') + suffix


def send_screenshot(client: Any, name: str, background: tuple[int, int, int]) -> Answer:
    """Have a browser draw its view of the map and download it as PNG.

    The browser draws without the background, before which the colours of a theme are readable.
    """
    import cv2

    camera = client.camera
    picture = client.get_render(
        camera.image_height, camera.image_width, transport_format='png', timeout=RENDER_TIMEOUT_S
    )
    opacity = picture[:, :, 3:] / 255.0
    rgb = np.rint(picture[:, :, :3] * opacity + np.array(background) * (1.0 - opacity))
    ok, data = cv2.imencode('.png', np.ascontiguousarray(rgb[:, :, ::-1].astype(np.uint8)))
    if not ok:
        return Answer(False, f'a picture of {picture.shape} could not be encoded')
    client.send_file_download(name, data.tobytes(), save_immediately=True)
    return Answer(True, name)


def send_recording(
    client: Any, source: RunSource, name: str, dark: bool, colouring: str
) -> Answer:
    """Write a run as one HTML file and have a browser download it."""
    from ratslam_ros.viewer.export import export_html

    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        exported = export_html(source, path, dark=dark, colouring=colouring)
        client.send_file_download(name, path.read_bytes(), save_immediately=True)
    return Answer(True, f'{name}: {exported.size / 1e6:.1f} MB, {exported.frames} frames')
