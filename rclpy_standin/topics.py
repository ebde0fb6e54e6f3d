# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publishers and subscriptions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy_standin.clock import Duration
from rclpy_standin.dds import INFINITE_NS, Writer
from rclpy_standin.events import Events, SubscriptionEventCallbacks
from rclpy_standin.node_parts import NodePart, Waitable, check_arguments
from rclpy_standin.qos import QoSProfile, to_dds
from rclpy_standin.types import decode_or_none, encode


class Publisher(NodePart):
    """A publisher; thread-safe."""

    def __init__(
        self,
        node: Any,
        msg_type: Any,
        topic: str,
        qos_profile: QoSProfile,
        qos: Any = None,
    ) -> None:
        super().__init__(node)
        self.msg_type = msg_type
        self.topic, self.topic_name = topic, node.names.resolve(topic)
        self.qos_profile = qos_profile
        self._writer: Writer = node.context.participant.writer(
            f'rt{self.topic_name}', msg_type.__msgtype__, qos or to_dds(qos_profile)
        )
        self._events = Events(
            self._writer, SubscriptionEventCallbacks(), node.logger, self.topic_name
        )

    def publish(self, msg: Any) -> None:
        """Publish a message, given as an object or as its CDR.

        Blocks while a reliable KEEP_ALL subscription cannot accept more messages.

        Raises:
            TypeError: the message or one of its fields has another type.
        """
        self._check_alive()
        if isinstance(msg, self.msg_type):
            data: bytes | bytearray = encode(msg)
        elif isinstance(msg, bytes | bytearray | memoryview):
            data = msg if isinstance(msg, bytes) else bytes(msg)
            data += bytes(-len(data) % 4)  # no copy if the length is a multiple of 4
        else:
            raise TypeError(f'Expected {self.msg_type}, got {type(msg)}')
        self._writer.write(data)

    def get_subscription_count(self) -> int:
        """Return the number of matched subscriptions."""
        return 0 if self._closed else len(self._writer.matched)

    def wait_for_all_acked(self, timeout: Duration = Duration(nanoseconds=-1)) -> bool:  # noqa: B008
        """Wait until reliable subscriptions acknowledged all messages; False after the timeout."""
        self._check_alive()
        timeout_ns = timeout.nanoseconds if timeout.nanoseconds >= 0 else INFINITE_NS
        return self._writer.wait_for_acks(timeout_ns)

    def waitables(self) -> list[Waitable]:
        """Return the entities to wait for."""
        return [self._events.waitable()]

    def gids(self) -> tuple[list[bytes], list[bytes]]:
        """Return the GIDs of the readers and of the writers to announce in the graph."""
        return [], [self._writer.gid]

    def close(self) -> None:
        """Delete the DDS entities."""
        self._closed = True
        self._writer.close()


class Subscription(NodePart):
    """A subscription."""

    def __init__(
        self,
        node: Any,
        msg_type: Any,
        topic: str,
        callback: Callable[..., Any],
        qos_profile: QoSProfile,
        callbacks: SubscriptionEventCallbacks,
        raw: bool,
    ) -> None:
        super().__init__(node)
        self.msg_type = msg_type
        self.topic, self.topic_name = topic, node.names.resolve(topic)
        self.qos_profile = qos_profile
        self.raw = raw
        self.callback = callback
        check_arguments(callback, 1)
        self._reader = node.context.participant.reader(
            f'rt{self.topic_name}', msg_type.__msgtype__, to_dds(qos_profile)
        )
        self._events = Events(self._reader, callbacks, node.logger, self.topic_name)

    def execute(self) -> bool:
        """Run the callback for the next message; return whether there was one."""
        taken = self._reader.take(self._read)
        if taken is None or self._closed:
            return False
        if taken.value is None:
            self._count_invalid(self.topic_name, self.msg_type)
        else:
            self.callback(taken.value)
        return True

    def _read(self, data: memoryview) -> Any:
        return bytes(data) if self.raw else decode_or_none(data, self.msg_type)

    def get_publisher_count(self) -> int:
        """Return the number of matched publishers."""
        return 0 if self._closed else len(self._reader.matched)

    def waitables(self) -> list[Waitable]:
        """Return the entities to wait for."""
        return [Waitable(self._reader.condition, self.execute), self._events.waitable()]

    def gids(self) -> tuple[list[bytes], list[bytes]]:
        """Return the GIDs of the readers and of the writers to announce in the graph."""
        return [self._reader.gid], []

    def close(self) -> None:
        """Delete the DDS entities."""
        self._closed = True
        self._reader.close()
