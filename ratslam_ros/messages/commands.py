# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads of commands that have taken effect, and of the stream between processes."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from msgspec import Meta

from ratslam_ros.messages.json_schema import Count, Payload, Stamp, about


class CommandPayload(Payload, frozen=True):
    """A command: what changes a stage and is no input."""

    TOPIC: ClassVar[str] = 'ratslam/command'
    stamp: Annotated[Stamp, about('stamp at which it took effect; 0 before the first input')]
    command: Annotated[dict[str, Any], about(
        'its name, and its values as in pipeline/commands.py',
        {'SetPaused': [True, 'local_view']},
    )]

    @classmethod
    def of(cls, stamp_ns: int, command: dict[str, Any]) -> CommandPayload:
        """Return the payload of a command from ``command_state`` in pipeline/codec.py."""
        return cls(Stamp.of(stamp_ns), command)


class PassedItem(Payload, frozen=True):
    """An item of the stream that a process passes on to the one that follows it."""

    TOPIC: ClassVar[str] = 'local_view/stream'
    run: Annotated[Count, about(
        'when the numbers began, in ns. A sender that was killed goes on with the same run, and '
        'sends the same items with the same numbers again; one that cannot begins another run',
        1_700_000_000_000_000_000,
    )]
    number: Annotated[Count, about(
        'of the item, from 1; of a cut, that of the last item before it', 125
    )]
    stream: Annotated[str, Meta(max_length=40), about(
        'name of the stream, `command`, or `cut`: the state is saved', 'odometry'
    )]
    stamp: Annotated[Stamp, about('stamp of the item')]
    item: Annotated[bytes, about(
        'as in the log, see pipeline/codec.py; of a cut, its number in decimal digits', 'acA='
    )]


def stream_topic(node: str) -> str:
    """Return the topic of the stream that the process of a node passes on."""
    return f'{node}/stream'
