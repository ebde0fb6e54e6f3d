# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Callbacks of messages with a JSON payload, of which malformed ones are refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from std_msgs.msg import String

from ratslam_ros.messages.json_schema import MalformedMessage, Payload, decode

P = TypeVar('P', bound=Payload)


def decoded(
    kind: type[P], stream: str = ''
) -> Callable[[Callable[[Any, P], None]], Callable[[Any, String], None]]:
    """Return a decorator of methods that take a payload, and then take its message.

    Args:
        kind: the payload.
        stream: name of the stream, '' for that of the topic, with which ``_refuse`` of the object
            gets the reason if a message is malformed.
    """

    def decorate(take: Callable[[Any, P], None]) -> Callable[[Any, String], None]:
        def receive(self: Any, message: String) -> None:
            try:
                payload = decode(kind, message.data)
            except MalformedMessage as error:
                self._refuse(stream or kind.TOPIC, str(error))
            else:
                take(self, payload)

        return receive

    return decorate
