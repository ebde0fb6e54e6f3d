# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the readers of stored files have in common: spans of messages, counts and warnings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import ClassVar

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings.stream import Channel, Message, Part, Warnings, merge_by_time


@dataclass(slots=True)
class Span:
    """Consecutive messages of a file, such as a chunk, and their time range.

    offset, length: place in the file, in bytes, or id of the first row and number of rows.
    counts: number of messages by the numbers of their channels; empty if unknown.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    counts: Counter[int] = field(default_factory=Counter)


class StoredFile(ABC):
    """The messages of one file."""

    KIND: ClassVar[str]
    """Name of the format."""
    UNREADABLE: ClassVar[str]
    """What is wrong with a file without any readable message, and what was expected."""

    def __init__(self, path: Path, warnings: Warnings, expected: int | None) -> None:
        """Find nothing yet.

        Args:
            path: the file.
            warnings: receives messages for the user.
            expected: number of messages according to the metadata; None if unknown.
        """
        self.path = path
        self._warnings = warnings
        self._expected: float | None = expected
        self._file = path.open('rb')
        self._size = path.stat().st_size
        self._channels: dict[int, Channel] = {}
        self._spans: list[Span] = []
        self._counts: Counter[int] | None = None
        """Messages by channel; None if counting them requires a scan."""
        self.start_ns, self.end_ns = 0, -1
        """Times of the first and the last message; the last is less if there are none."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channels."""
        return tuple(dict.fromkeys(self._channels.values()))

    @property
    def is_counted(self) -> bool:
        """Whether the number of messages is known without a scan."""
        return self._counts is not None

    def count(self) -> Counter[str]:
        """Return the number of messages of each topic; scan the file if it is not stored."""
        if self._counts is None:
            self._counts = self._count_all()
        found: Counter[str] = Counter()
        for number, count in self._counts.items():
            if number in self._channels:
                found[self._channels[number].topic] += count
        return found

    def _count_all(self) -> Counter[int]:
        return Counter(
            number for span in self._spans for _, number, _ in self._messages_in(span)
        )

    @abstractmethod
    def _messages_in(self, span: Span) -> Iterator[tuple[int, int, bytes | memoryview]]:
        """Yield (log_ns, number of the channel, data) for the messages of a span."""

    def messages(self, topics: Collection[str], start_ns: int, stop_ns: int) -> Iterator[Message]:
        """Yield messages of the topics with start_ns <= log_ns < stop_ns in time order."""
        wanted = {number for number, channel in self._channels.items() if channel.topic in topics}
        within = partial(self._sorted, topics=topics, start_ns=start_ns, stop_ns=stop_ns)
        return merge_by_time(
            Part(span.start_ns, span.end_ns, partial(within, span))
            for span in self._spans
            if span.end_ns >= start_ns and span.start_ns < stop_ns
            and (not span.counts or wanted & span.counts.keys())
        )

    def _sorted(
        self, span: Span, topics: Collection[str], start_ns: int, stop_ns: int
    ) -> list[Message]:
        found = []
        for log_ns, number, data in self._messages_in(span):
            channel = self._channels.get(number)
            if channel is None or not span.start_ns <= log_ns <= span.end_ns:
                self._warn_of_damage(span)
            elif channel.topic in topics and start_ns <= log_ns < stop_ns:
                found.append(Message(log_ns, channel, bytes(data)))
        found.sort(key=lambda message: message.log_ns)
        return found

    def _scan_span(self, span: Span) -> None:
        """Count the messages of a span, and keep it if there are any."""
        times = []
        for log_ns, number, _ in self._messages_in(span):
            times.append(log_ns)
            span.counts[number] += 1
        if times:
            span.start_ns, span.end_ns = min(times), max(times)
            self._spans.append(span)

    def _scanned(self) -> Counter[int]:
        """Return the number of messages by channel, from spans that were scanned."""
        found: Counter[int] = Counter()
        for span in self._spans:
            found.update(span.counts)
        return found

    def _times(self) -> tuple[int, int]:
        return (
            min((span.start_ns for span in self._spans), default=0),
            max((span.end_ns for span in self._spans), default=-1),
        )

    def _warn_of_damage(self, span: Span) -> None:
        if span.offset + span.length <= self._size:  # Truncation has its own warning.
            self._warnings.add(
                f'{self.path.name} is damaged at byte {span.offset}: messages from there may be '
                'missing or wrong'
            )

    def _warn_of_recovery(self, state: str, expected: float | None) -> None:
        """Report how much of a damaged file was read.

        Args:
            state: the damage, as a predicate such as 'is truncated'.
            expected: estimated number of messages before the damage; None if unknown.

        Raises:
            UnusableInput: nothing was read.
        """
        read = self._scanned().total()
        if not read:
            self.close()
            raise UnusableInput(
                f'{self.path} {self.UNREADABLE}; copy it again from where it was recorded'
            )
        start_ns, end_ns = self._times()
        about = f' of about {expected:.0f}' if expected and expected > read else ''
        self._warnings.add(
            f'{self.path.name} {state}: read {read}{about} messages, up to '
            f'{(end_ns - start_ns) / 1e9:.1f} s'
        )
