# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payload by which a restarted node announces itself, and topics of histories."""

from __future__ import annotations

from typing import Annotated, ClassVar

from msgspec import Meta

from ratslam_ros.messages.json_schema import Payload, about


def history_topic(topic: str) -> str:
    """Return the topic that keeps the last messages of a topic, for nodes that were restarted."""
    return f'ratslam/history/{topic.lstrip("/")}'


class Restart(Payload, frozen=True):
    """Nodes with a map file have been started, and get what they missed."""

    TOPIC: ClassVar[str] = 'ratslam/restart'
    nodes: Annotated[tuple[Annotated[str, Meta(max_length=200)], ...], Meta(max_length=20), about(
        'the nodes of the process', ['local_view']
    )]  # fmt: skip
    done: Annotated[bool, about('it has caught up', False)] = False
    heard: Annotated[bool, about(
        'not restarted: it has heard that another one is, which waits for this answer', False
    )] = False  # fmt: skip
