# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A recording: its topics, what to use of them, and its events in order of time."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings.events import Calibration, Event
from ratslam_ros.recordings.selection import select
from ratslam_ros.recordings.stream import Warnings
from ratslam_ros.recordings.topics import Selection, Topic


class Recording(ABC):
    """Anything with images or templates in it, and perhaps odometry and scans."""

    path: Path
    name: str
    kind: str
    topics: tuple[Topic, ...]
    start_ns: int
    end_ns: int

    def __init__(self, path: Path, warnings: Warnings | None = None) -> None:
        self.path = path
        name = path.resolve().name
        self.name = name if path.is_dir() else Path(name.removesuffix('.zstd')).stem
        self._warnings = warnings or Warnings()
        self.skipped = 0
        """Messages that could not be decoded, among the events asked for so far."""

    @property
    def warnings(self) -> list[str]:
        """What the user should know; grows while the events are read."""
        return self._warnings.texts

    def select(
        self,
        image_topic: str | None = None,
        odom_topic: str | None = None,
        visual_odometry: bool = False,
        scan_topic: str | None = None,
        scans: bool = False,
    ) -> Selection:
        """Choose the topics, guessing those not named; raises UnusableInput if it cannot.

        ``scans``: one with scans too, if there is one; without, none is read.
        """
        return select(self, image_topic, odom_topic, visual_odometry, scan_topic, scans)

    def events(
        self, selection: Selection, start_s: float = 0.0, duration_s: float | None = None
    ) -> Iterator[Event]:
        """Yield the selected events in the order of their recording.

        ``start_s`` and ``duration_s`` are seconds of the recording's own time, from its start.
        Raises UnusableInput where they leave nothing.
        """
        length_s = (self.end_ns - self.start_ns) / 1e9
        if not 0.0 <= start_s <= length_s:
            raise UnusableInput(
                f'the start at {start_s:g} s is outside of {self.path}: expected 0 to '
                f'{length_s:.3f} s'
            )
        if duration_s is not None and not duration_s > 0.0:
            raise UnusableInput(f'the duration is {duration_s:g} s: expected more than 0 s')
        start_ns = self.start_ns + round(start_s * 1e9)
        stop_ns = self.end_ns + 1
        if duration_s is not None and duration_s < length_s:
            stop_ns = min(stop_ns, start_ns + round(duration_s * 1e9))
        return self._events(selection, start_ns, stop_ns)

    def calibration(self, selection: Selection) -> Calibration | None:
        """Return what is recorded of the camera of the selected images, None if nothing is."""
        return None

    def is_depth(self, topic: Topic) -> bool:
        """Tell a depth image topic, by its first message, from one of a camera."""
        return False

    def is_empty(self, topic: Topic) -> bool:
        """Tell whether a topic has no messages, by a look where the counts are not stored."""
        return topic.count == 0

    def count(self) -> dict[str, int]:
        """Count the messages of each topic, by a scan where that was not stored."""
        return {topic.name: topic.count or 0 for topic in self.topics}

    @abstractmethod
    def _events(self, selection: Selection, start_ns: int, stop_ns: int) -> Iterator[Event]:
        """Yield the selected events with start_ns <= log_ns < stop_ns."""

    def close(self) -> None:  # noqa: B027 - not every kind holds files open
        """Let go of the files."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
