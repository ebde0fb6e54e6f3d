# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The raw messages of a recording, and their merging into one stream in order of time."""

import heapq
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic as one file holds it; ``encoding`` is 'cdr' (ROS 2), 'ros1' or what nobody reads."""

    topic: str
    type: str
    encoding: str


class Message(NamedTuple):
    """One message as it was recorded: the time of the recording (ns), and the bytes."""

    log_ns: int
    channel: Channel
    data: bytes


@dataclass(frozen=True, slots=True)
class Part:
    """A piece of a recording (a chunk, a file) that is opened when its first time is reached."""

    start_ns: int
    end_ns: int
    open: Callable[[], Iterable[Message]]


@dataclass(slots=True)
class Contents:
    """What a file says it holds; ``counts`` is None where that would take a scan.

    A file without messages ends before it starts.
    """

    channels: tuple[Channel, ...]
    counts: dict[Channel, int] | None
    start_ns: int
    end_ns: int
    kind: str


@dataclass(slots=True)
class Warnings:
    """Texts for the user, each of them once."""

    texts: list[str] = field(default_factory=list)

    def add(self, text: str) -> None:
        """Keep a text unless it was said before."""
        if text not in self.texts:
            self.texts.append(text)


class Storage(Protocol):
    """One file of a recording."""

    path: Path
    contents: Contents

    def messages(self, topics: Collection[str], start_ns: int, stop_ns: int) -> Iterator[Message]:
        """Yield the messages of the topics with start_ns <= log_ns < stop_ns in order of time."""
        ...

    def count(self) -> dict[Channel, int]:
        """Count the messages, by a scan where the file does not say."""
        ...

    def close(self) -> None:
        """Let go of the file."""
        ...


def in_time_order(parts: Iterable[Part]) -> Iterator[Message]:
    """Merge parts whose messages are each in order of time, with few of them open at once.

    Equal times come in the order of the parts. Parts that do not overlap are read one by one, so
    the memory does not grow with the recording.
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
        following = next(messages, None)
        if following is None:
            heapq.heappop(running)
        else:
            heapq.heapreplace(running, (following.log_ns, order, following, messages))
