# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Summary of a recording and the command that replays it, as printed by ``ratslam info``."""

import shlex

from ratslam_ros.errors import RatslamError, UnusableInput
from ratslam_ros.recordings.events import ImageEvent
from ratslam_ros.recordings.recording import Recording, image_candidates, usable
from ratslam_ros.recordings.topics import IMAGE_TYPES, ODOMETRY_TYPES, SCAN_TYPES, Selection, Topic

_TRIES_COUNT = 5  # Images that must fail to decode before their topic counts as undecodable.


def describe(recording: Recording) -> str:
    """Summarise a recording as a table of its topics, and the command that replays it.

    All of the recording is read only if it stores no message counts.
    """
    counts = recording.count()
    duration_s = (recording.end_ns - recording.start_ns) / 1e9
    rows, broken = [('topic', 'type', 'messages', 'rate', 'image', '')], set()
    for topic in recording.topics:
        count = counts[topic.name]
        rate = mean_rate_hz(count, duration_s)
        image, problem = _first_message(recording, topic) if count else ('', topic.problem or '')
        if problem:
            broken.add(topic.name)
        rate_text = '' if rate is None else f'{rate:.1f} Hz'
        rows.append((topic.name, topic.type, str(count), rate_text, image, problem))
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = [f'{recording.path}: {recording.kind}, {duration_s:.1f} s', '']
    for row in rows:
        cells = [
            cell.rjust(width) if column in (2, 3) else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append('  '.join(cells).rstrip())
    command, notices = _command(recording, broken)
    lines += ['', *(f'note: {notice}' for notice in notices)]
    lines += [f'warning: {warning}' for warning in recording.warnings]
    return '\n'.join([*lines, f'next: {command}'] if command else lines)


def mean_rate_hz(count: int, duration_s: float) -> float | None:
    """Return the mean rate of messages over a duration, None for fewer than two messages."""
    return (count - 1) / duration_s if count > 1 and duration_s > 0.0 else None


def _first_message(recording: Recording, topic: Topic) -> tuple[str, str]:
    """Return size and encoding of the first image, '' for other topics, and what is wrong."""
    if topic.problem is not None:
        return '', topic.problem
    if topic.type in IMAGE_TYPES:
        return _first_image(recording, topic)
    if topic.type in ODOMETRY_TYPES | SCAN_TYPES:
        selection = Selection(None, topic.name, None)
        if topic.type in SCAN_TYPES:
            selection = Selection(None, None, None, topic.name)
        if next(recording.events(selection), None) is None:
            return '', 'cannot be decoded'
    return '', ''


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
        ('--odom-topic', 'odom_topic', usable(recording, ODOMETRY_TYPES)),
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
    candidates = usable(recording, SCAN_TYPES)
    names = [topic.name for topic in candidates if topic.name not in broken]
    if not names:
        return ()
    choice = ' or '.join(f'--scan-topic {name}' for name in names)
    if len(names) > 1:
        choice += f', or --scan-topic {",".join(names)} for all lasers'
    return (
        f'the scans of {" or ".join(names)} are read if experience_map.exp_align_scans is set'
        + (f'; give {choice}' if len(candidates) > 1 else ''),
    )
