# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the entries of a log mean, for a process that catches up and for a replay of its log."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from ratslam_ros.core.config import Value
from ratslam_ros.maps.input_log import Entry
from ratslam_ros.maps.logged_items import decode_item
from ratslam_ros.maps.parameter_changes import decode_values
from ratslam_ros.pipeline.commands import Command
from ratslam_ros.pipeline.pipeline import COMMAND, Pipeline

FINISH, PATIENT, PARAMETERS, REPLACED = 'finish', 'patient', '_parameters', 'replaced'
"""Entries that are no items: held inputs were processed; inputs wait longer (b'1') or not; with
the name of a section before it, parameters were set; the memory of a part was replaced
(kept_log.py)."""


class Receiver(Protocol):
    """A pipeline of a live process, or of a replay of what it has received."""

    pipeline: Pipeline

    def take(self, stream: str, stamp_ns: int, item: Any) -> None:
        """Take an input."""

    def answer(self, stream: str, item: Any) -> None:
        """Take an answer."""

    def command(self, command: Command, stamp_ns: int) -> None:
        """Take a command."""

    def finish(self) -> None:
        """Process the inputs that wait."""

    def set_patient(self, is_patient: bool) -> None:
        """Let inputs wait longer for others, or not."""

    def set_values(self, section: str, values: Mapping[str, Value]) -> None:
        """Set parameters of the part with a section."""

    def replaced(self, data: bytes) -> None:
        """Replace the memory of a part, see kept_log.py."""


def receive(entry: Entry, to: Receiver) -> None:
    """Let an entry be received again.

    Raises:
        MalformedMessage: its item is damaged.
    """
    stream, stamp_ns, data = entry
    if stream in to.pipeline.inputs:
        to.take(stream, stamp_ns, decode_item(data))
    elif stream in to.pipeline.answers:
        to.answer(stream, decode_item(data))
    elif stream == COMMAND:
        to.command(decode_item(data), stamp_ns)
    elif stream == FINISH:
        to.finish()
    elif stream == PATIENT:
        to.set_patient(bool(data))
    elif stream == REPLACED:
        to.replaced(data)
    elif stream.endswith(PARAMETERS):
        to.set_values(stream.removesuffix(PARAMETERS), decode_values(data))
