# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What was sent while a process with a map file was interrupted, and what is lost of it.

`ratslam play` keeps the last messages of each topic for late subscribers (history.py). A restarted
process collects these histories, and what arrives meanwhile, until they have met.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks

from ratslam_ros.core.common.scan import scan_stream
from ratslam_ros.core.config.experience_map import MAX_LASERS
from ratslam_ros.pipeline.continuity import Continuity
from ratslam_ros.ros.convert import stamp_of
from ratslam_ros.ros.diagnostics import Diagnostics
from ratslam_ros.ros.inputs import publisher_count
from ratslam_ros.ros.plain_node import PlainNode
from ratslam_ros.ros.qos import HISTORY_INPUT
from ratslam_ros.ros.restart.history import KEPT_BYTES, history_topic, size_of

REGULAR = frozenset({'odometry', 'image', *map(scan_stream, range(MAX_LASERS))})
"""Streams of which lost messages are recognised by their stamps; see ``Continuity``."""

UPDATE_PERIOD_S = 0.05
"""Period of the checks whether a restarted process has received what it missed."""

LEAST_S = 1.0
"""Shortest time of collecting, in which DDS connects a new node to its neighbours; and time
without a message after which a history is complete."""

MOST_S = 5.0
"""Longest time to wait for the first message of a history that has a publisher. One that was
killed remains visible for up to 10 s."""

LONGEST_S = 60.0
"""Longest time for all histories."""

Receive = Callable[[Any], None]


@dataclass
class Missed:
    """An input of which messages may be missing.

    topics: type of the messages by topic. receive: takes a message of the past.
    """

    topics: Mapping[str, type]
    receive: Receive
    history: dict[int, Any] = field(default_factory=dict)
    """Messages of the past by their stamps."""
    arrived: list[tuple[int, Any]] = field(default_factory=list)
    """Messages that came on the topics themselves."""
    last_s: float = 0.0
    """When the last message of the past has arrived, of a steady clock; 0 if none has."""

    @property
    def is_met(self) -> bool:
        """Whether the history has reached the first message that arrived on the topics."""
        return bool(self.arrived) and max(self.history, default=-1) >= self.arrived[0][0]

    def is_complete(self, known_ns: int) -> bool:
        """Return whether the history reaches back to what was received before."""
        return min(self.history, default=known_ns + 1) <= known_ns

    def forget(self) -> None:
        """Forget what was collected, as it is received."""
        self.history, self.arrived, self.last_s = {}, [], 0.0

    def add(self, message: Any) -> None:
        """Add a message of the past."""
        self.last_s = time.monotonic()
        self.history[stamp_of(message)] = message


class Recovery:
    """Collects histories until nothing is missing before the messages that arrive now."""

    def __init__(self, nodes: Sequence[PlainNode]) -> None:
        """Do nothing yet.

        Args:
            nodes: those of the process, of which the first reports lost messages.
        """
        self._nodes = nodes
        self.inputs: dict[str, Missed] = {}
        """What comes from outside, by the names of the streams."""
        self._start_s, self._kept_bytes = 0.0, 0
        self._continuity: dict[str, Continuity] = {}
        self._end: Callable[[], None] | None = None
        """Ends the present catch-up at once."""

    @property
    def _diagnostics(self) -> Diagnostics:
        return self._nodes[0].diagnostics

    def close(self) -> None:
        """End; what was collected is received."""
        if self._end is not None:
            self._end()
        self._continuity = {}

    @property
    def is_catching_up(self) -> bool:
        """Whether messages that were sent during an interruption are being collected."""
        return self._end is not None

    def receiver(
        self, stream: str, topics: Mapping[str, type], callback: Receive, resume: Receive
    ) -> Receive:
        """Return what receives the messages of a stream.

        Args:
            stream: its name.
            topics: type of the messages by topic.
            callback: takes each message.
            resume: takes those that were sent while the process was interrupted.
        """
        one = self.inputs[stream] = Missed(topics, resume)

        def receive(message: Any) -> None:
            if not self.is_catching_up:
                callback(message)
            elif self._kept_bytes + size_of(message) <= KEPT_BYTES:
                self._kept_bytes += size_of(message)
                one.arrived.append((stamp_of(message), message))
            else:
                self._diagnostics.drop(
                    'lost', f'a message of {stream} is lost: more arrived than can be kept while '
                    'this node is restarted',
                )

        return receive

    def begin(self, done: Callable[[], None]) -> None:
        """Collect what was sent during an interruption.

        Args:
            done: called at the end; calls ``deliver``.
        """
        node = self._nodes[0]
        self._start_s, self._kept_bytes = time.monotonic(), 0
        subscriptions = [
            node.create_subscription(
                kind, history_topic(topic), one.add, HISTORY_INPUT,
                event_callbacks=SubscriptionEventCallbacks(message_lost=self._lost),
            )
            for one in self.inputs.values() for topic, kind in one.topics.items()
        ]

        def end() -> None:
            timer.cancel()
            self._end = None
            for subscription in subscriptions:
                node.destroy_subscription(subscription)
            done()

        def update() -> None:
            if self.is_done():
                end()

        self._end = end
        timer = node.create_timer(UPDATE_PERIOD_S, update, clock=node.steady)

    def is_done(self) -> bool:
        """Return whether the histories have reached what arrives now, or nothing comes of them."""
        now_s = time.monotonic()
        took_s = now_s - self._start_s
        is_waiting = took_s < MOST_S
        return took_s >= LEAST_S and (took_s >= LONGEST_S or all(
            one.is_met or (
                now_s - max(one.last_s, self._start_s) >= LEAST_S
                and not (is_waiting and self._is_awaited(one))
            )
            for one in self.inputs.values()
        ))

    def _is_awaited(self, one: Missed) -> bool:
        """Return whether a history has a publisher, of which nothing has come yet."""
        return not one.history and any(
            publisher_count(self._nodes[0], history_topic(topic)) for topic in one.topics
        )

    def deliver(
        self, known_ns: Mapping[str, list[int]], floor_ns: Callable[[str], int]
    ) -> None:
        """Let all messages be received that were collected, once, by stamp.

        Args:
            known_ns: stamps of the messages before the interruption, by stream.
            floor_ns: returns the newest stamp of a stream that is not missing.
        """
        self._continuity = {
            stream: Continuity(list(stamps)) for stream, stamps in known_ns.items()
            if stream in REGULAR and stamps and not self.inputs[stream].is_complete(stamps[-1])
        }
        found: list[tuple[int, Receive, Any]] = []
        for stream, one in self.inputs.items():
            if stream in REGULAR and stream not in known_ns and not one.history:
                self._diagnostics.note(
                    f'the first messages of {stream} may be lost: this node was restarted before '
                    'it had received any'
                )
            floor = floor_ns(stream)
            history = {at: message for at, message in one.history.items() if at > floor}
            found += [(at, one.receive, m) for at, m in history.items()]
            found += [(at, one.receive, m) for at, m in one.arrived if at not in history]
            one.forget()
        for _, receive, message in sorted(found, key=itemgetter(0)):
            receive(message)

    def _lost(self, event: Any) -> None:
        self._diagnostics.drop(
            'lost', f'{event.total_count_change} messages of a history were lost in transport',
            event.total_count_change,
        )

    def note(self, stream: str, stamp_ns: int) -> None:
        """Note a message that is received."""
        if stream in self._continuity and self._continuity[stream].add(stamp_ns):
            self._judge(stream)

    def pause(self) -> None:
        """Report what is lost, as no further messages arrive at present."""
        for stream, continuity in [*self._continuity.items()]:
            if continuity.lost() or not continuity.has_new:  # otherwise too few have arrived
                self._judge(stream)

    def _judge(self, stream: str) -> None:
        """Report what is lost of a stream, as messages have arrived since, or none do."""
        continuity = self._continuity.pop(stream)
        lost = continuity.lost()
        if lost is not None:
            self._diagnostics.counts['lost_spans'] += 1
            self._diagnostics.note(
                f'{stream} from {lost[0] * 1e-9:.3f} s to {lost[1] * 1e-9:.3f} s is lost: this '
                'node was restarted, and its source does not send it again'
            )
        elif not continuity.has_new:
            self._diagnostics.note(
                f'{stream} after {continuity.last_ns * 1e-9:.3f} s may be lost: this node was '
                'restarted, and its source does not send it again'
            )
