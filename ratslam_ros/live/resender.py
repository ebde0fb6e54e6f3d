# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sending messages again to nodes that were restarted and missed them."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable
from typing import Any

from std_msgs.msg import String

from ratslam_ros.live.sending import send
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.resending import (
    RESEND,
    RESENT,
    ResendAnswer,
    ResendRequest,
    resent_topic,
)
from ratslam_ros.ros.decoded import decoded
from ratslam_ros.ros.diagnostics import RepeatedWarnings
from ratslam_ros.ros.qos import GOAL, PLAYED

KEPT_BYTES = 256 * 2**20
"""Limit of the messages that are kept for each topic: ten seconds of raw colour images of 640x480
at 30 Hz, minutes of compressed ones. A saved state is at most a few seconds old."""

NEED_CHECK_PERIOD_S = 1.0
"""Period of the checks whether there are nodes that may ask; otherwise nothing is kept."""

MESSAGE_BYTES = 1000
"""Size at which a message without image or scan is counted."""

RESUME_TIMEOUT_S = 20.0
"""Longest time to wait for a node that has asked for messages to catch up."""

MAX_ANSWERED = 100
"""Number of answered requests that are remembered, because requests are repeated."""


class Resender:
    """Keeps the last messages of several topics, and sends them again on request."""

    def __init__(self, node: Any, topics: dict[str, type]) -> None:
        """Create the topics.

        Args:
            node: the node that publishes the messages.
            topics: message type by topic.
        """
        self._node, self._warnings = node, RepeatedWarnings(node)
        self._publishers = {
            topic: node.create_publisher(kind, resent_topic(topic), PLAYED)
            for topic, kind in topics.items()
        }
        self._kept: dict[str, deque[tuple[int, Any, int]]] = {topic: deque() for topic in topics}
        self._bytes = dict.fromkeys(topics, 0)
        self._dropped_ns: dict[str, int] = {}
        self._answers = node.create_publisher(String, RESENT, GOAL)
        self._answered: deque[int] = deque(maxlen=MAX_ANSWERED)
        self._resuming: dict[str, float] = {}
        self._is_needed, self._next_check_s = True, 0.0
        node.create_subscription(String, RESEND, self._on_request, GOAL)

    @property
    def resuming(self) -> bool:
        """Whether a node that has asked for messages has not caught up yet."""
        now_s = time.monotonic()
        return any(now_s < end_s for end_s in self._resuming.values())

    def add(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Keep a message that is being published."""
        kept = self._kept[topic]
        if not self._may_be_asked():
            self._forget(topic, len(kept))
            self._dropped_ns[topic] = stamp_ns
            return
        if kept and stamp_ns < kept[-1][0]:  # the recording has started again
            self._forget(topic, len(kept))
        size = MESSAGE_BYTES + len(getattr(message, 'data', ()))
        kept.append((stamp_ns, message, size))
        self._bytes[topic] += size
        while self._bytes[topic] > KEPT_BYTES and len(kept) > 1:
            self._forget(topic, 1)

    def _may_be_asked(self) -> bool:
        """Return whether there are nodes that continue from a map file."""
        if (now_s := time.monotonic()) >= self._next_check_s:
            self._next_check_s = now_s + NEED_CHECK_PERIOD_S
            topic = self._node.resolve_topic_name(RESEND)
            self._is_needed = self._node.count_publishers(topic) > 0
        return self._is_needed

    def _forget(self, topic: str, count: int) -> None:
        for _ in range(count):
            self._dropped_ns[topic], _, size = self._kept[topic].popleft()
            self._bytes[topic] -= size

    def _refuse(self, topic: str, reason: str) -> None:
        self._warnings.warn(reason)

    @decoded(ResendRequest)
    def _on_request(self, request: ResendRequest) -> None:
        if request.done:
            self._resuming.pop(request.node, None)
            return
        self._resuming[request.node] = time.monotonic() + RESUME_TIMEOUT_S
        asked = {topic: request.after[topic] for topic in self._kept if topic in request.after}
        if request.number in self._answered or not self._are_connected(asked):
            return  # the request is repeated until the topics are connected
        self._answered.append(request.number)
        self._answers.publish(String(data=encode(self._resend(request, asked))))

    def _are_connected(self, topics: Iterable[str]) -> bool:
        return all(self._publishers[topic].get_subscription_count() > 0 for topic in topics)

    def _resend(self, request: ResendRequest, asked: dict[str, int]) -> ResendAnswer:
        counts, complete = {}, True
        for topic, after_ns in asked.items():
            again = [message for stamp_ns, message, _ in self._kept[topic] if stamp_ns > after_ns]
            for message in again:
                send(self._publishers[topic], message)
            counts[topic] = len(again)
            complete &= self._dropped_ns.get(topic, -1) <= after_ns
        return ResendAnswer(request.number, self._node.get_name(), counts, complete)
