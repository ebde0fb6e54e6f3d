# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The interface of a recording of any format."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, Self

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings.events import Calibration, Event, LaserFrames
from ratslam_ros.recordings.selection import TopicSource
from ratslam_ros.recordings.stream import Warnings
from ratslam_ros.recordings.topics import Selection

GENERIC_NAMES = frozenset({
    'images', 'image', 'imgs', 'img', 'frames', 'rgb', 'color', 'colour', 'grey', 'data',
    'recording',
})
"""Names of files and folders that do not name a recording; that of a folder above is used."""


class Recording(TopicSource, ABC):
    """A source of images or templates, and optionally of odometry and scans."""

    name: str
    """Name of the file or folder, without suffix; of a folder above if it is a generic name."""
    kind: str
    """Format, such as 'rosbag2 (mcap)'."""
    is_endless: ClassVar[bool] = False
    """Whether events arrive while they are read, until ``stop``; then the duration is 0."""
    start_ns: int
    """Recording time of the first message."""
    end_ns: int
    """Recording time of the last message."""

    def __init__(self, path: Path, warnings: Warnings | None = None) -> None:
        self.path = path
        self.files = [path]
        """Files that it consists of; others may lie beside them, such as results and the map."""
        resolved = path.resolve()
        name = resolved.name
        own = name if path.is_dir() else Path(name.removesuffix('.zstd')).stem
        above = [parent.name for parent in resolved.parents if parent.name]
        names = [name for name in (own, *above) if name.lower() not in GENERIC_NAMES]
        self.name = names[0] if names else own
        self._warnings = warnings or Warnings()
        self.skipped = 0
        """Number of messages that were skipped because they could not be decoded."""

    @property
    def warnings(self) -> list[str]:
        """Problems found, one line each; reading events can add more."""
        return self._warnings.texts

    def warn(self, text: str) -> None:
        """Add a warning for the user, unless it is there already."""
        self._warnings.add(text)

    def events(
        self, selection: Selection, start_s: float = 0.0, duration_s: float | None = None
    ) -> Iterator[Event]:
        """Return an iterator over the selected events in order of recording time.

        Args:
            selection: the topics to read.
            start_s: recording time to start at, in seconds from the start of the recording.
            duration_s: length to read, in seconds; None reads to the end.

        Raises:
            UnusableInput: the start is outside the recording, or the duration is not positive.
        """
        length_s = (self.end_ns - self.start_ns) / 1e9
        if not 0.0 <= start_s <= length_s:
            raise UnusableInput(
                f'the start at {start_s:g} s is outside {self.path}: expected 0 to '
                f'{length_s:.3f} s'
            )
        if duration_s is not None and not duration_s > 0.0:
            raise UnusableInput(f'the duration is {duration_s:g} s: expected more than 0 s')
        start_ns = self.start_ns + round(start_s * 1e9)
        stop_ns = self.end_ns + 1
        if duration_s is not None and duration_s < length_s:
            stop_ns = min(stop_ns, start_ns + round(duration_s * 1e9))
        return self.read_events(selection, start_ns, stop_ns)

    def calibration(self, selection: Selection) -> Calibration | None:
        """Return the calibration of the camera of the selected images, None if not recorded."""
        return None

    def laser_frames(self, selection: Selection) -> LaserFrames | None:
        """Return the frames of the selected scans; None if there are none or they are unknown."""
        return None

    def count(self) -> dict[str, int]:
        """Return the number of messages of each topic."""
        return {topic.name: topic.count or 0 for topic in self.topics}

    @abstractmethod
    def read_events(self, selection: Selection, start_ns: int, stop_ns: int) -> Iterator[Event]:
        """Yield the selected events with start_ns <= log_ns < stop_ns."""

    def stop(self) -> None:
        """End the events soon, if the recording has no end."""

    def close(self) -> None:
        """Close the files, if the format keeps any open."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
