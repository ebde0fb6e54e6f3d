# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run as a single HTML file: an animation that needs neither Python nor a network."""

from __future__ import annotations

import base64
import json
import math
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.files.text import write_durably
from ratslam_ros.history.recorded_images import jpeg_of
from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.images import EncodedImage, UndecodableImage
from ratslam_ros.viewer.panels.html import BLUE, ORANGE, css
from ratslam_ros.viewer.panels.texts import decision_text, match_text, time_text
from ratslam_ros.viewer.rendering import SCRIPT, with_elements
from ratslam_ros.viewer.run_source import RunSource
from ratslam_ros.viewer.server import ViewServer

if TYPE_CHECKING:
    from viser import ViserServer

DURATION_S = 30.0
"""Time that the animation takes."""

FRAMES_PER_S = 10.0
"""Rate of the animation, which is that of the live view."""

MAX_BYTES = 20_000_000
"""Largest file: most mail servers and chat rooms accept it, and browsers open it at once."""

MIN_FRAMES, MAX_FRAMES = 20, 36_000
"""Fewest frames of an animation, for which the file may become larger than the limit, and most:
those of an hour. A longer animation shows each of them for a longer time."""

ATTEMPTS = 4
"""Number of times that a run is recorded with fewer frames until the file is small enough."""

MARGIN = 0.9
"""Part of the limit that is aimed at, because the size is not quite proportional to the frames."""

IMAGE_WIDTH_PX, JPEG_QUALITY = 320, 70
"""Largest width of the camera images, and their quality; the page shows them 242 px wide."""

FIELD_OF_VIEW, ELEVATION = math.radians(45), math.radians(72)
"""Vertical field of view of the camera, and its direction above the floor."""

ASPECT, COVERED = 1.75, 0.22
"""Width of a usual page relative to its height, and the part of it that the overlay covers."""

HEIGHT = 0.4
"""Height of the box of the pose cells on the floor, relative to the depth of it all."""

OVERLAY = Path(__file__).with_name('overlay.html')

Reals = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Exported:
    """What has been written: its size in bytes, and the number of frames."""

    size: int
    frames: int


def export_html(
    source: RunSource,
    path: Path,
    *,
    duration_s: float = DURATION_S,
    max_bytes: int = MAX_BYTES,
    dark: bool = False,
    colouring: str | None = None,
) -> Exported:
    """Write a run as an HTML file that plays it.

    Args:
        source: the run, up to its current end.
        path: the file; an existing one is replaced when the new one is complete.
        duration_s: time that the animation takes, in s.
        max_bytes: size that the file should not exceed; it has fewer frames if need be.
        dark: whether to use the dark theme.
        colouring: what colours the experiences, see ``RunScene``; None: what a viewer begins with.

    Raises:
        UnusableInput: the file cannot be written.
    """
    count = round(min(max(MIN_FRAMES, duration_s * FRAMES_PER_S), MAX_FRAMES))
    if source.end_ns <= source.begin_ns:
        count, duration_s = 1, 0.0
    for _ in range(ATTEMPTS):
        content = record_html(source, count, duration_s, dark=dark, colouring=colouring).encode()
        if len(content) <= max_bytes or count <= MIN_FRAMES:
            break
        count = max(MIN_FRAMES, int(count * MARGIN * max_bytes / len(content)))
    write_durably(path, content)
    return Exported(len(content), count)


def record_html(
    source: RunSource,
    count: int,
    duration_s: float,
    *,
    dark: bool = False,
    colouring: str | None = None,
) -> str:
    """Return a run as an HTML page with an animation of ``count`` frames.

    The scene is drawn as for a browser, at stamps at equal distances, and viser records what it
    would send.
    """
    server = ViewServer('127.0.0.1', 0)
    try:
        # Only here, after the server has reported that viser is missing, if it is.
        from viser._messages import RunJavascriptMessage

        from ratslam_ros.viewer.scene import RunScene

        begin_ns, end_ns = source.begin_ns, source.end_ns
        stamps = [begin_ns + (end_ns - begin_ns) * k // (count - 1) for k in range(count - 1)]
        stamps.append(end_ns)
        clock_s = 0.0  # that of the run, so that slow drawing skips nothing
        scene = RunScene(server.viser, map_period_s=0.0, aims=False, clock=lambda: clock_s)
        scene.dark = dark
        if colouring is not None:
            scene.colouring = colouring
        scene.update(source.seek(end_ns))  # so that grid, pose cells and camera suit the whole run
        _aim(server.viser, *scene.area())
        state = source.seek(begin_ns)
        scene.update(state)
        recorder = server.viser.get_scene_serializer()
        overlay = _Overlay(source)
        for number, stamp_ns in enumerate(stamps):
            source.advance(state, stamp_ns)
            clock_s = (stamp_ns - begin_ns) / NS_PER_S
            scene.update(state)
            overlay.add(state, stamp_ns)
            # GUI elements are not recorded, scripts are: they keep the overlay at the same frame.
            recorder._insert_message(RunJavascriptMessage(f'showRunFrame({number})'))
            if count > 1:
                recorder.insert_sleep(duration_s / count)
        legend = [(css(colour), text) for colour, text in scene.legend()]
        elements = overlay.html(legend, dark) + SCRIPT.read_text('utf-8')
        return with_elements(recorder.as_html(dark), elements)
    finally:
        server.stop()


class _Overlay:
    """What is written over the scene: texts, camera images and match errors of every frame."""

    def __init__(self, source: RunSource) -> None:
        self._source = source
        self._begin_ns = source.begin_ns
        self._length = time_text((source.end_ns - source.begin_ns) / NS_PER_S, 0)
        self._closed, self._closed_ns = 0, -1
        self._jpeg = b''
        self._view_ns = -1
        self._frames: list[dict[str, Any]] = []
        self._images: list[str] = []
        self._views: list[tuple[float, float, float, int]] = []

    def html(self, legend: list[tuple[str, str]], dark: bool) -> str:
        """Return the elements that belong at the beginning of the page's head."""
        content = {
            'title': self._source.title, 'notes': list(self._source.notices), 'dark': dark,
            'legend': legend, 'colours': [css(BLUE), css(ORANGE)], 'frames': self._frames,
            'images': self._images, 'views': self._views,
        }
        data = json.dumps(content, ensure_ascii=False, separators=(',', ':'))
        # No text may end the script element that holds the data.
        return OVERLAY.read_text('utf-8').replace('DATA', data.replace('<', '\\u003c'), 1)

    def add(self, state: RunState, stamp_ns: int) -> None:
        """Add the frame that shows a state."""
        self._count_closures(state, stamp_ns)
        self._add_views(state)
        self._add_image(state, stamp_ns)
        seconds = (stamp_ns - self._begin_ns) / NS_PER_S
        view = state.view
        self._frames.append({
            's': round(seconds, 3),
            'time': f'{time_text(seconds, 0)} of {self._length} (min:s)',
            'counts': f'places: {len(state.map)} · links: {state.map.link_count} · '
                      f'loop closures: {self._closed}',
            'decision': '' if view is None else (
                f'{match_text(view)}; {decision_text(view, self._source.required_views)}'
            ),
            'image': len(self._images) - 1,
            'views': len(self._views),
        })

    def _count_closures(self, state: RunState, stamp_ns: int) -> None:
        # A state lists only the latest closures, so they are counted frame by frame.
        self._closed += sum(
            view.stamp_ns > self._closed_ns for view in state.closures if not view.reason
        )
        self._closed_ns = stamp_ns

    def _add_views(self, state: RunState) -> None:
        for view in state.recent:
            if view.stamp_ns > self._view_ns:
                self._view_ns = view.stamp_ns
                seconds = (view.stamp_ns - self._begin_ns) / NS_PER_S
                row = (round(seconds, 2), round(view.error, 4), round(view.threshold, 4))
                self._views.append((*row, int(view.is_new)))

    def _add_image(self, state: RunState, stamp_ns: int) -> None:
        image = state.image
        jpeg = self._source.image_at(stamp_ns) if image is None else image.jpeg
        if jpeg is None or jpeg == self._jpeg:
            return
        self._jpeg = jpeg
        with suppress(UndecodableImage):
            small = jpeg_of(EncodedImage(jpeg), IMAGE_WIDTH_PX, JPEG_QUALITY)
            self._images.append(base64.b64encode(small).decode())


def _aim(viser_server: ViserServer, low: Reals, high: Reals) -> None:
    """Aim the camera so that an area of the floor, and what stands on it, is seen.

    Args:
        viser_server: the server.
        low, high: (2,) corners of the area in m; it is centred beside the overlay.
    """
    centre = np.append((low + high) / 2, 0.0)
    limits = *zip(low, high, strict=True), (0.0, HEIGHT * float(high[1] - low[1]))
    corners = np.array(list(product(*limits))) - centre
    backward = np.array([0.0, -math.cos(ELEVATION), math.sin(ELEVATION)])
    upward = np.array([0.0, math.sin(ELEVATION), math.cos(ELEVATION)])
    tangent = math.tan(FIELD_OF_VIEW / 2)
    tangents = np.array([tangent * ASPECT * (1 - COVERED), tangent])
    beside = np.abs(corners @ np.stack([[1.0, 0.0, 0.0], upward], axis=1))
    distance = float((corners @ backward + (beside / tangents).max(axis=1)).max())
    centre[0] += COVERED * ASPECT * tangent * distance
    camera = viser_server.initial_camera
    camera.fov = FIELD_OF_VIEW
    camera.far = 100 * distance
    camera.look_at = centre
    camera.position = centre + distance * backward
