# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Callbacks of messages with a JSON payload, of which malformed ones are refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from std_msgs.msg import String

from ratslam_ros.messages.json_schema import MalformedMessage

Decoded = TypeVar('Decoded')


def with_text(decode: Callable[[str], Decoded]) -> Callable[[str], tuple[Decoded, str]]:
    """Return a function that returns a decoded payload and its text."""
    return lambda text: (decode(text), text)


def decoded(
    decode: Callable[[str], Decoded], name: str
) -> Callable[[Callable[[Any, Decoded], None]], Callable[[Any, String], None]]:
    """Return a decorator of methods that take a decoded payload, and then take its message.

    Args:
        decode: decodes the payload; raises MalformedMessage.
        name: name of the stream, with which ``_refuse`` of the object gets the reason.
    """

    def decorate(take: Callable[[Any, Decoded], None]) -> Callable[[Any, String], None]:
        def receive(self: Any, message: String) -> None:
            try:
                payload = decode(message.data)
            except MalformedMessage as error:
                self._refuse(name, str(error))
            else:
                take(self, payload)

        return receive

    return decorate
