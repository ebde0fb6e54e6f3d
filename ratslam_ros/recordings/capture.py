# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Wrapper of cv2.VideoCapture that raises this project's errors."""

from __future__ import annotations

import math
import os

import cv2
import numpy as np

from ratslam_ros.errors import UnusableInput
from ratslam_ros.images import Pixels
from ratslam_ros.limits import MAX_PIXELS


class Capture:
    """The frames of a video, a camera or a stream."""

    def __init__(self, source: str | int, refusal: str) -> None:
        """Open the source.

        Args:
            source: what cv2.VideoCapture takes.
            refusal: error if OpenCV cannot open it.

        Raises:
            UnusableInput: it cannot be opened, or its frames are too large.
        """
        # Silence FFmpeg's own log lines: this class reports errors in one line.
        os.environ.setdefault('OPENCV_FFMPEG_LOGLEVEL', '-8')
        self._capture = cv2.VideoCapture(source)
        if not self._capture.isOpened():
            self._capture.release()
            raise UnusableInput(refusal)
        width = int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        if width * height > MAX_PIXELS:
            self._capture.release()
            raise UnusableInput(
                f'{source} has frames of {width} x {height} pixels; expected at most {MAX_PIXELS} '
                'pixels; scale it down'
            )
        rate = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.rate_hz = rate if math.isfinite(rate) and 0.0 < rate <= 10_000.0 else 0.0
        frames = float(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self.frames = int(frames) if math.isfinite(frames) and 0 < frames < 1e9 else 0

    def grab(self) -> bool:
        """Advance to the next frame; return False at the end."""
        return bool(self._capture.grab())

    def time_ns(self) -> int:
        """Return the presentation time of the current frame; 0 if unknown."""
        time_ms = float(self._capture.get(cv2.CAP_PROP_POS_MSEC))
        return round(time_ms * 1e6) if math.isfinite(time_ms) else 0

    def frame(self) -> Pixels:
        """Decode the current frame as (H, W, 3) uint8 in BGR order."""
        return np.asarray(self._capture.retrieve()[1], np.uint8)

    def close(self) -> None:
        """Close the source."""
        self._capture.release()
