# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Merge several message streams into one that is ordered by the messages' stamps.

The order of the output depends on the stamps alone and not on the arrival times, so that the map
does not depend on scheduling (docs/algorithm.md, "Time and order").
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, Generic, NamedTuple, TypeVar

from ratslam_ros.core.common.saved import Field, Saved, count
from ratslam_ros.core.common.state import State
from ratslam_ros.errors import UnusableInput
from ratslam_ros.pipeline.codec import item_from_state, item_state
from ratslam_ros.pipeline.rhythm import Rhythm

Item = TypeVar('Item')

FORWARD_JUMP_NS = 2_000_000_000
"""A stamp further ahead of its stream than this is held until later messages confirm it."""

BACKWARD_JUMP_NS = 1_000_000_000
"""A stamp further behind its stream than this may belong to a recording that has restarted."""

RUN_COUNT = 10
"""Number of consecutive messages that confirm a jump in time, forward or backward."""

SHORT_RUN_COUNT, SHORT_RUN_NS = 3, 1_000_000_000
"""In a slow stream, this many messages confirm a jump if they span at least this time."""


class Released(NamedTuple, Generic[Item]):
    """A message released in stamp order."""

    stamp_ns: int
    stream: str
    item: Item
    at_ns: int
    """Stamp by which it is ordered: a later one if it is of a regular stream and was early."""


@dataclass(slots=True)
class Counts:
    """Numbers of messages that were dropped, and of gaps in the input."""

    late: int = 0
    """Messages that arrived after a message with a later stamp was released."""
    refused: int = 0
    """Messages with an implausible stamp, or with one that does not increase."""
    gaps: int = 0
    """Confirmed forward jumps: the source paused, or messages were lost."""


def _messages(key: str) -> Field:
    return Field(
        key, key, list, save=lambda held: [[at_ns, item_state(item)] for at_ns, item in held],
        load=lambda rows: [(at_ns, item_from_state(item)) for at_ns, item in rows],
    )


class _Stream(Saved, Generic[Item]):
    """Check of the stamps of one stream, independent of all other streams."""

    SAVED = (
        count('refused', 'refused'), count('gaps', 'gaps'),
        Field('last_ns', 'last_ns', int, nullable=True),
        Field('old_end_ns', 'old_end_ns', int, nullable=True),
        Field('max_step_ns', '_max_step_ns', int), _messages('restart_run'),
        _messages('unconfirmed'),
    )

    def __init__(self) -> None:
        self.refused = 0
        self.gaps = 0
        self.last_ns: int | None = None
        """Stamp of the last accepted message."""
        self.old_end_ns: int | None = None
        """Last stamp before another stream restarted, until this stream restarts as well."""
        self.restart_run: list[tuple[int, Item]] = []
        """Newest messages that were refused as too old but may be those of a restart."""
        self.unconfirmed: list[tuple[int, Item]] = []
        """Messages that are held because of an unconfirmed forward jump."""
        self._max_step_ns = 0

    def push(self, stamp_ns: int, item: Item) -> list[tuple[int, Item]]:
        """Add one message and return all messages that are accepted now, in order."""
        if self.last_ns is not None and stamp_ns <= self.last_ns:
            self._refuse_old(stamp_ns, item)
            return []
        self.restart_run.clear()
        if not self._jumps_ahead(stamp_ns, self.last_ns):
            continues = self.last_ns is None and self.unconfirmed and not self._jumps_ahead(
                stamp_ns, self.unconfirmed[0][0]
            )
            earlier = (
                [self._accept(*message) for message in self.unconfirmed] if continues else []
            )
            self.refused += len(self.unconfirmed) - len(earlier)
            self.unconfirmed = []
            return [*earlier, self._accept(stamp_ns, item)]
        previous_ns = self.unconfirmed[-1][0] if self.unconfirmed else None
        if previous_ns is not None and (
            stamp_ns <= previous_ns
            or self._jumps_ahead(stamp_ns, previous_ns, self.unconfirmed[0][0])
        ):
            self._refuse_unconfirmed()
        self.unconfirmed.append((stamp_ns, item))
        return self.settle() if _is_run(self.unconfirmed) else []

    def settle(self) -> list[tuple[int, Item]]:
        """Accept and return the unconfirmed messages; refuse a single one."""
        if len(self.unconfirmed) < 2:
            self._refuse_unconfirmed()
        self.gaps += bool(self.unconfirmed) and self.last_ns is not None
        settled, self.unconfirmed = self.unconfirmed, []
        return [self._accept(*message) for message in settled]

    def has_restarted(self, begin_ns: int) -> bool:
        """Return whether the refused stamps are closer to a restart at ``begin_ns`` than to here.

        "Here" is the last accepted stamp of this stream.
        """
        if not self.restart_run or self.last_ns is None:
            return False
        last_ns = self.restart_run[-1][0]
        return _is_run(self.restart_run) or abs(last_ns - begin_ns) < abs(last_ns - self.last_ns)

    def restart(self, has_restarted: bool) -> None:
        """Forget the last stamp.

        Args:
            has_restarted: the stream itself has restarted. Otherwise its messages from before
                the restart may still arrive, and are recognised by ``old_end_ns``.
        """
        self._refuse_unconfirmed()
        self.old_end_ns = None if has_restarted else self.last_ns
        self.last_ns = None
        self.restart_run = []

    def _accept(self, stamp_ns: int, item: Item) -> tuple[int, Item]:
        if self.last_ns is not None:
            self._max_step_ns = max(self._max_step_ns, stamp_ns - self.last_ns)
        self.last_ns = stamp_ns
        return stamp_ns, item

    def _jumps_ahead(
        self, stamp_ns: int, from_ns: int | None, first_ns: int | None = None
    ) -> bool:
        """Return whether a stamp is too far ahead, compared to the usual steps of the stream."""
        if from_ns is None:
            return stamp_ns <= 0  # A header that was not filled in, unless other messages follow.
        usual_ns = self._max_step_ns
        if first_ns is not None and self.last_ns is not None:
            usual_ns = max(usual_ns, first_ns - self.last_ns)
        return stamp_ns - from_ns > max(FORWARD_JUMP_NS, 2 * usual_ns)

    def _refuse_unconfirmed(self) -> None:
        self.refused += len(self.unconfirmed)
        self.unconfirmed = []

    def _refuse_old(self, stamp_ns: int, item: Item) -> None:
        self.refused += 1
        assert self.last_ns is not None
        if self.restart_run and (
            stamp_ns <= self.restart_run[-1][0]
            or self._jumps_ahead(stamp_ns, self.restart_run[-1][0])
        ):
            self.restart_run.clear()  # A restarted stream would have small, increasing steps.
        if self.last_ns - stamp_ns > BACKWARD_JUMP_NS:
            self.restart_run = [*self.restart_run[1 - RUN_COUNT :], (stamp_ns, item)]


class StampOrder(Saved, Generic[Item]):
    """Merge of several streams in stamp order.

    A message is held until every other stream has delivered the same stamp or a later one, or
    until the newest stamp of any stream is more than ``max_lateness_ns`` ahead of it. It does not
    wait for a regular stream whose next message is predicted to have a later stamp.
    """

    SAVED = (
        Field('streams', '', list, save=lambda own: [one.state() for one in own._streams]),
        count('late', '_late'), Field('newest_ns', 'newest_ns', int, nullable=True),
        Field('released', '_released', int, (2,), make=lambda *released: released, nullable=True),
        Field('held', '', list, save=lambda own: own._held_messages()),
        Field('rhythm', '_rhythm', Rhythm, when=lambda own: own._regular is not None),
        Field('regular_ns', '_regular_ns', int, nullable=True,
              when=lambda own: own._regular is not None),
    )

    def __init__(
        self, streams: tuple[str, ...], max_lateness_ns: int, regular: str | None = None
    ) -> None:
        """Create an empty merge.

        Args:
            streams: names of the streams. At equal stamps, the stream named first goes first.
            max_lateness_ns: longest time to wait for other streams, measured in stamps.
            regular: the stream whose stamps are predicted, not the last one; None if none is.
        """
        self._regular = None if regular is None else streams.index(regular)
        self._rhythm = Rhythm()
        self._rank = {stream: rank for rank, stream in enumerate(streams)}
        self._names = streams
        self.max_lateness_ns = max_lateness_ns
        """Longest time to wait for other streams, measured in stamps."""
        self._streams: list[_Stream[Item]] = [_Stream() for _ in streams]
        self._late = 0
        self.newest_ns: int | None = None
        """Newest accepted stamp of any stream, None before the first."""
        self._released: tuple[int, int] | None = None
        self._regular_ns: int | None = None  # stamp of its last released message
        # Messages of each stream in order: stamp, place and item. The place is the stamp, unless
        # a regular stream was early.
        self._held: list[deque[tuple[int, int, Item]]] = [deque() for _ in streams]

    @property
    def counts(self) -> Counts:
        """Numbers of dropped messages and of gaps since the start."""
        return Counts(
            self._late,
            sum(stream.refused for stream in self._streams),
            sum(stream.gaps for stream in self._streams),
        )

    @property
    def refused(self) -> dict[str, int]:
        """Number of refused messages by stream; smaller after a restart, which accepts some."""
        return {
            name: stream.refused for name, stream in zip(self._names, self._streams, strict=True)
        }

    @property
    def held(self) -> int:
        """Number of messages that have been neither released nor dropped yet."""
        unconfirmed = sum(len(stream.unconfirmed) for stream in self._streams)
        return sum(map(len, self._held)) + unconfirmed

    @property
    def next_ns(self) -> int:
        """Stamp after that of the last released message, 0 before the first."""
        return 0 if self._released is None else self._released[0] + 1

    def newest_of(self, stream: str) -> int | None:
        """Return the newest accepted stamp of a stream, None before the first."""
        return self._streams[self._rank[stream]].last_ns

    def held_of(self, stream: str) -> list[tuple[int, Item]]:
        """Return stamp and item of the accepted messages of a stream that are still held."""
        return [(stamp_ns, item) for stamp_ns, _, item in self._held[self._rank[stream]]]

    def push(self, stream: str, stamp_ns: int, item: Item) -> list[Released[Item]]:
        """Add one message and return all messages that can be released now, in order.

        Dropped messages are counted:

        - refused: the stamp is negative, which no format of a result can hold, does not increase
          within its stream, or jumps ahead and is not confirmed by further messages;
        - late: a message with a later stamp has already been released.
        """
        rank = self._rank[stream]
        if stamp_ns < 0 or self._is_from_before_restart(self._streams[rank], stamp_ns):
            self._streams[rank].refused += 1
            return []
        for message in self._streams[rank].push(stamp_ns, item):
            self._hold(rank, *message)
        return self._release()

    def end_stamp(self) -> int:
        """Return the stamp after that of the last released message, 0 before the first.

        Something else takes place there: messages with earlier stamps are late from now on.
        """
        if self._released is not None:
            self._released = self.next_ns, -1
        return 0 if self._released is None else self._released[0]

    def flush(self) -> list[Released[Item]]:
        """Release all held messages, in order; a single message that jumps ahead is refused."""
        for rank, stream in enumerate(self._streams):
            for message in stream.settle():
                self._hold(rank, *message)
        out = []
        while (following := self._following()) is not None:
            out.append(self._pop(*following))
        return out

    @property
    def jumped_back(self) -> bool:
        """Whether a stream has restarted: a run of too old messages has increasing stamps."""
        return any(_is_run(stream.restart_run) for stream in self._streams)

    def restart(self) -> list[Released[Item]]:
        """Continue from the earlier time that a stream jumped back to (see ``jumped_back``).

        Held messages are refused; call ``flush`` first to keep them. The other streams restart
        once their stamps are closer to the new time than to their old one.

        Returns:
            The messages that can be released now, in order.
        """
        begin_ns = next(s.restart_run[0][0] for s in self._streams if _is_run(s.restart_run))
        runs = [s.restart_run if s.has_restarted(begin_ns) else [] for s in self._streams]
        for held, stream in zip(self._held, self._streams, strict=True):
            stream.refused += len(held)
            held.clear()
        self._rhythm, self._regular_ns = Rhythm(), None
        self.newest_ns = self._released = None
        for stream, run in zip(self._streams, runs, strict=True):
            stream.restart(bool(run))
            stream.refused -= len(run)
        out = []
        for name, run in zip(self._names, runs, strict=True):
            for message in run:
                out += self.push(name, *message)
        return out

    def _held_messages(self) -> list[list[Any]]:
        """Return the held messages of all streams in order, with their place if it differs."""
        return [
            [stamp_ns, rank, item_state(item), *([] if place_ns == stamp_ns else [place_ns])]
            for stamp_ns, rank, place_ns, item in sorted(
                ((stamp_ns, rank, place_ns, item) for rank, held in enumerate(self._held)
                 for stamp_ns, place_ns, item in held), key=itemgetter(0, 1),
            )
        ]

    def _restored(self, state: State) -> None:
        if len(state['streams']) != len(self._streams):
            raise UnusableInput(
                f'the state has {len(state["streams"])} input streams; expected '
                f'{len(self._streams)}: laser and odometry must be used as in the run that saved'
            )
        for stream, saved in zip(self._streams, state['streams'], strict=True):
            stream.restore(saved)
        for held in self._held:
            held.clear()
        for stamp_ns, rank, item, *place_ns in state['held']:
            place = place_ns[0] if place_ns else stamp_ns
            self._held[rank].append((stamp_ns, place, item_from_state(item)))

    def _is_from_before_restart(self, stream: _Stream[Item], stamp_ns: int) -> bool:
        """Return whether a message of a stream that lags behind predates the restart."""
        if stream.old_end_ns is None or self.newest_ns is None:
            return False
        if abs(stamp_ns - stream.old_end_ns) < abs(stamp_ns - self.newest_ns):
            return True
        stream.old_end_ns = None
        return False

    def _hold(self, rank: int, stamp_ns: int, item: Item) -> None:
        if self.newest_ns is None or stamp_ns > self.newest_ns:
            self.newest_ns = stamp_ns
        place_ns = self._rhythm.place_ns(stamp_ns) if rank == self._regular else stamp_ns
        at_ns = place_ns if self._rhythm.is_used else stamp_ns
        if self._released is not None and (at_ns, rank) < self._released:
            self._late += 1
        else:
            self._held[rank].append((stamp_ns, place_ns, item))

    def _release(self) -> list[Released[Item]]:
        out = []
        while (following := self._following()) is not None and self._is_due(*following):
            out.append(self._pop(*following))
        return out

    def _following(self) -> tuple[int, int] | None:
        """Return the stamp by which the next held message is ordered, and its stream's rank."""
        by_place = self._rhythm.is_used
        following = None
        for rank, held in enumerate(self._held):
            if held:
                stamp_ns, place_ns, _ = held[0]
                at_ns = place_ns if by_place else stamp_ns
                if following is None or at_ns < following[0]:
                    following = at_ns, rank
        return following

    def _is_due(self, at_ns: int, rank: int) -> bool:
        assert self.newest_ns is not None
        if self.newest_ns - at_ns > self.max_lateness_ns:
            return True
        for other, stream in enumerate(self._streams):
            if other != rank:
                is_regular = other == self._regular and self._rhythm.is_used
                reached_ns = self._rhythm.reached_ns if is_regular else stream.last_ns
                if reached_ns is None or reached_ns < at_ns:
                    return False
        return True

    def _pop(self, at_ns: int, rank: int) -> Released[Item]:
        self._released = at_ns, rank
        stamp_ns, _, item = self._held[rank].popleft()
        if rank == self._regular:
            self._regular_ns = stamp_ns
        elif rank == len(self._held) - 1:
            self._rhythm.see(stamp_ns != self._regular_ns)
        return Released(stamp_ns, self._names[rank], item, at_ns)


class GivenOrder(StampOrder[Item]):
    """Messages that are in order already: each is released at once."""

    def push(self, stream: str, stamp_ns: int, item: Item) -> list[Released[Item]]:
        """Add and return one message."""
        rank = self._rank[stream]
        self._streams[rank].last_ns = stamp_ns
        self.newest_ns = max(stamp_ns, self.newest_ns or 0)
        self._released = max(stamp_ns, self.next_ns - 1), rank
        return [Released(stamp_ns, stream, item, self._released[0])]

    def restart(self) -> list[Released[Item]]:
        """Continue from an earlier time."""
        self.newest_ns = self._released = None
        for stream in self._streams:
            stream.restart(has_restarted=True)
        return []


def _is_run(messages: list[tuple[int, Item]]) -> bool:
    count = len(messages)
    return count >= RUN_COUNT or (
        count >= SHORT_RUN_COUNT and messages[-1][0] - messages[0][0] >= SHORT_RUN_NS
    )
