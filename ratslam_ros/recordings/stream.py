# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Undecoded messages of a recording, and merging them into one stream in time order."""

import heapq
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
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
    _kinds: dict[str, dict[str, int]] = field(default_factory=dict)
    """Position of each text, by the text without numbers; that of the last shown if not shown."""

    def add(self, text: str) -> None:
        """Add a warning unless the same text was added before.

        Of those that differ in numbers only, the first ones are kept, and the others counted.
        """
        known = self._kinds.setdefault(re.sub(r'\d+', '#', text), {})
        if text in known:
            return
        if len(known) < SHOWN_OF_A_KIND:
            known[text] = len(self.texts)
            self.texts.append(text)
        else:
            shown, position = next(islice(known.items(), SHOWN_OF_A_KIND - 1, None))
            known[text] = position
            more = len(known) - SHOWN_OF_A_KIND
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
