# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads of commands that have taken effect, and of the stream between processes."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from msgspec import Meta

from ratslam_ros.messages.json_schema import Count, Payload, Stamp


class CommandPayload(Payload, frozen=True):
    """A command: what changes a stage and is no input."""

    TOPIC: ClassVar[str] = 'ratslam/command'
    stamp: Stamp
    """Stamp at which it took effect; 0 before the first input."""
    command: Annotated[dict[str, Any], Meta(examples=[{'SetPaused': [True, 'local_view']}])]
    """Its name, and its values as in pipeline/commands.py."""

    @classmethod
    def of(cls, stamp_ns: int, command: dict[str, Any]) -> CommandPayload:
        """Return the payload of a command from ``command_state`` in pipeline/codec.py."""
        return cls(Stamp.of(stamp_ns), command)


class PassedItem(Payload, frozen=True):
    """An item of the stream that a process passes on to the one that follows it."""

    TOPIC: ClassVar[str] = 'local_view/stream'
    run: Annotated[Count, Meta(examples=[1_700_000_000_000_000_000])]
    """When the numbers began, in ns. A sender that was killed goes on with the same run, and sends
    the same items with the same numbers again; one that cannot begins another run."""
    number: Annotated[Count, Meta(examples=[125])]
    """Of the item, from 1; of a cut, that of the last item before it."""
    stream: Annotated[str, Meta(max_length=40, examples=['odometry'])]
    """Name of the stream, `command`, or `cut`: the state is saved."""
    stamp: Stamp
    """Stamp of the item."""
    item: Annotated[bytes, Meta(examples=['acA='])]
    """As in the log, see pipeline/codec.py; of a cut, its number in decimal digits."""


def stream_topic(node: str) -> str:
    """Return the topic of the stream that the process of a node passes on."""
    return f'{node}/stream'
