# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payload of commands that have taken effect in the stages of a process."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from ratslam_ros.messages.json_schema import Payload, Stamp, about


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
