# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Order: several streams -> one, by the messages' stamps and never by when they arrived.

The rule is architecture.md's: what the map becomes depends on the stamps alone.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

Item = TypeVar('Item')


class Released(NamedTuple, Generic[Item]):
    """A message whose turn it is."""

    stamp_ns: int
    stream: str
    item: Item


@dataclass(slots=True)
class Counts:
    """What did not make it into the map."""

    late: int = 0
    refused: int = 0


class StampOrder(Generic[Item]):
    """Merge streams in stamp order.

    A message is held until every other stream has delivered its stamp or a later one, or the
    newest stamp on any stream exceeds its own by more than ``max_lateness_ns``.
    """

    def __init__(self, streams: tuple[str, ...], max_lateness_ns: int) -> None:
        """Prepare for streams; of equal stamps, those of the stream named first come first."""
        self.counts = Counts()
        self._rank = {stream: rank for rank, stream in enumerate(streams)}
        self._streams = streams
        self._max_lateness_ns = max_lateness_ns
        self._delivered_ns: list[int | None] = [None] * len(streams)
        self._newest_ns: int | None = None
        self._released: tuple[int, int] | None = None
        # No two keys are equal, so that items are never compared.
        self._held: list[tuple[int, int, Item]] = []

    def push(self, stream: str, stamp_ns: int, item: Item) -> list[Released[Item]]:
        """Take one message; return all messages whose turn has come, in order.

        A stamp that does not increase within its stream is refused; one before the last released
        message is late. Both are counted, and the message is dropped.
        """
        rank = self._rank[stream]
        delivered_ns = self._delivered_ns[rank]
        if delivered_ns is not None and stamp_ns <= delivered_ns:
            self.counts.refused += 1
            return []
        self._delivered_ns[rank] = stamp_ns
        if self._newest_ns is None or stamp_ns > self._newest_ns:
            self._newest_ns = stamp_ns
        if self._released is not None and (stamp_ns, rank) < self._released:
            self.counts.late += 1
        else:
            heapq.heappush(self._held, (stamp_ns, rank, item))
        return self._release()

    def flush(self) -> list[Released[Item]]:
        """Return all held messages, in order."""
        return [self._pop() for _ in range(len(self._held))]

    @property
    def held(self) -> int:
        """Number of messages that wait."""
        return len(self._held)

    def _release(self) -> list[Released[Item]]:
        out = []
        while self._held and self._may_go(*self._held[0][:2]):
            out.append(self._pop())
        return out

    def _may_go(self, stamp_ns: int, rank: int) -> bool:
        assert self._newest_ns is not None
        if self._newest_ns - stamp_ns > self._max_lateness_ns:
            return True
        return all(
            delivered_ns is not None and delivered_ns >= stamp_ns
            for other, delivered_ns in enumerate(self._delivered_ns)
            if other != rank
        )

    def _pop(self) -> Released[Item]:
        stamp_ns, rank, item = heapq.heappop(self._held)
        self._released = (stamp_ns, rank)
        return Released(stamp_ns, self._streams[rank], item)
