# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A recording made of files with ROS messages, whatever their format."""

import math
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path

from ratslam_ros.errors import UnusableInput
from ratslam_ros.images import image_of
from ratslam_ros.recordings.decode import (
    UndecodableMessage,
    decode,
    event_of,
    normal_type,
    unreadable,
)
from ratslam_ros.recordings.events import Calibration, Event
from ratslam_ros.recordings.files import Workspace
from ratslam_ros.recordings.recording import Recording
from ratslam_ros.recordings.selection import camera_info_of
from ratslam_ros.recordings.stream import (
    Channel,
    Message,
    Part,
    Storage,
    Warnings,
    in_time_order,
)
from ratslam_ros.recordings.topics import CAMERA_INFO, STRING, Selection, Topic

_PEEK = 5  # messages of a stream that must all be unstamped before it is taken as unstamped


class BagRecording(Recording):
    """The messages of one or several files as one stream."""

    def __init__(
        self,
        path: Path,
        storages: Sequence[Storage],
        warnings: Warnings,
        workspace: Workspace,
        counts: dict[str, int] | None = None,
        formats: dict[str, str] | None = None,
    ) -> None:
        super().__init__(path, warnings)
        self._storages = storages
        self._workspace = workspace
        self.kind = storages[0].contents.kind
        filled = [s.contents for s in storages if s.contents.end_ns >= s.contents.start_ns]
        if not filled:
            raise UnusableInput(
                f'{path} holds no messages: expected a recording with images; look whether the '
                'recorder was started with the right topics'
            )
        self.start_ns = min(contents.start_ns for contents in filled)
        self.end_ns = max(contents.end_ns for contents in filled)
        self._counts = self._stored_counts(counts)
        self.topics = self._read_topics(formats or {})
        reasons = {topic.readable for topic in self.topics}
        if None not in reasons:
            raise UnusableInput(
                f'{path} cannot be decoded: {"; ".join(sorted(map(str, reasons)))}; record it '
                'again with an rmw that writes cdr, or convert it with "ros2 bag convert"'
            )

    def count(self) -> dict[str, int]:
        """Count the messages of each topic, by a scan where that was not stored."""
        if self._counts is None:
            counts: Counter[str] = Counter()
            for storage in self._storages:
                for channel, number in storage.count().items():
                    counts[channel.topic] += number
            self._counts = counts
        return {topic.name: self._counts.get(topic.name, 0) for topic in self.topics}

    def is_empty(self, topic: Topic) -> bool:
        """Tell whether a topic has no messages, by a look where the counts are not stored."""
        if topic.count is None:
            return next(self._messages({topic.name}), None) is None
        return topic.count == 0

    def is_depth(self, topic: Topic) -> bool:
        """Tell a depth image topic, by its first message, from one of a camera."""
        for message in islice(self._messages({topic.name}), _PEEK):
            try:
                return image_of(decode(message)).is_depth
            except UndecodableMessage:
                continue
        return False

    def calibration(self, selection: Selection) -> Calibration | None:
        """Return what the first usable camera_info beside the images says, None without one."""
        if selection.image_topic is None:
            return None
        name = camera_info_of(selection.image_topic)
        for topic in self.topics:
            if (topic.name, topic.type, topic.readable) != (name, CAMERA_INFO, None):
                continue
            for message in islice(self._messages({name}), _PEEK):
                try:
                    content = decode(message)
                except UndecodableMessage:
                    continue
                # ROS 1 has capital letters here.
                k = content.k if hasattr(content, 'k') else content.K
                found = Calibration(float(k[0]), int(content.width), content)
                if math.isfinite(found.focal_px) and found.focal_px > 0.0 and found.width_px > 0:
                    return found
        return None

    def close(self) -> None:
        """Let go of the files, and of the temporary copies of compressed ones."""
        for storage in self._storages:
            storage.close()
        self._workspace.close()

    def _stored_counts(self, counts: dict[str, int] | None) -> dict[str, int] | None:
        """Return the counts of the files themselves, or else those of the metadata."""
        found: Counter[str] = Counter()
        for storage in self._storages:
            if storage.contents.counts is None:
                return counts
            for channel, number in storage.contents.counts.items():
                found[channel.topic] += number
        return found

    def _read_topics(self, formats: dict[str, str]) -> tuple[Topic, ...]:
        channels: dict[str, Channel] = {}
        for storage in self._storages:
            for channel in storage.contents.channels:
                first = channels.setdefault(channel.topic, channel)
                if normal_type(first.type) != normal_type(channel.type):
                    self._warnings.add(
                        f'{channel.topic} was recorded with the types {first.type} and '
                        f'{channel.type}: only the first is read'
                    )
        return tuple(
            Topic(
                name,
                normal_type(channel.type),
                None if self._counts is None else self._counts.get(name, 0),
                unreadable(formats.get(name, channel.encoding)) or unreadable(channel.encoding),
            )
            for name, channel in sorted(channels.items())
        )

    def _messages(
        self, topics: Collection[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[Message]:
        """Yield the messages of the topics out of all files, in order of time."""
        start = self.start_ns if start_ns is None else start_ns
        stop = self.end_ns + 1 if stop_ns is None else stop_ns
        types = {topic.name: topic.type for topic in self.topics}
        parts = [
            Part(
                storage.contents.start_ns,
                storage.contents.end_ns,
                partial(storage.messages, topics, start, stop),
            )
            for storage in self._storages
            if storage.contents.end_ns >= start and storage.contents.start_ns < stop
        ]
        for message in in_time_order(parts):
            if normal_type(message.channel.type) == types[message.channel.topic]:
                yield message

    def _events(self, selection: Selection, start_ns: int, stop_ns: int) -> Iterator[Event]:
        unstamped = {topic for topic in selection.topics if self._is_unstamped(topic)}
        skipped: Counter[str] = Counter()
        reasons: dict[str, str] = {}
        try:
            for message in self._messages(selection.topics, start_ns, stop_ns):
                topic = message.channel.topic
                try:
                    event = event_of(message)
                except UndecodableMessage as error:
                    at_s = (message.log_ns - self.start_ns) / 1e9
                    reasons.setdefault(topic, f'the first at {at_s:.1f} s: {error}')
                    skipped[topic] += 1
                    self.skipped += 1
                    continue
                yield replace(event, stamp_ns=event.log_ns) if topic in unstamped else event
        finally:
            for topic, number in skipped.items():
                self._warnings.add(
                    f'{number} of the messages of {topic} cannot be decoded and are skipped, '
                    f'{reasons[topic]}'
                )

    def _is_unstamped(self, topic: str) -> bool:
        """Look whether the first messages of a topic all lack a stamp; tell the user if so."""
        stamps = set()
        for message in islice(self._messages({topic}), _PEEK):
            if message.channel.type.endswith(STRING.split('/')[-1]):
                return False
            try:
                stamps.add(event_of(message).stamp_ns)
            except UndecodableMessage:
                continue
        if stamps == {0}:
            self._warnings.add(
                f'the messages of {topic} are not stamped: the times of the recording are used'
            )
            return True
        return False
