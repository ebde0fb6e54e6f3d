# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads by which a restarted node asks for the messages that it missed."""

from __future__ import annotations

from typing import Annotated, ClassVar

from msgspec import Meta, field

from ratslam_ros.messages.json_schema import NS_PER_S, Count, Payload, about

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
    """Request of a node that continues from a saved state."""

    TOPIC: ClassVar[str] = RESEND
    number: Annotated[Count, about(
        'identifies the request, which is repeated until it is answered', 1795412600978450364
    )]  # fmt: skip
    node: Annotated[_Name, about('name of the restarted node', 'local_view')]
    after: Annotated[_Counts, about(
        'last stamp in ns that the node has, by topic; a second request, when its topics are '
        'connected, asks for what was sent meanwhile',
        {'image': 1_700_000_010 * NS_PER_S},
    )] = field(default_factory=dict)  # fmt: skip
    repeats: Annotated[tuple[_Name, ...], Meta(max_length=MAX_ENTRIES), about(
        'streams that the node will send again, as it repeats its work after the stamp `since`; '
        'receivers drop the repetitions', ['template']
    )] = ()  # fmt: skip
    since_ns: Annotated[Count, about(
        'a stamp in ns', 1_700_000_010 * NS_PER_S
    )] = field(name='since', default=0)  # fmt: skip
    done: Annotated[bool, about('the node has caught up', False)] = False


class ResendAnswer(Payload, frozen=True):
    """Answer to a request, once everything that it asked for has been sent or saved."""

    TOPIC: ClassVar[str] = RESENT
    number: Annotated[Count, about('that of the request', 1795412600978450364)]
    node: Annotated[_Name, about('name of the node that answers', 'player')]
    counts: Annotated[_Counts, about(
        'number of messages sent again, by topic; a topic that is missing has another source',
        {'image': 14},
    )] = field(default_factory=dict)  # fmt: skip
    complete: Annotated[bool, about(
        'no message after the requested stamp is missing', True
    )] = True  # fmt: skip
