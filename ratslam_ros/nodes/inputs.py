# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs: subscriptions that lose nothing in silence and tell when nothing comes."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy

from ratslam_ros.nodes.diagnostics import Diagnostics
from ratslam_ros.nodes.qos import INPUT, INPUT_BEST_EFFORT

QUIET_S = 0.5
"""After this long without a message a subscription may be made anew."""


class Input:
    """One stream, on one of several topics: reliable wherever every publisher offers it."""

    def __init__(
        self,
        node: Node,
        diagnostics: Diagnostics,
        name: str,
        topics: dict[str, type],
        callback: Callable[[Any], None],
    ) -> None:
        """Subscribe.

        Args:
            node: whose input it is.
            diagnostics: where losses and silence are told.
            name: of the stream, in diagnostics.
            topics: message type by topic; of several that have publishers the first one counts,
                for as long as it has one.
            callback: takes each message.
        """
        self._node = node
        self._diagnostics = diagnostics
        self.name = name
        self._topics = topics
        self._callback = callback
        self._subscriptions: dict[str, Any] = {}
        self._best_effort: dict[str, bool] = {}
        self._used: str | None = None
        self.received = 0
        self._counted = 0
        self._counted_s = self.last_s = time.monotonic()
        self._warned_s = self.last_s
        for topic in topics:
            self._subscribe(topic, self._offers_less(topic))

    def update(self, silence_s: float) -> float:
        """Follow the publishers' quality of service; warn of silence; return the rate in Hz."""
        wanted = self._wanted()
        for topic in self._topics:
            if topic not in wanted:
                self._unsubscribe(topic)
                continue
            less = self._offers_less(topic)
            # One that receives is left alone: another could miss messages and not know.
            changed = less != self._best_effort.get(topic) and self.silent_s() > QUIET_S
            if topic not in self._subscriptions or changed:
                self._unsubscribe(topic)
                self._subscribe(topic, less)
        now_s = time.monotonic()
        if now_s - max(self.last_s, self._warned_s) >= silence_s:
            self._warned_s = now_s
            self._diagnostics.warn(f'silent {self.name}', self.silence(now_s))
        rate_hz = (self.received - self._counted) / max(now_s - self._counted_s, 1e-3)
        self._counted, self._counted_s = self.received, now_s
        return rate_hz

    def silent_s(self) -> float:
        """Return how long nothing has come, in s of a steady clock."""
        return time.monotonic() - self.last_s

    def silence(self, now_s: float) -> str:
        """Return a line on what is waited for, and who is there to send it."""
        parts = []
        for topic, kind in self._topics.items():
            name = self._node.resolve_topic_name(topic)
            less = self._best_effort.get(topic, False)
            parts.append(
                f'{name} ({_type_name(kind)}, {"best effort" if less else "reliable"}): '
                f'{self._publishers(name)}'
            )
        silent_s = now_s - self.last_s
        since = f'for {silent_s:.0f} s' if self.received else f'yet, {silent_s:.0f} s from start'
        return f'no {self.name} {since}; publishers on {"; on ".join(parts)}'

    def _publishers(self, topic: str) -> str:
        found = []
        for info in self._node.get_publishers_info_by_topic(topic):
            less = info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
            namespace = info.node_namespace.rstrip('/')
            found.append(
                f'{namespace}/{info.node_name} ({info.topic_type}, '
                f'{"best effort" if less else "reliable"})'
            )
        return ', '.join(found) or 'none (is the name right? see "ros2 topic list")'

    def _wanted(self) -> list[str]:
        """Return the topics to listen to: the one in use, else all that might be."""
        if self._used is not None and self._publisher_count(self._used) > 0:
            return [self._used]
        return list(self._topics)

    def _uses(self, topic: str) -> bool:
        """Tell whether messages of a topic count: not where they come on a better one as well."""
        if topic != self._used and len(self._wanted()) == len(self._topics):
            offered = [t for t in self._topics if self._publisher_count(t) > 0]
            self._used = offered[0] if offered else topic
        return topic == self._used

    def _publisher_count(self, topic: str) -> int:
        return publisher_count(self._node, topic)

    def _offers_less(self, topic: str) -> bool:
        name = self._node.resolve_topic_name(topic)
        return any(
            info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
            for info in self._node.get_publishers_info_by_topic(name)
        )

    def _subscribe(self, topic: str, best_effort: bool) -> None:
        def take(message: Any) -> None:
            if not self._uses(topic):
                return
            self.received += 1
            self.last_s = time.monotonic()
            self._callback(message)

        self._best_effort[topic] = best_effort
        self._subscriptions[topic] = self._node.create_subscription(
            self._topics[topic],
            topic,
            take,
            INPUT_BEST_EFFORT if best_effort else INPUT,
            event_callbacks=SubscriptionEventCallbacks(message_lost=self._lost),
        )

    def _unsubscribe(self, topic: str) -> None:
        subscription = self._subscriptions.pop(topic, None)
        if subscription is not None:
            self._node.destroy_subscription(subscription)

    def _lost(self, event: Any) -> None:
        self._diagnostics.drop(
            'lost',
            f'{event.total_count_change} messages were lost on the way to {self.name}: the '
            'network or this machine is too slow, or the publisher is best effort',
            event.total_count_change,
        )


def publisher_count(node: Node, topic: str) -> int:
    """Return how many publish a topic; rclpy does not remap the names that it counts by."""
    return int(node.count_publishers(node.resolve_topic_name(topic)))


def _type_name(kind: type) -> str:
    return f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
