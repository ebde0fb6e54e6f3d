# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Payload of ``ratslam/command``: a command that has taken effect in the stages of a process."""

from __future__ import annotations

from typing import Any, ClassVar

from ratslam_ros.messages.json_schema import Payload, Stamp, decode, encode

NAME = 'ratslam/command'


class _Command(Payload, frozen=True):
    TOPIC: ClassVar[str] = NAME
    stamp: Stamp
    command: dict[str, Any]


def encode_command(stamp_ns: int, command: dict[str, Any]) -> str:
    """Return the payload of a command.

    Args:
        stamp_ns: stamp at which it took effect, 0 before the first input.
        command: its name and values; see ``command_state`` in pipeline/item_states.py.
    """
    return encode(_Command(Stamp.of(stamp_ns), command))


def decode_command(payload: str) -> tuple[int, dict[str, Any]]:
    """Return stamp and command of a payload; raises MalformedMessage."""
    found = decode(_Command, payload)
    return found.stamp.ns, found.command
