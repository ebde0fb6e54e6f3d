# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads by which a restarted node asks for the messages that it missed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ratslam_ros.messages.json_schema import (
    SCHEMA_VERSION,
    MalformedMessage,
    check_range,
    check_types,
    decode_fields,
    encode_json,
)

MAX_STAMP_NS = 2**63 - 1
MAX_ENTRIES = 20
"""Largest accepted number of topics or streams in one message; the nodes have up to four."""
MAX_NAME = 200
"""Largest accepted length of a name, in characters."""
RESEND, RESENT = 'ratslam/resend', 'ratslam/resent'
"""Topics of the requests and of the answers."""


def resent_topic(topic: str) -> str:
    """Return the topic on which the messages of a topic are sent again.

    It is a topic of its own, because no other subscriber expects old messages.
    """
    return f'{RESENT}/{topic.lstrip("/")}'


@dataclass(frozen=True)
class ResendRequest:
    """Request of a node that continues from a saved state.

    number: identifies the request; it is repeated until it is answered. node: name of the node.
    after: last stamp in ns that the node has, by topic. repeats: streams that the node may send
    again, as it repeats its work since ``since_ns``. done: the node has caught up.
    """

    number: int
    node: str
    after: Mapping[str, int] = field(default_factory=dict)
    repeats: tuple[str, ...] = ()
    since_ns: int = 0
    done: bool = False


@dataclass(frozen=True)
class ResendAnswer:
    """Answer to a request, once everything that it asked for has been sent or saved.

    number: that of the request. node: the node that answers. counts: number of messages sent
    again, by topic; a topic that is missing has another source. complete: whether no message after
    the requested stamp was missing.
    """

    number: int
    node: str
    counts: Mapping[str, int] = field(default_factory=dict)
    complete: bool = True


def encode_request(request: ResendRequest) -> str:
    """Return the payload of ``ratslam/resend``."""
    return encode_json({
        'schema_version': SCHEMA_VERSION, 'number': request.number, 'node': request.node,
        'after': dict(request.after), 'repeats': list(request.repeats),
        'since': request.since_ns, 'done': request.done,
    })  # fmt: skip


def decode_request(payload: str) -> ResendRequest:
    """Return a ``ratslam/resend`` payload; raises MalformedMessage."""
    fields = decode_fields(payload, RESEND, {
        'number': int, 'node': str, 'after': dict, 'repeats': list, 'since': int, 'done': bool,
    })  # fmt: skip
    _check_head(RESEND, fields)
    check_range(RESEND, 'since', fields['since'], 0, MAX_STAMP_NS)
    repeats = fields['repeats']
    if len(repeats) > MAX_ENTRIES or not all(isinstance(name, str) for name in repeats):
        raise MalformedMessage(f'{RESEND}: repeats is not a list of up to {MAX_ENTRIES} names')
    return ResendRequest(
        fields['number'], fields['node'], _stamps(RESEND, 'after', fields['after']),
        tuple(repeats), fields['since'], fields['done'],
    )  # fmt: skip


def encode_answer(answer: ResendAnswer) -> str:
    """Return the payload of ``ratslam/resent``."""
    return encode_json({
        'schema_version': SCHEMA_VERSION, 'number': answer.number, 'node': answer.node,
        'counts': dict(answer.counts), 'complete': answer.complete,
    })  # fmt: skip


def decode_answer(payload: str) -> ResendAnswer:
    """Return a ``ratslam/resent`` payload; raises MalformedMessage."""
    fields = decode_fields(
        payload, RESENT, {'number': int, 'node': str, 'counts': dict, 'complete': bool}
    )
    _check_head(RESENT, fields)
    counts = _stamps(RESENT, 'counts', fields['counts'])
    return ResendAnswer(fields['number'], fields['node'], counts, fields['complete'])


def _check_head(name: str, fields: dict[str, Any]) -> None:
    check_range(name, 'number', fields['number'], 0, MAX_STAMP_NS)
    if len(fields['node']) > MAX_NAME:
        raise MalformedMessage(f'{name}: node is longer than {MAX_NAME} characters')


def _stamps(name: str, key: str, values: dict[str, Any]) -> dict[str, int]:
    """Return a dictionary of non-negative integers after checking it."""
    if len(values) > MAX_ENTRIES:
        raise MalformedMessage(f'{name}: {key} has more than {MAX_ENTRIES} entries')
    for topic, value in values.items():
        check_types({topic: value}, name, {topic: int})
        check_range(name, f'{key}.{topic[:MAX_NAME]}', value, 0, MAX_STAMP_NS)
    return values
