# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A video file as a recording of frames with their presentation times."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from ratslam_ros.errors import UnusableInput
from ratslam_ros.images import Frame
from ratslam_ros.recordings.capture import Capture
from ratslam_ros.recordings.events import Event, ImageEvent
from ratslam_ros.recordings.recording import Recording
from ratslam_ros.recordings.topics import VIDEO, Selection, Topic

VIDEO_SUFFIXES = frozenset({
    '.mp4', '.avi', '.mov', '.mkv', '.webm', '.m4v', '.mpg', '.mpeg', '.ogv', '.wmv', '.flv',
    '.ts', '.mjpeg', '.mjpg', '.h264', '.h265', '.3gp',
})
FRAMES_TOPIC = 'images'


class Video(Recording):
    """The frames of a video file, with times from 0."""

    kind = 'video'

    def __init__(self, path: Path, rate_hz: float) -> None:
        """Read the frame rate and the number of frames.

        Args:
            path: the video file.
            rate_hz: assumed frame rate if the file does not state one.

        Raises:
            UnusableInput: OpenCV cannot decode the file.
        """
        super().__init__(path)
        with closing(_opened(path)) as capture:
            frames, rate = capture.frames, capture.rate_hz
            if not capture.grab():
                raise UnusableInput(
                    f'no frame of {path} can be decoded: expected a video that OpenCV can decode; '
                    f'convert it, for instance with "ffmpeg -i {path.name} converted.mp4"'
                )
            if not frames:  # The container does not store the number of frames.
                frames = 1
                while capture.grab():
                    frames += 1
        if not rate:
            rate = rate_hz
            self._warnings.add(
                f'{path.name} does not state its frame rate: {rate:g} Hz is assumed'
            )
        self._period_ns = 1e9 / rate
        self.start_ns, self.end_ns = 0, round((frames - 1) * self._period_ns)
        self.topics = (Topic(FRAMES_TOPIC, VIDEO, frames),)
        self._expected = frames

    def read_events(self, selection: Selection, start_ns: int, stop_ns: int) -> Iterator[Event]:
        """Yield the selected events with start_ns <= log_ns < stop_ns."""
        with closing(_opened(self.path)) as capture:
            index, before_ns = 0, -1
            while capture.grab():
                # The rate may vary, so use the frame's own time; some containers have none.
                stamp_ns = capture.time_ns()
                if stamp_ns <= before_ns:
                    stamp_ns = max(round(index * self._period_ns), before_ns + 1)
                index, before_ns = index + 1, stamp_ns
                if stamp_ns >= stop_ns and stop_ns <= self.end_ns:
                    return
                if stamp_ns >= start_ns:
                    yield ImageEvent(stamp_ns, stamp_ns, Frame(capture.frame()))
            # The number of frames may be computed from the duration, which may count from before
            # the first frame (Matroska), and the rate may vary.
            if index < self._expected and before_ns < self.end_ns - self._period_ns:
                self._warnings.add(
                    f'{self.path.name} is truncated, damaged, or begins late: read {index} of '
                    f'{self._expected} frames, up to {before_ns / 1e9:.1f} s'
                )


def _opened(path: Path) -> Capture:
    return Capture(str(path), (
        f'{path} cannot be opened as a video: expected one that OpenCV can decode; '
        f'convert it, for instance with "ffmpeg -i {path.name} converted.mp4"'
    ))
