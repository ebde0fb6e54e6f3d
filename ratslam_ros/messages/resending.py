# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads by which a restarted node asks for the messages that it missed."""

from __future__ import annotations

from typing import Annotated, ClassVar

from msgspec import Meta, field

from ratslam_ros.messages.json_schema import Count, Payload, decode, encode

MAX_ENTRIES = 20
"""Largest accepted number of topics or streams in one message; the nodes have up to four."""
RESEND, RESENT = 'ratslam/resend', 'ratslam/resent'
"""Topics of the requests and of the answers."""

_Name = Annotated[str, Meta(max_length=200)]
_Counts = Annotated[dict[_Name, Count], Meta(max_length=MAX_ENTRIES)]


def resent_topic(topic: str) -> str:
    """Return the topic on which the messages of a topic are sent again.

    It is a topic of its own, because no other subscriber expects old messages.
    """
    return f'{RESENT}/{topic.lstrip("/")}'


class ResendRequest(Payload, frozen=True):
    """Request of a node that continues from a saved state.

    number: identifies the request; it is repeated until it is answered. node: name of the node.
    after: last stamp in ns that the node has, by topic. repeats: streams that the node may send
    again, as it repeats its work since ``since_ns``. done: the node has caught up.
    """

    TOPIC: ClassVar[str] = RESEND
    number: Count
    node: _Name
    after: _Counts = field(default_factory=dict)
    repeats: Annotated[tuple[_Name, ...], Meta(max_length=MAX_ENTRIES)] = ()
    since_ns: Count = field(name='since', default=0)
    done: bool = False


class ResendAnswer(Payload, frozen=True):
    """Answer to a request, once everything that it asked for has been sent or saved.

    number: that of the request. node: the node that answers. counts: number of messages sent
    again, by topic; a topic that is missing has another source. complete: whether no message after
    the requested stamp was missing.
    """

    TOPIC: ClassVar[str] = RESENT
    number: Count
    node: _Name
    counts: _Counts = field(default_factory=dict)
    complete: bool = True


encode_request = encode_answer = encode


def decode_request(payload: str) -> ResendRequest:
    """Return a ``ratslam/resend`` payload; raises MalformedMessage."""
    return decode(ResendRequest, payload)


def decode_answer(payload: str) -> ResendAnswer:
    """Return a ``ratslam/resent`` payload; raises MalformedMessage."""
    return decode(ResendAnswer, payload)
