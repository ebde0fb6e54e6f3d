# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Restart of a node: what it missed, from its neighbours, from sources that can resend, and live.

A restarted node continues from the last state that it saved. Until it has received everything
since then, it only collects messages. Sources of images answer its request when they have sent
them again. Then its topics are connected, and a second request asks for what was sent meanwhile:
the sources send it again, and the neighbours save their logs in the map file once more. Later
messages arrive on the topics themselves.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from msgspec.structs import replace
from rclpy.node import Node
from std_msgs.msg import String

from ratslam_ros.messages.json_schema import NS_PER_S, encode
from ratslam_ros.messages.resending import (
    RESEND,
    RESENT,
    ResendAnswer,
    ResendRequest,
    resent_topic,
)
from ratslam_ros.ros.convert import stamp_ns
from ratslam_ros.ros.decoded import decoded
from ratslam_ros.ros.qos import GOAL, INPUT
from ratslam_ros.ros.restart.continuity import gaps

REQUEST_PERIOD_S = 0.25
"""Period at which a request is repeated, because its receivers may not be connected yet."""

LEAST_S = 1.0
"""Shortest time of collecting, in which DDS connects a new node to its neighbours."""

MOST_S = 5.0
"""Longest time of collecting. A neighbour that was killed remains visible for up to 10 s."""

ASK_AGAIN_S = 1.0
"""Time after which messages that have not arrived are asked for again."""

NEIGHBOURS = frozenset(
    {'visual_odometry', 'local_view', 'pose_cells', 'experience_map', 'landmark_map'}
)
"""Nodes that answer requests."""


class Missed(NamedTuple):
    """A message that is delivered after the restart."""

    stamp_ns: int
    stream: str
    deliver: Callable[[], None]


@dataclass(frozen=True)
class Wanted:
    """An input of a restarted node.

    stream: its name. kind: type of the messages. after_ns: last stamp that the node has.
    callback: receives a message.
    """

    stream: str
    kind: type
    after_ns: int
    callback: Callable[[Any], None]


class Resuming:
    """Collects the messages that a restarted node missed."""

    def __init__(
        self, node: Node, wanted: Mapping[str, Wanted], repeats: tuple[str, ...], since_ns: int,
        refuse: Callable[[str, str], None],
    ) -> None:  # fmt: skip
        """Subscribe, and send the first request.

        Args:
            node: the restarted node.
            wanted: inputs by topic.
            repeats: streams that the node will send again.
            since_ns: last stamp in the state that the node continues from.
            refuse: called with the topic and the reason if an answer is malformed.
        """
        self._node = node
        self._wanted, self._refuse = wanted, refuse
        self._request = ResendRequest(
            time.time_ns(), node.get_name(), {t: one.after_ns for t, one in wanted.items()},
            repeats, since_ns,
        )  # fmt: skip
        self.missed: list[Missed] = []
        """Everything received, in the order of arrival."""
        self._is_promised = False
        """Whether a source has sent all its messages since ``since_ns`` again."""
        self._resent: dict[str, set[int]] = {topic: set() for topic in wanted}
        """Stamps that have arrived again."""
        self._promised: dict[str, int] = {}
        """Number of the messages that the present request brings, by topic."""
        self._is_last = False
        """Whether the present request was sent after the topics were connected."""
        self._answered: set[str] = set()
        """Nodes that have answered it."""
        self._start_s = self._next_s = self._asked_s = time.monotonic()
        self._requests = node.create_publisher(String, RESEND, GOAL)
        self._subscriptions = [
            node.create_subscription(String, RESENT, self._on_answer, GOAL),
            *(
                node.create_subscription(
                    one.kind, resent_topic(topic), self._receiver(topic, one), INPUT
                )
                for topic, one in wanted.items()
            ),
        ]

    @property
    def is_complete(self) -> bool:
        """Whether all messages of a source since ``since_ns`` have arrived again."""
        return self._is_promised and self._has_all()

    def keep(self, stream: str, message: Any, callback: Callable[[Any], None]) -> None:
        """Keep a message until the node has caught up."""
        self.missed.append(Missed(stamp_of(message), stream, lambda: callback(message)))

    def update(self) -> bool:
        """Repeat the request if it is due; return whether everything has arrived."""
        now_s = time.monotonic()
        took_s = now_s - self._start_s
        if self._has_all():
            if self._is_last and self._have_answered():
                return True
            if not self._is_last and took_s >= LEAST_S:
                self._ask(now_s, is_last=True)
        elif now_s - self._asked_s >= ASK_AGAIN_S:
            # The source was connected to another node that asked, and not yet to this one.
            self._ask(now_s, is_last=False)
        if now_s >= self._next_s:
            self._next_s = now_s + REQUEST_PERIOD_S
            self._requests.publish(String(data=encode(self._request)))
        return took_s >= MOST_S

    def close(self) -> None:
        """Announce that the node has caught up, and end the subscriptions."""
        done = ResendRequest(self._request.number, self._request.node, done=True)
        self._requests.publish(String(data=encode(done)))
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def _ask(self, now_s: float, is_last: bool) -> None:
        """Ask for what is missing, or for all that was missed."""
        after = {
            topic: max(self._resent[topic] if is_last else (), default=one.after_ns)
            for topic, one in self._wanted.items()
        }
        self._request = replace(self._request, number=self._request.number + 1, after=after)
        self._is_last = is_last
        self._promised.clear()
        self._answered.clear()
        self._asked_s = self._next_s = now_s

    def _has_all(self) -> bool:
        return not (self._is_awaited() or self._is_missing())

    def _have_answered(self) -> bool:
        """Return whether all neighbours have saved their logs."""
        names = {
            name for name, space in self._node.get_node_names_and_namespaces()
            if space == self._node.get_namespace()
        }
        return (names & NEIGHBOURS) - {self._node.get_name()} <= self._answered

    def _is_awaited(self) -> bool:
        """Return whether there is a source that has not answered."""
        return any(
            topic not in self._promised
            and self._node.count_publishers(self._node.resolve_topic_name(resent_topic(topic)))
            for topic in self._wanted
        )

    def _is_missing(self) -> bool:
        """Return whether messages that a source has sent again have not arrived."""
        return any(
            self._resent_count(topic) < count or self._has_gap(topic)
            for topic, count in self._promised.items() if topic in self._resent
        )  # fmt: skip

    def _resent_count(self, topic: str) -> int:
        after_ns = self._request.after[topic]
        return sum(stamp_ns > after_ns for stamp_ns in self._resent[topic])

    def _has_gap(self, topic: str) -> bool:
        """Return whether messages are missing between those sent again and those that followed.

        The source may have been connected later on the topic itself than on that of the messages
        which it sends again. It will send all of them if it is asked again.
        """
        resent, stream = self._resent[topic], self._wanted[topic].stream
        stamps_ns = [
            one.stamp_ns for one in self.missed if one.stream == stream and one.stamp_ns > 0
        ]
        return any(not {a, b} <= resent for a, b in gaps(stamps_ns))

    def _receiver(self, topic: str, one: Wanted) -> Callable[[Any], None]:
        def receive(message: Any) -> None:
            stamp_ns = stamp_of(message)
            if stamp_ns > one.after_ns:  # Older ones are for another node, and in the state here.
                self._resent[topic].add(stamp_ns)
                self.keep(one.stream, message, one.callback)

        return receive

    @decoded(ResendAnswer, RESENT)
    def _on_answer(self, answer: ResendAnswer) -> None:
        if answer.number != self._request.number:
            return
        self._answered.add(answer.node)
        self._promised.update(answer.counts)
        if answer.counts:
            self._asked_s = time.monotonic()
        self._is_promised |= bool(answer.counts) and answer.complete


def stamp_of(message: Any) -> int:
    """Return the stamp of a message in its header or JSON text; 0 if it has none."""
    if hasattr(message, 'header'):
        return stamp_ns(message.header)
    try:
        stamp = json.loads(message.data)['stamp']
        return int(stamp['sec']) * NS_PER_S + int(stamp['nanosec'])
    except (ValueError, KeyError, TypeError, RecursionError):
        return 0  # the node reports malformed messages
