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

LEAP_NS = 2_000_000_000
"""A stamp this far ahead of its stream is doubted until others follow it."""
JUMP_BACK_NS = 1_000_000_000
"""Stamps further back than this may be those of a recording that begins again."""
RUN, SHORT_RUN, SHORT_RUN_NS = 10, 3, 1_000_000_000
"""So many messages in a row show that time has leapt or jumped back, and not a stamp was wrong;
fewer if they span some time, for slow cameras."""


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
    gaps: int = 0
    """Leaps that were believed: a pause of the source, or messages that were lost unseen."""


class _Stream(Generic[Item]):
    """Which messages of one stream are believed; this depends on that stream alone."""

    def __init__(self) -> None:
        self.refused = 0
        self.gaps = 0
        self.last_ns: int | None = None
        self.left_ns: int | None = None
        """Where the stream was when another one began again, until it begins again as well."""
        self.earlier: list[tuple[int, Item]] = []
        """The newest messages, refused as too old, that would make a stream of their own."""
        self._doubted: list[tuple[int, Item]] = []
        self._widest_ns = 0

    @property
    def doubted(self) -> int:
        """Number of messages that lie a leap ahead."""
        return len(self._doubted)

    def take(self, stamp_ns: int, item: Item) -> list[tuple[int, Item]]:
        """Return the messages that this one makes believed, it among them or not."""
        if self.last_ns is not None and stamp_ns <= self.last_ns:
            self._refuse_old(stamp_ns, item)
            return []
        self.earlier.clear()
        if not self._leaps(stamp_ns, self.last_ns):
            first = self.last_ns is None and self._doubted and not self._leaps(
                stamp_ns, self._doubted[0][0]
            )
            before = [self._believed(*message) for message in self._doubted] if first else []
            self.refused += len(self._doubted) - len(before)
            self._doubted = []
            return [*before, self._believed(stamp_ns, item)]
        before_ns = self._doubted[-1][0] if self._doubted else None
        if before_ns is not None and (
            stamp_ns <= before_ns or self._leaps(stamp_ns, before_ns, self._doubted[0][0])
        ):
            self._refuse_doubted()
        self._doubted.append((stamp_ns, item))
        return self.settle() if _is_run(self._doubted) else []

    def settle(self) -> list[tuple[int, Item]]:
        """Believe what follows a leap, if something does."""
        if len(self._doubted) < 2:
            self._refuse_doubted()
        self.gaps += bool(self._doubted) and self.last_ns is not None
        settled, self._doubted = self._doubted, []
        return [self._believed(*message) for message in settled]

    def is_near(self, begin_ns: int) -> bool:
        """Tell whether the refused stamps lie nearer to a new beginning than to the old end."""
        if not self.earlier or self.last_ns is None:
            return False
        last_ns = self.earlier[-1][0]
        return _is_run(self.earlier) or abs(last_ns - begin_ns) < abs(last_ns - self.last_ns)

    def restart(self, begins: bool) -> None:
        """Take other stamps for the next ones: at once, or when they are nearer to the others'."""
        self._refuse_doubted()
        self.left_ns = None if begins else self.last_ns
        self.last_ns = None
        self.earlier = []

    def _believed(self, stamp_ns: int, item: Item) -> tuple[int, Item]:
        if self.last_ns is not None:
            self._widest_ns = max(self._widest_ns, stamp_ns - self.last_ns)
        self.last_ns = stamp_ns
        return stamp_ns, item

    def _leaps(self, stamp_ns: int, from_ns: int | None, first_ns: int | None = None) -> bool:
        """Tell whether a stamp is too far ahead; a slow stream's usual steps are not."""
        if from_ns is None:
            return stamp_ns <= 0  # a header that was never filled in, unless others follow it
        usual_ns = self._widest_ns
        if first_ns is not None and self.last_ns is not None:
            usual_ns = max(usual_ns, first_ns - self.last_ns)
        return stamp_ns - from_ns > max(LEAP_NS, 2 * usual_ns)

    def _refuse_doubted(self) -> None:
        self.refused += len(self._doubted)
        self._doubted = []

    def _refuse_old(self, stamp_ns: int, item: Item) -> None:
        self.refused += 1
        assert self.last_ns is not None
        if self.earlier and (
            stamp_ns <= self.earlier[-1][0] or self._leaps(stamp_ns, self.earlier[-1][0])
        ):
            self.earlier.clear()  # no stream goes on so
        if self.last_ns - stamp_ns > JUMP_BACK_NS:
            self.earlier = [*self.earlier[1 - RUN :], (stamp_ns, item)]


class StampOrder(Generic[Item]):
    """Merge streams in stamp order.

    A message is held until every other stream has delivered its stamp or a later one, or the
    newest stamp on any stream exceeds its own by more than ``max_lateness_ns``.
    """

    def __init__(self, streams: tuple[str, ...], max_lateness_ns: int) -> None:
        """Prepare for streams; of equal stamps, those of the stream named first come first."""
        self._rank = {stream: rank for rank, stream in enumerate(streams)}
        self._names = streams
        self._max_lateness_ns = max_lateness_ns
        self._streams: list[_Stream[Item]] = [_Stream() for _ in streams]
        self._late = 0
        self._newest_ns: int | None = None
        self._released: tuple[int, int] | None = None
        # No two keys are equal, so that items are never compared.
        self._held: list[tuple[int, int, Item]] = []

    @property
    def counts(self) -> Counts:
        """What was late or refused so far."""
        return Counts(
            self._late,
            sum(stream.refused for stream in self._streams),
            sum(stream.gaps for stream in self._streams),
        )

    @property
    def held(self) -> int:
        """Number of messages that wait."""
        return len(self._held) + sum(stream.doubted for stream in self._streams)

    @property
    def newest_ns(self) -> int | None:
        """The newest stamp on any stream, None before the first."""
        return self._newest_ns

    def newest_of(self, stream: str) -> int | None:
        """Return the newest stamp that is believed of a stream, None before the first."""
        return self._streams[self._rank[stream]].last_ns

    def waiting(self, stream: str) -> list[Item]:
        """Return the messages of a stream that are held, in order."""
        rank = self._rank[stream]
        return [item for _, of, item in sorted(self._held, key=_key) if of == rank]

    def push(self, stream: str, stamp_ns: int, item: Item) -> list[Released[Item]]:
        """Take one message; return all messages whose turn has come, in order.

        A stamp that does not increase within its stream is refused, one that leaps ahead of it is
        doubted until a run of messages has followed it, one before the last released message is
        late. What is refused or late is counted and dropped.
        """
        rank = self._rank[stream]
        if self._is_left_over(self._streams[rank], stamp_ns):
            self._streams[rank].refused += 1
            return []
        for message in self._streams[rank].take(stamp_ns, item):
            self._hold(rank, *message)
        return self._release()

    def flush(self) -> list[Released[Item]]:
        """Return all held messages, in order; a single one that leaps ahead is refused."""
        for rank, stream in enumerate(self._streams):
            for message in stream.settle():
                self._hold(rank, *message)
        return [self._pop() for _ in range(len(self._held))]

    @property
    def jumped_back(self) -> bool:
        """Whether a stream has begun again: a run of refused stamps increases."""
        return any(_is_run(stream.earlier) for stream in self._streams)

    def restart(self) -> list[Released[Item]]:
        """Begin again where a stream jumped back to; return the messages whose turn it then is.

        What is held is dropped and counted: ``flush`` first to keep it. Other streams follow when
        their stamps are nearer to the new ones than to where they were.
        """
        begin_ns = next(s.earlier[0][0] for s in self._streams if _is_run(s.earlier))
        runs = [s.earlier if s.is_near(begin_ns) else [] for s in self._streams]
        for _, rank, _ in self._held:
            self._streams[rank].refused += 1
        self._held.clear()
        self._newest_ns = self._released = None
        for stream, run in zip(self._streams, runs, strict=True):
            stream.restart(bool(run))
            stream.refused -= len(run)
        out = []
        for name, run in zip(self._names, runs, strict=True):
            for message in run:
                out += self.push(name, *message)
        return out

    def _is_left_over(self, stream: _Stream[Item], stamp_ns: int) -> bool:
        """Tell a message from before the time jumped back, on a stream slower than another."""
        if stream.left_ns is None or self._newest_ns is None:
            return False
        if abs(stamp_ns - stream.left_ns) < abs(stamp_ns - self._newest_ns):
            return True
        stream.left_ns = None
        return False

    def _hold(self, rank: int, stamp_ns: int, item: Item) -> None:
        if self._newest_ns is None or stamp_ns > self._newest_ns:
            self._newest_ns = stamp_ns
        if self._released is not None and (stamp_ns, rank) < self._released:
            self._late += 1
        else:
            heapq.heappush(self._held, (stamp_ns, rank, item))

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
            stream.last_ns is not None and stream.last_ns >= stamp_ns
            for other, stream in enumerate(self._streams)
            if other != rank
        )

    def _pop(self) -> Released[Item]:
        stamp_ns, rank, item = heapq.heappop(self._held)
        self._released = (stamp_ns, rank)
        return Released(stamp_ns, self._names[rank], item)


def _key(held: tuple[int, int, Item]) -> tuple[int, int]:
    return held[0], held[1]


def _is_run(messages: list[tuple[int, Item]]) -> bool:
    count = len(messages)
    return count >= RUN or (
        count >= SHORT_RUN and messages[-1][0] - messages[0][0] >= SHORT_RUN_NS
    )
