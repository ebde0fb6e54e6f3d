# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publishing and receiving messages with a JSON payload; those that cannot be used are refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from ratslam_ros.errors import RatslamError
from ratslam_ros.messages.json_schema import Payload, decode, encode

P = TypeVar('P', bound=Payload)


class PayloadPublisher(Generic[P]):
    """Publishes payloads of one class."""

    def __init__(self, node: Node, kind: type[P], qos: QoSProfile, topic: str = '') -> None:
        self._publisher = node.create_publisher(String, topic or kind.TOPIC, qos)

    def publish(self, payload: P) -> None:
        """Publish a payload."""
        self._publisher.publish(String(data=encode(payload)))

    def get_subscription_count(self) -> int:
        """Return the number of subscriptions."""
        return int(self._publisher.get_subscription_count())


def decoded(
    kind: type[P], take: Callable[[P], object], refuse: Callable[[str, str], None],
    stream: str = '',
) -> Callable[[String], None]:
    """Return a callback that decodes messages, see ``refusing``; malformed ones are refused too.

    Args:
        kind: the payload.
        take: called with each payload; raises RatslamError if it cannot be used.
        refuse: called with the name of the stream and the reason if a message is refused.
        stream: name of the stream, '' for that of the topic.
    """
    return refusing(
        lambda message: take(decode(kind, message.data)), refuse, stream or kind.TOPIC
    )


def refusing(
    take: Callable[[Any], object], refuse: Callable[[str, str], None], stream: str
) -> Callable[[Any], None]:
    """Return a callback that refuses messages that cannot be used.

    Args:
        take: called with each message; raises RatslamError if it cannot be used.
        refuse: called with the name of the stream and the reason if a message is refused.
        stream: name of the stream.
    """

    def receive(message: Any) -> None:
        try:
            take(message)
        except RatslamError as error:
            refuse(stream, str(error))

    return receive
