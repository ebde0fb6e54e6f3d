# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The interface of a recording of any format, and the selection of the topics to read.

The selection is automatic if it is unambiguous, and otherwise made by the user.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, Self

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings.events import Calibration, Event, LaserFrames
from ratslam_ros.recordings.stream import Warnings
from ratslam_ros.recordings.topics import (
    IMAGE_TYPES,
    ODOMETRY_TYPES,
    SCAN_TYPES,
    STRING,
    Selection,
    Topic,
)

GENERIC_NAMES = frozenset({
    'images', 'image', 'imgs', 'img', 'frames', 'rgb', 'color', 'colour', 'grey', 'data',
    'recording',
})
"""Names of files and folders that do not name a recording; that of a folder above is used."""

TEMPLATE_NAME = 'local_view/template'


class Recording(ABC):
    """A source of images or templates, and optionally of odometry and scans."""

    name: str
    """Name of the file or folder, without suffix; of a folder above if it is a generic name."""
    kind: str
    """Format, such as 'rosbag2 (mcap)'."""
    topics: tuple[Topic, ...]
    notices: tuple[str, ...] = ()
    """What the user must know of every selection."""
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

    def is_depth(self, topic: Topic) -> bool:
        """Return whether the first image of a topic is a depth image."""
        return False

    def is_empty(self, topic: Topic) -> bool:
        """Return whether a topic has no messages."""
        return topic.count == 0

    def select(
        self,
        image_topic: str | None = None,
        odom_topic: str | None = None,
        visual_odometry: bool = False,
        scan_topic: str | None = None,
        scans: bool = False,
    ) -> Selection:
        """Choose the topics to read.

        Args:
            image_topic: topic with images; None selects the only candidate.
            odom_topic: topic with odometry; None selects the only candidate.
            visual_odometry: ignore recorded odometry.
            scan_topic: topic with scans, or several separated by commas; None selects the only
                candidate.
            scans: whether to read scans at all.

        Raises:
            UnusableInput: a named topic cannot be used, arguments contradict each other, there are
                several candidates, or there are neither images nor templates with odometry.
        """
        notices: list[str] = []
        templates = [
            topic for topic in usable(self, frozenset({STRING}))
            if topic.name.endswith(TEMPLATE_NAME)
        ]
        image = template = odom = None
        lasers: list[Topic] = []
        if image_topic is not None:
            image = _named(self, image_topic, IMAGE_TYPES, 'images', '--image-topic')
        else:
            image = _single(self, image_candidates(self), 'images', '--image-topic')
        if image is None:
            if not templates:
                if depth := usable(self, IMAGE_TYPES):
                    raise UnusableInput(
                        f'{self.path} holds depth images only: expected those of a camera; '
                        f'--image-topic {depth[0].name} uses them all the same'
                    )
                raise UnusableInput(
                    f'{self.path} holds no images: expected a topic of type sensor_msgs/Image or '
                    f'sensor_msgs/CompressedImage; its topics are {_format_topics(self.topics)}'
                )
            template = templates[0]
            notices.append(f'no images: the recorded templates of {template.name} are used')
        elif templates:
            notices.append(
                f'the images of {image.name} are used, not the recorded templates of '
                f'{templates[0].name}'
            )
        if odom_topic is not None and visual_odometry:
            raise UnusableInput(
                f'both the odometry of {odom_topic} and visual odometry are requested: expected '
                'one of them; leave out --odom-topic or --visual-odometry'
            )
        if odom_topic is not None:
            odom = _named(self, odom_topic, ODOMETRY_TYPES, 'odometry', '--odom-topic')
        elif not visual_odometry:
            odom = _single(self, usable(self, ODOMETRY_TYPES), 'odometry', '--odom-topic')
        if odom is None:
            if image is None:
                raise UnusableInput(
                    f'{self.path} holds recorded templates and no images: expected a topic of '
                    'type nav_msgs/Odometry to go with them'
                    + ('; leave out --visual-odometry, which needs images' if visual_odometry
                       else f'; its topics are {_format_topics(self.topics)}')
                )
            notices.append(
                'visual odometry is used, as requested' if visual_odometry
                else 'no odometry topic: visual odometry is used'
            )
        if scan_topic is not None:
            if not scans:
                raise UnusableInput(
                    f'the scans of {scan_topic} are requested, but nothing uses them: set '
                    'experience_map.exp_align_scans, or leave out --scan-topic'
                )
            lasers = [
                _named(self, name, SCAN_TYPES, 'scans', '--scan-topic')
                for name in scan_topic.split(',')
            ]
            if len(set(lasers)) < len(lasers):
                raise UnusableInput(
                    f'--scan-topic {scan_topic} names a topic twice; expected a topic for each '
                    'laser'
                )
        elif scans:
            only = _single(self, usable(self, SCAN_TYPES), 'scans', '--scan-topic')
            lasers = [] if only is None else [only]
        return Selection(
            image.name if image else None,
            odom.name if odom else None,
            template.name if template else None,
            ','.join(laser.name for laser in lasers) or None,
            (*self.notices, *notices),
        )

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

    def stop(self) -> None:  # noqa: B027 - most recordings have an end
        """End the events soon, if the recording has no end."""

    def close(self) -> None:  # noqa: B027 - some formats keep no file open
        """Close the files, if the format keeps any open."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def camera_info_topic(image_topic: str) -> str:
    """Return the camera_info topic in the namespace of an image topic, as image_transport does."""
    return f'{image_topic.removesuffix("/compressed").rpartition("/")[0]}/camera_info'


def image_candidates(recording: Recording) -> list[Topic]:
    """Return the image topics except depth images and compressed duplicates of raw topics."""
    topics = [topic for topic in usable(recording, IMAGE_TYPES) if not recording.is_depth(topic)]
    names = {topic.name for topic in topics}
    return [
        topic for topic in topics
        if not topic.name.endswith('/compressed') or topic.name[: -len('/compressed')] not in names
    ]


def usable(recording: Recording, types: frozenset[str]) -> list[Topic]:
    """Return the topics of some types that can be read and have messages."""
    return [
        topic for topic in recording.topics
        if topic.type in types and topic.problem is None and not recording.is_empty(topic)
    ]


def _named(
    recording: Recording, name: str, types: frozenset[str], what: str, option: str
) -> Topic:
    """Return the topic that the user named, with or without its leading slash."""
    plain = name.lstrip('/')
    topic = next((one for one in recording.topics if one.name.lstrip('/') == plain), None)
    if topic is None:
        problem = 'does not exist'
    elif topic.type not in types:
        problem = f'is of type {topic.type}'
    elif topic.problem is not None:
        problem = f'cannot be decoded ({topic.problem})'
    elif recording.is_empty(topic):
        problem = 'has no messages'
    else:
        return topic
    others = [
        one for one in recording.topics if one.type in types and one.name.lstrip('/') != plain
    ]
    if others:
        several = f'one of {_format_topics(others)}'
        answer = f'{option} {others[0].name}' if len(others) == 1 else several
    else:
        answer = f'the topics are {_format_topics(recording.topics)}'
    raise UnusableInput(
        f'{option} {name} {problem} in {recording.path}: expected a topic with {what}: {answer}'
    )


def _single(recording: Recording, found: list[Topic], what: str, option: str) -> Topic | None:
    if len(found) > 1:
        raise UnusableInput(
            f'{recording.path} holds {len(found)} topics with {what}: expected one; choose with '
            + ' or '.join(f'{option} {topic.name}' for topic in found)
        )
    return found[0] if found else None


def _format_topics(topics: tuple[Topic, ...] | list[Topic]) -> str:
    shown = [f'{topic.name} ({topic.type})' for topic in topics[:12]]
    more = [f'and {len(topics) - 12} more'] if len(topics) > 12 else []
    return ', '.join(shown + more) or 'none'
