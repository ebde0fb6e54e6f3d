# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs: subscriptions that count lost messages and warn when no messages arrive."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from ratslam_ros.errors import UnusableInput
from ratslam_ros.ros.plain_node import PlainNode
from ratslam_ros.ros.qos import INPUT, INPUT_BEST_EFFORT
from ratslam_ros.starting import starting

RESUBSCRIBE_AFTER_S = 0.5
"""Time without a message after which a subscription may be replaced."""

HOLD_S = 2.0
"""Wall-clock time without a message after which another sender takes the place of the present one.
One that was killed remains in the graph for seconds. A node takes longer to start."""


class Input:
    """One stream on one of several topics, reliable if all its publishers are."""

    def __init__(
        self, node: PlainNode, name: str, topics: dict[str, type],
        callback: Callable[[Any], None], qos: QoSProfile = INPUT,
    ) -> None:
        """Subscribe.

        Args:
            node: the node that subscribes, and reports losses and silence.
            name: name of the stream in the diagnostics.
            topics: message type by topic. The first one with a publisher is used for as long as
                it has a publisher.
            callback: called with each message.
            qos: quality of service for reliable publishers.
        """
        self._node, self._qos = node, qos
        self._diagnostics = node.diagnostics
        self.name, self._topics, self._callback = name, topics, callback
        self._subscriptions: dict[str, Any] = {}
        self._best_effort: dict[str, bool] = {}
        self._used: str | None = None
        self.received = 0
        self._counted = 0
        self._counted_s = self.last_s = time.monotonic()
        self._expected_s = self.last_s
        self._reported: str | None = None
        """Advice of the last report of silence, None if it is over."""
        self.advice = ''
        """What to do about the silence; it is reported again if this changes."""
        self.state = 'waiting'
        """`waiting` for a first message, `running`, `silent`, or `finished`: no publisher."""
        for topic in topics:
            self._subscribe(topic)

    def use(self, topics: dict[str, type]) -> None:
        """Continue with other topics; a subscription to one of both is kept."""
        for topic in [topic for topic in self._subscriptions if topic not in topics]:
            self._unsubscribe(topic)
        self._topics = topics
        if self._used not in topics:
            self._used = None
        for topic in self._wanted_topics():
            if topic not in self._subscriptions:
                self._subscribe(topic)

    def subscribe_again(self) -> None:
        """Subscribe again, to get what the publishers have kept."""
        for topic in [*self._subscriptions]:
            self._subscribe(topic)

    def update(self, silence_s: float) -> float:
        """Adapt to the publishers' quality of service, warn of silence, return the rate in Hz."""
        wanted = self._wanted_topics()
        for topic in self._topics:
            if topic not in wanted:
                self._unsubscribe(topic)
                continue
            # A subscription that receives is kept: replacing it could lose messages uncounted.
            is_silent = self.silent_s() > RESUBSCRIBE_AFTER_S
            best_effort = self._is_best_effort(topic)
            changed = best_effort != self._best_effort.get(topic) and is_silent
            if changed and best_effort and topic in self._subscriptions:
                self._node.get_logger().info(
                    f'{self._node.resolve_topic_name(topic)} has a best-effort publisher: '
                    'subscribing again as best effort'
                )
            if topic not in self._subscriptions or changed:
                self._subscribe(topic)
        now_s = time.monotonic()
        self._watch(now_s, silence_s)
        rate_hz = (self.received - self._counted) / max(now_s - self._counted_s, 1e-3)
        self._counted, self._counted_s = self.received, now_s
        return rate_hz

    def _watch(self, now_s: float, silence_s: float) -> None:
        """Update the state; report silence once with each advice, until the next message.

        The first message may come from a node that is still starting, and compiling for up to a
        minute. The time until then does not count.
        """
        if not self.received and starting():
            self._expected_s = now_s
        if now_s - max(self.last_s, self._expected_s) < silence_s:
            self.state = 'running' if self.received else 'waiting'
            self._reported = None
        else:
            if self.received:
                self.state = 'silent' if self.has_publisher else 'finished'
            if self.state != 'finished' and self._reported != self.advice:
                self._reported = self.advice
                self._diagnostics.warn(self.silence(now_s))
        if self.state == 'silent' or (self.state == 'waiting' and self._reported is not None):
            self._diagnostics.missing[self.name] = self.silence(now_s)
        else:
            self._diagnostics.missing.pop(self.name, None)

    @property
    def has_publisher(self) -> bool:
        """Whether a node publishes one of the topics."""
        return any(publisher_count(self._node, topic) for topic in self._topics)

    def silent_s(self) -> float:
        """Return the time since the last message, in s of a steady clock."""
        return time.monotonic() - self.last_s

    def silence(self, now_s: float) -> str:
        """Return a line that names the expected topics and types, and the present publishers."""
        parts = []
        for topic, kind in self._topics.items():
            name = self._node.resolve_topic_name(topic)
            best_effort = self._best_effort.get(topic, False)
            parts.append(
                f'{name} ({_type_name(kind)}, {"best effort" if best_effort else "reliable"}): '
                f'{self._publishers(name)}'
            )
        silent_s = now_s - self.last_s
        since = f'for {silent_s:.0f} s' if self.received else f'yet, {silent_s:.0f} s from start'
        advice = f'; {self.advice}' if self.advice else ''
        return f'no {self.name} {since}; publishers on {"; on ".join(parts)}{advice}'

    def _publishers(self, topic: str) -> str:
        found = []
        for info in self._node.get_publishers_info_by_topic(topic):
            best_effort = info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
            reliability = 'best effort' if best_effort else 'reliable'
            found.append(f'{_name(info)} ({info.topic_type}, {reliability})')
        return ', '.join(found) or 'none (is the name right? see "ros2 topic list")'

    def _wanted_topics(self) -> list[str]:
        """Return the topics to subscribe to: the one in use, or all if none has a publisher."""
        if self._used is not None and publisher_count(self._node, self._used) > 0:
            return [self._used]
        return list(self._topics)

    def _accepts(self, topic: str) -> bool:
        """Return whether to use messages of a topic: not if a preferred one has a publisher."""
        if topic != self._used and len(self._wanted_topics()) == len(self._topics):
            offered = [t for t in self._topics if publisher_count(self._node, t) > 0]
            self._used = offered[0] if offered else topic
        return topic == self._used

    def _is_best_effort(self, topic: str) -> bool:
        name = self._node.resolve_topic_name(topic)
        return any(
            info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
            for info in self._node.get_publishers_info_by_topic(name)
        )

    def _subscribe(self, topic: str) -> None:
        """Subscribe to a topic, again if it was subscribed."""
        def on_message(message: Any) -> None:
            if not self._accepts(topic):
                return
            self.received += 1
            self.last_s = time.monotonic()
            self._callback(message)

        self._unsubscribe(topic)
        best_effort = self._best_effort[topic] = self._is_best_effort(topic)
        self._subscriptions[topic] = self._node.create_subscription(
            self._topics[topic], topic, on_message,
            INPUT_BEST_EFFORT if best_effort else self._qos,
            event_callbacks=SubscriptionEventCallbacks(
                # ``update`` subscribes again: of all profiles, only the reliability can differ.
                message_lost=self._lost, incompatible_qos=lambda event: None,
            ),
        )

    def _unsubscribe(self, topic: str) -> None:
        subscription = self._subscriptions.pop(topic, None)
        if subscription is not None:
            self._node.destroy_subscription(subscription)

    def _lost(self, event: Any) -> None:
        self._diagnostics.drop(
            'lost',
            f'{event.total_count_change} messages of {self.name} were lost in transport: the '
            'network or this machine is too slow, or the publisher is best effort',
            event.total_count_change,
        )


class SingleSender:
    """Accepts the messages of one sender of a topic, and of its successor when it has ended.

    The numbers and ids in these messages belong to the memory of the sender, so messages of two
    senders would corrupt the map. It happens if two launch files run at once.
    """

    def __init__(self, node: PlainNode, topic: str) -> None:
        """Accept any sender of a topic; the node receives it."""
        self._node, self._topic = node, topic
        self._sender, self._heard_s = 0, 0.0

    def check(self, sender: int) -> None:
        """Check the sender of a message, 0 if it is unknown.

        Raises:
            UnusableInput: it is another one than that of the messages before.
        """
        now_s = time.monotonic()
        if sender and sender != self._sender:
            if self._sender and now_s - self._heard_s < HOLD_S and (
                publisher_count(self._node, self._topic) > 1
            ):
                topic = self._node.resolve_topic_name(self._topic)
                names = sorted(map(_name, self._node.get_publishers_info_by_topic(topic)))
                raise UnusableInput(
                    f'two nodes publish it ({" and ".join(names)}); the messages of the first one '
                    'are used, and the others are ignored: end one of the two, such as a second '
                    'launch file'
                )
            self._sender = sender
        self._heard_s = now_s


def publisher_count(node: Node, topic: str) -> int:
    """Return the number of publishers of a topic; rclpy counts without applying remappings."""
    return int(node.count_publishers(node.resolve_topic_name(topic)))


def _name(info: Any) -> str:
    """Return the full name of the node of a publisher."""
    return f'{info.node_namespace.rstrip("/")}/{info.node_name}'


def _type_name(kind: type) -> str:
    return f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
