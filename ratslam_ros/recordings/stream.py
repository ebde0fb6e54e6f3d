# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Undecoded messages of a recording, and merging them into one stream in time order."""

import heapq
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic as stored in one file."""

    topic: str
    type: str
    encoding: str
    """Serialisation format: 'cdr' (ROS 2), 'ros1', or another one, which is not supported."""


class Message(NamedTuple):
    """One serialised message and the time at which it was recorded."""

    log_ns: int
    channel: Channel
    data: bytes


@dataclass(frozen=True, slots=True)
class Part:
    """A section of a recording, such as a chunk, with its time range; opened when needed."""

    start_ns: int
    end_ns: int
    open: Callable[[], Iterable[Message]]


SHOWN_OF_A_KIND = 3
"""Number of warnings that differ in numbers only and are shown in full."""


@dataclass(slots=True)
class Warnings:
    """Warnings for the user, without duplicates."""

    texts: list[str] = field(default_factory=list)
    _seen: set[str] = field(default_factory=set)
    _counts: Counter[str] = field(default_factory=Counter)
    """Number of warnings by their texts without numbers."""
    _last: dict[str, tuple[int, str]] = field(default_factory=dict)
    """Position and text of the last one of each kind that is shown."""

    def add(self, text: str) -> None:
        """Add a warning unless the same text was added before.

        Of those that differ in numbers only, the first ones are kept, and the others counted.
        """
        if text in self._seen:
            return
        self._seen.add(text)
        kind = re.sub(r'\d+', '#', text)
        self._counts[kind] += 1
        more = self._counts[kind] - SHOWN_OF_A_KIND
        if more <= 0:
            self._last[kind] = len(self.texts), text
            self.texts.append(text)
        else:
            position, shown = self._last[kind]
            self.texts[position] = f'{shown} ({more} more of this kind)'


def merge_by_time(parts: Iterable[Part]) -> Iterator[Message]:
    """Merge parts, each sorted by time, into one sequence sorted by time.

    A part is opened only when the merge reaches its start, so parts that do not overlap are read
    one at a time and memory use does not grow with the recording. Messages with equal times are
    yielded in the order in which their parts were opened.
    """
    waiting = sorted(parts, key=lambda part: part.start_ns, reverse=True)
    running: list[tuple[int, int, Message, Iterator[Message]]] = []
    opened = 0
    while waiting or running:
        while waiting and (not running or waiting[-1].start_ns <= running[0][0]):
            opened += 1
            messages = iter(waiting.pop().open())
            for message in messages:
                heapq.heappush(running, (message.log_ns, opened, message, messages))
                break
        if not running:
            continue
        _, order, message, messages = running[0]
        yield message
        if len(running) == 1 and not waiting:  # the last part: nothing is left to be merged
            yield from messages
            return
        following = next(messages, None)
        if following is None:
            heapq.heappop(running)
        else:
            heapq.heapreplace(running, (following.log_ns, order, following, messages))
