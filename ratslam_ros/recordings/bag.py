# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A recording that consists of one or more files with ROS messages, of any format."""

import math
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from ratslam_ros.errors import UnusableInput
from ratslam_ros.images import image_of
from ratslam_ros.recordings.decode import (
    UndecodableMessage,
    decode,
    decode_event,
    encoding_problem,
    ros2_type_name,
)
from ratslam_ros.recordings.events import Calibration, Event, LaserFrames, ScanEvent
from ratslam_ros.recordings.recording import Recording, camera_info_topic
from ratslam_ros.recordings.stored_file import StoredFile
from ratslam_ros.recordings.stream import Channel, Message, Part, Warnings, merge_by_time
from ratslam_ros.recordings.topics import CAMERA_INFO, ROS1_TF, STRING, TF, Selection, Topic

_PEEK_COUNT = 5  # Messages examined to find unstamped topics, depth images and calibrations.

_TF_NAMES = '/tf_static', '/tf'
_TF_COUNT = 1000
"""Messages of each of them that are read. Frames that are mounted on the robot are published once
on /tf_static, or again and again on /tf; 1000 messages are some seconds of a busy robot."""

BASE_FRAME = 'base_link'
"""Frame of the robot if the odometry does not name it (REP 105)."""


class BagRecording(Recording):
    """The messages of one or more files as one stream in time order."""

    def __init__(
        self,
        path: Path,
        storages: Sequence[StoredFile],
        warnings: Warnings,
        opened: ExitStack,
        counts: dict[str, int] | None,
        formats: dict[str, str],
    ) -> None:
        """Merge the topics and counts of the files.

        Args:
            path: the file or folder that the user gave.
            storages: the open files, at least one, in the order of the recording.
            warnings: receives messages for the user.
            opened: closes the files and removes temporary copies; taken over.
            counts: messages per topic according to the metadata; None if unknown.
            formats: serialisation format per topic according to the metadata.

        Raises:
            UnusableInput: the files hold no messages, or none that can be decoded.
        """
        super().__init__(path, warnings)
        self._storages = storages
        self.kind = storages[0].KIND
        filled = [one for one in storages if one.end_ns >= one.start_ns]
        if not filled:
            raise UnusableInput(
                f'{path} holds no messages: expected a recording with images; check that the '
                'recorder was started with the right topics'
            )
        self.start_ns = min(one.start_ns for one in filled)
        self.end_ns = max(one.end_ns for one in filled)
        is_counted = all(one.is_counted for one in storages)
        self._counts = self._count_all() if is_counted else counts
        self.topics = self._read_topics(formats)
        reasons = {topic.problem for topic in self.topics}
        if None not in reasons:
            raise UnusableInput(
                f'{path} cannot be decoded: {"; ".join(sorted(map(str, reasons)))}; record it '
                'again with an rmw that writes cdr, or convert it with "ros2 bag convert"'
            )
        self._opened = opened.pop_all()

    def count(self) -> dict[str, int]:
        """Return the number of messages of each topic; scan the files if it is not stored."""
        if self._counts is None:
            self._counts = self._count_all()
        return {topic.name: self._counts.get(topic.name, 0) for topic in self.topics}

    def _count_all(self) -> dict[str, int]:
        return sum((one.count() for one in self._open), Counter())

    @property
    def _open(self) -> Sequence[StoredFile]:
        """The files; raises UnusableInput if they are closed."""
        if not self._storages:
            raise UnusableInput(f'{self.path} is closed: open the recording again')
        return self._storages

    def is_empty(self, topic: Topic) -> bool:
        """Return whether a topic has no messages; look for one if no count is stored."""
        if topic.count is None:
            return next(self._messages({topic.name}), None) is None
        return topic.count == 0

    def is_depth(self, topic: Topic) -> bool:
        """Return whether the first decodable message of a topic is a depth image."""
        first = next(self._first(topic.name), None)
        return first is not None and image_of(first).is_depth

    def calibration(self, selection: Selection) -> Calibration | None:
        """Return the calibration of the first valid camera_info message, None without one."""
        if selection.image_topic is None:
            return None
        name = camera_info_topic(selection.image_topic)
        for topic in self.topics:
            if (topic.name, topic.type, topic.problem) != (name, CAMERA_INFO, None):
                continue
            for content in self._first(name):
                # ROS 1 names this field K.
                k = content.k if hasattr(content, 'k') else content.K
                found = Calibration(float(k[0]), int(content.width), content)
                if math.isfinite(found.focal_px) and found.focal_px > 0.0 and found.width_px > 0:
                    return found
        return None

    def laser_frames(self, selection: Selection) -> LaserFrames | None:
        """Return the frames of the first scan and odometry message, and the recorded transforms.

        None if no scan can be read.
        """
        scan = next(self._first(selection.scan_topic), None)
        if scan is None:
            return None
        odometry = next(self._first(selection.odom_topic), None)
        base = '' if odometry is None else str(odometry.child_frame_id)
        return LaserFrames(
            str(scan.header.frame_id), base or BASE_FRAME, tuple(self._transforms())
        )

    def _transforms(self) -> Iterator[Any]:
        """Yield the recorded transforms, the first ones of each topic."""
        usable = {t.name for t in self.topics if t.type in (TF, ROS1_TF) and t.problem is None}
        for name in _TF_NAMES:
            for content in self._first(name, _TF_COUNT) if name in usable else ():
                yield from content.transforms

    def _first(self, topic: str | None, count: int = _PEEK_COUNT) -> Iterator[Any]:
        """Yield the content of the first messages of a topic, as far as they can be decoded."""
        messages = iter(()) if topic is None else self._messages({topic})
        for message in islice(messages, count):
            try:
                yield decode(message)
            except UndecodableMessage:
                continue

    def close(self) -> None:
        """Close the files and remove their temporary copies."""
        self._opened.close()
        self._storages = ()

    def _read_topics(self, formats: dict[str, str]) -> tuple[Topic, ...]:
        channels: dict[str, Channel] = {}
        for storage in self._storages:
            for channel in storage.channels:
                first = channels.setdefault(channel.topic, channel)
                if ros2_type_name(first.type) != ros2_type_name(channel.type):
                    self._warnings.add(
                        f'{channel.topic} was recorded with the types {first.type} and '
                        f'{channel.type}: only the messages of the first type are read'
                    )
        return tuple(
            Topic(
                name,
                ros2_type_name(channel.type),
                None if self._counts is None else self._counts.get(name, 0),
                encoding_problem(formats.get(name, channel.encoding))
                or encoding_problem(channel.encoding),
            )
            for name, channel in sorted(channels.items())
        )

    def _messages(
        self, topics: Collection[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[Message]:
        """Yield the messages of the topics from all files in time order."""
        start = self.start_ns if start_ns is None else start_ns
        stop = self.end_ns + 1 if stop_ns is None else stop_ns
        types = {topic.name: topic.type for topic in self.topics}
        parts = [
            Part(storage.start_ns, storage.end_ns, partial(storage.messages, topics, start, stop))
            for storage in self._open
            if storage.end_ns >= start and storage.start_ns < stop
        ]
        for message in merge_by_time(parts):
            if ros2_type_name(message.channel.type) == types[message.channel.topic]:
                yield message

    def read_events(self, selection: Selection, start_ns: int, stop_ns: int) -> Iterator[Event]:
        """Yield the selected events with start_ns <= log_ns < stop_ns."""
        unstamped = {topic for topic in selection.topics if self._is_unstamped(topic)}
        lasers = {topic: number for number, topic in enumerate(selection.scan_topics) if number}
        skipped: Counter[str] = Counter()
        reasons: dict[str, str] = {}
        try:
            for message in self._messages(selection.topics, start_ns, stop_ns):
                topic = message.channel.topic
                try:
                    event = decode_event(message)
                except UndecodableMessage as error:
                    at_s = (message.log_ns - self.start_ns) / 1e9
                    reasons.setdefault(topic, f'the first at {at_s:.1f} s: {error}')
                    skipped[topic] += 1
                    self.skipped += 1
                    continue
                if isinstance(event, ScanEvent) and topic in lasers:
                    event = replace(event, laser=lasers[topic])
                yield replace(event, stamp_ns=event.log_ns) if topic in unstamped else event
        finally:
            for topic, number in skipped.items():
                self._warnings.add(
                    f'{number} of the messages of {topic} cannot be decoded and are skipped, '
                    f'{reasons[topic]}'
                )

    def _is_unstamped(self, topic: str) -> bool:
        """Return whether the first messages of a topic all lack a stamp; warn the user if so."""
        stamps = set()
        for message in islice(self._messages({topic}), _PEEK_COUNT):
            if message.channel.type.endswith(STRING.split('/')[-1]):
                return False
            try:
                stamps.add(decode_event(message).stamp_ns)
            except UndecodableMessage:
                continue
        if stamps == {0}:
            self._warnings.add(
                f'the messages of {topic} are not stamped: the recording times are used instead'
            )
            return True
        return False
