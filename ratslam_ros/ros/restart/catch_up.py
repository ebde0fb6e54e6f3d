# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What was sent while a process was interrupted, from the histories of those that sent it.

`ratslam play` keeps the last messages of each topic for late subscribers (history.py). A restarted
process collects these histories, and what arrives meanwhile, until they have met.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from operator import itemgetter
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node

from ratslam_ros.ros.convert import stamp_of
from ratslam_ros.ros.inputs import publisher_count
from ratslam_ros.ros.qos import HISTORY_INPUT
from ratslam_ros.ros.restart.history import KEPT_BYTES, history_topic, size_of

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
    """A stream of which messages may be missing.

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


class CatchUp:
    """Collects histories until nothing is missing before the messages that arrive now."""

    def __init__(
        self, node: Node, missed: Mapping[str, Missed], lost: Callable[[Any], None]
    ) -> None:
        """Subscribe to the histories.

        Args:
            node: the restarted node.
            missed: what may be missing, by stream.
            lost: called with each event of messages that were lost in transport.
        """
        self._node, self._missed = node, missed
        self._start_s = time.monotonic()
        self._kept_bytes = 0
        self._subscriptions = [
            node.create_subscription(
                kind, history_topic(topic), partial(self._receive, one), HISTORY_INPUT,
                event_callbacks=SubscriptionEventCallbacks(message_lost=lost),
            )
            for one in missed.values() for topic, kind in one.topics.items()
        ]  # fmt: skip

    def keep(self, stream: str, message: Any) -> bool:
        """Keep a message that arrived on a topic itself; return False if too much is kept."""
        self._kept_bytes += (size := size_of(message))
        if self._kept_bytes > KEPT_BYTES:
            self._kept_bytes -= size
            return False
        self._missed[stream].arrived.append((stamp_of(message), message))
        return True

    def is_complete(self, stream: str, known_ns: int) -> bool:
        """Return whether a history reaches back to what was received before."""
        return min(self._missed[stream].history, default=known_ns + 1) <= known_ns

    def has_history(self, stream: str) -> bool:
        """Return whether messages of the past have arrived."""
        return bool(self._missed[stream].history)

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
            for one in self._missed.values()
        ))  # fmt: skip

    def close(self) -> None:
        """End the subscriptions."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def deliver(self, floor_ns: Callable[[str], int]) -> None:
        """Let all messages be received that were collected, once, by stamp.

        Args:
            floor_ns: returns the newest stamp of a stream that is not missing.
        """
        found: list[tuple[int, Receive, Any]] = []
        for stream, missed in self._missed.items():
            floor = floor_ns(stream)
            history = {at: message for at, message in missed.history.items() if at > floor}
            found += [(at, missed.receive, m) for at, m in history.items()]
            found += [(at, missed.receive, m) for at, m in missed.arrived if at not in history]
        for _, receive, message in sorted(found, key=itemgetter(0)):
            receive(message)

    def _receive(self, one: Missed, message: Any) -> None:
        one.last_s = time.monotonic()
        one.history[stamp_of(message)] = message

    def _is_awaited(self, one: Missed) -> bool:
        """Return whether a history has a publisher, of which nothing has come yet."""
        return not one.history and any(
            publisher_count(self._node, history_topic(topic)) for topic in one.topics
        )
