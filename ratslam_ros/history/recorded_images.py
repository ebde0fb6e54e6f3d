# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Images of a recording by their stamp."""

from __future__ import annotations

import threading
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ratslam_ros.errors import RatslamError
from ratslam_ros.history.file import HistoryMeta
from ratslam_ros.images import EncodedImage, Image, Pixels, UndecodableImage
from ratslam_ros.recordings import ImageEvent, Recording, Selection, open_recording
from ratslam_ros.recordings.video import Video

JPEG_QUALITY = 80
"""Quality of images that are shown one at a time; artefacts are hardly visible."""

REDUCED = {
    1: cv2.IMREAD_COLOR, 2: cv2.IMREAD_REDUCED_COLOR_2, 4: cv2.IMREAD_REDUCED_COLOR_4,
    8: cv2.IMREAD_REDUCED_COLOR_8,
}
"""Flags by which the decoder of JPEG reduces an image, in a fraction of the time."""

MAX_JPEG_PX = 65500
"""Largest side of an image that libjpeg writes."""

WINDOW_NS = 500_000_000
"""Deviation of the delay between stamp and recording time for which an image is looked for."""

CACHE_COUNT = 32
"""Number of images that are kept, such as those of a selected loop closure."""

MAX_VIDEO_S = 600.0
"""Longest video from which images are read: OpenCV cannot seek exactly, and decodes all frames
from the start, at about 500 per second."""


class RecordedImages:
    """Random access to the images of a recording; a recording that is missing has none."""

    def __init__(self, meta: HistoryMeta) -> None:
        """Prepare to read; the recording is opened at the first request."""
        self._meta = meta
        self._lock = threading.Lock()
        self._recording: Recording | None = None
        self._is_missing = not (meta.recording and meta.image_topic)
        self._delay_ns = 0
        self._cached = lru_cache(CACHE_COUNT)(self._read)

    @property
    def problem(self) -> str:
        """Why images cannot be read from the recording, '' if they can."""
        path = Path(self._meta.recording)
        if self._meta.recording and self._meta.image_topic and not path.exists():
            return (
                f'the recording {path} is not there any more: small images of the history are '
                'shown'
            )
        return ''

    def at(self, stamp_ns: int) -> bytes | None:
        """Return the image with exactly this stamp as JPEG, None if it cannot be read."""
        with self._lock:
            if self._is_missing:
                return None
            try:
                return self._cached(stamp_ns)
            except (RatslamError, OSError):
                self._is_missing = True
                return None

    def close(self) -> None:
        """Close the recording."""
        with self._lock:
            if self._recording is not None:
                self._recording.close()
                self._recording = None
            self._is_missing = True

    def _read(self, stamp_ns: int) -> bytes | None:
        selection = Selection(self._meta.image_topic, None, None)
        if self._recording is None:
            self._recording = open_recording(
                self._meta.recording, images_rate_hz=self._meta.images_rate_hz
            )
            length_s = (self._recording.end_ns - self._recording.start_ns) * 1e-9
            if isinstance(self._recording, Video) and length_s > MAX_VIDEO_S:
                self._is_missing = True
                return None
            for event in self._recording.events(selection):
                # Stamps may be of another clock than the recording times.
                self._delay_ns = event.log_ns - event.stamp_ns
                break
        log_ns = stamp_ns + self._delay_ns
        for event in self._recording.read_events(
            selection, log_ns - WINDOW_NS, log_ns + WINDOW_NS
        ):
            if event.stamp_ns == stamp_ns and isinstance(event, ImageEvent):
                return jpeg_of(event.image)
        return None


def jpeg_of(image: Image, width_px: int | None = None, quality: int = JPEG_QUALITY) -> bytes:
    """Return an image as JPEG.

    Args:
        image: the image.
        width_px: width to which a wider image is reduced; None for its own.
        quality: quality of the JPEG, 0 to 100. Smaller JPEG images keep their bytes.

    Raises:
        UndecodableImage: the image cannot be decoded.
    """
    data = b''
    if isinstance(image, EncodedImage) and not image.is_depth:
        data = bytes(memoryview(image.data))
    width = _jpeg_width(data)
    if width and (width_px is None or width <= width_px):
        return data
    pixels: Any = None
    if width and width_px is not None:
        factor = max((f for f in REDUCED if width >= f * width_px), default=1)
        with suppress(cv2.error):  # Its size is above the limit; the usual decoder reports it.
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), REDUCED[factor])
    if pixels is None:
        pixels = image.bgr()
    return encoded_jpeg(np.asarray(pixels, np.uint8), width_px, quality)


def encoded_jpeg(pixels: Pixels, width_px: int | None, quality: int) -> bytes:
    """Return pixels, (H, W) or (H, W, 3) BGR, as JPEG of at most a width."""
    height, width = pixels.shape[:2]
    if width_px is not None and width > width_px:
        size = width_px, max(round(height * width_px / width), 1)
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
    if max(pixels.shape[:2]) > MAX_JPEG_PX:
        raise UndecodableImage(
            f'an image of {width} x {height} pixels cannot be written as JPEG; expected at most '
            f'{MAX_JPEG_PX} pixels on each side'
        )
    _, data = cv2.imencode('.jpg', pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return data.tobytes()


def _jpeg_width(data: bytes) -> int:
    """Return the width in the header of a JPEG, 0 if there is none."""
    at = 2
    while data[:3] == b'\xff\xd8\xff' and at + 9 < len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        # SOF0 to SOF15 give the size, but for the tables DHT, JPG and DAC.
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return int.from_bytes(data[at + 7 : at + 9], 'big')
        at += 2 + int.from_bytes(data[at + 2 : at + 4], 'big')
    return 0
