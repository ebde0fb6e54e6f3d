# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Summary of a recording and the command that replays it, as printed by ``ratslam info``."""

import shlex
from dataclasses import dataclass

from ratslam_ros.errors import RatslamError, UnusableInput
from ratslam_ros.recordings.events import ImageEvent
from ratslam_ros.recordings.recording import Recording
from ratslam_ros.recordings.selection import (
    image_candidates,
    odometry_candidates,
    scan_candidates,
)
from ratslam_ros.recordings.topics import (
    IMAGE_TYPES,
    ODOMETRY_TYPES,
    SCAN_TYPES,
    Selection,
    Topic,
)

_TRIES_COUNT = 5  # Images that must fail to decode before their topic counts as undecodable.


@dataclass(frozen=True, slots=True)
class TopicDescription:
    """One topic of a recording."""

    name: str
    type: str
    count: int
    rate_hz: float | None
    """Mean rate; None for fewer than two messages."""
    image: str
    """Size and encoding of the images, such as '160x120 jpeg'; '' for other topics."""
    problem: str
    """Reason why the topic cannot be used; '' if it can."""


@dataclass(frozen=True, slots=True)
class Description:
    """Summary of a recording."""

    path: str
    kind: str
    duration_s: float
    topics: tuple[TopicDescription, ...]
    notices: tuple[str, ...]
    warnings: tuple[str, ...]
    command: str
    """Command line that replays the recording; '' if it cannot be replayed."""

    def format(self) -> str:
        """Format the summary as a text table."""
        rows = [('topic', 'type', 'messages', 'rate', 'image', '')]
        for topic in self.topics:
            rate = '' if topic.rate_hz is None else f'{topic.rate_hz:.1f} Hz'
            rows.append(
                (topic.name, topic.type, str(topic.count), rate, topic.image, topic.problem)
            )
        widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
        lines = [f'{self.path}: {self.kind}, {self.duration_s:.1f} s', '']
        for row in rows:
            cells = [
                cell.rjust(width) if column in (2, 3) else cell.ljust(width)
                for column, (cell, width) in enumerate(zip(row, widths, strict=True))
            ]
            lines.append('  '.join(cells).rstrip())
        lines.append('')
        lines += [f'note: {notice}' for notice in self.notices]
        lines += [f'warning: {warning}' for warning in self.warnings]
        if self.command:
            lines.append(f'next: {self.command}')
        return '\n'.join(lines)


def describe(recording: Recording) -> Description:
    """Summarise a recording; read all of it only if it stores no message counts."""
    counts = recording.count()
    duration_s = (recording.end_ns - recording.start_ns) / 1e9
    topics = tuple(
        _describe_topic(recording, topic, counts[topic.name], duration_s)
        for topic in recording.topics
    )
    command, notices = _command(recording, {topic.name for topic in topics if topic.problem})
    return Description(
        str(recording.path),
        recording.kind,
        duration_s,
        topics,
        notices,
        tuple(recording.warnings),
        command,
    )


def mean_rate_hz(count: int, duration_s: float) -> float | None:
    """Return the mean rate of messages over a duration, None for fewer than two messages."""
    return (count - 1) / duration_s if count > 1 and duration_s > 0.0 else None


def _describe_topic(
    recording: Recording, topic: Topic, count: int, duration_s: float
) -> TopicDescription:
    rate = mean_rate_hz(count, duration_s)
    image, problem = '', topic.problem or ''
    if not problem and count and topic.type in IMAGE_TYPES:
        image, problem = _first_image(recording, topic)
    elif not problem and count and topic.type in ODOMETRY_TYPES:
        problem = _undecodable(recording, Selection(None, topic.name, None))
    elif not problem and count and topic.type in SCAN_TYPES:
        problem = _undecodable(recording, Selection(None, None, None, topic.name))
    return TopicDescription(topic.name, topic.type, count, rate, image, problem)


def _undecodable(recording: Recording, selection: Selection) -> str:
    return '' if next(recording.events(selection), None) else 'cannot be decoded'


def _first_image(recording: Recording, topic: Topic) -> tuple[str, str]:
    """Return the size and encoding of the first decodable image, and the problem if none is."""
    problem = 'no image in it can be decoded'
    for tried, event in enumerate(recording.events(Selection(topic.name, None, None))):
        if tried == _TRIES_COUNT:
            break
        if isinstance(event, ImageEvent):
            try:
                height, width = event.grey().shape
                return f'{width}x{height} {event.image.encoding}'.strip(), ''
            except RatslamError as error:
                problem = str(error)
    return '', problem


def _command(recording: Recording, broken: set[str]) -> tuple[str, tuple[str, ...]]:
    """Return the shortest command that replays the recording, and notices for the user."""
    words = ['ratslam', 'replay', str(recording.path)]
    options: dict[str, str] = {}
    for option, parameter, candidates in (
        ('--image-topic', 'image_topic', image_candidates(recording)),
        ('--odom-topic', 'odom_topic', odometry_candidates(recording)),
    ):
        if len(candidates) > 1:
            chosen = next((t for t in candidates if t.name not in broken), candidates[0])
            options[parameter] = chosen.name
            words += [option, chosen.name]
    try:
        selection = recording.select(**options)  # type: ignore[arg-type]
    except UnusableInput as error:
        return '', (str(error),)
    return shlex.join(words), selection.notices + _scan_notices(recording, broken)


def _scan_notices(recording: Recording, broken: set[str]) -> tuple[str, ...]:
    """Return a notice about scans, which are read only if the configuration enables them."""
    candidates = scan_candidates(recording)
    usable = [topic.name for topic in candidates if topic.name not in broken]
    if not usable:
        return ()
    choice = ' or '.join(f'--scan-topic {name}' for name in usable)
    if len(usable) > 1:
        choice += f', or --scan-topic {",".join(usable)} for all lasers'
    return (
        f'the scans of {" or ".join(usable)} are read if experience_map.exp_align_scans is set'
        + (f'; give {choice}' if len(candidates) > 1 else ''),
    )
