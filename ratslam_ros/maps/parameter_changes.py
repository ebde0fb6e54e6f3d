# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the map that are set while a node runs: the record of those in force."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping
from typing import Any, NamedTuple

from ratslam_ros.core.config import DECLARATIONS, Config, Value

MAX_CHANGES = 1000
"""Number of latest changes that are kept in the record."""


class ParameterChange(NamedTuple):
    """A value that holds from a stamp on, see pipeline/commands.py; ``key``: section.name."""

    stamp_ns: int
    key: str
    value: Value

    def __str__(self) -> str:
        return f'{self.key} {self.value} from {self.stamp_ns * 1e-9:.3f} s'


class ParameterChanges:
    """Record of the changes in force."""

    def __init__(self, sections: Collection[str], config: Config) -> None:
        """Start without changes.

        Args:
            sections: sections of the node.
            config: parameters with which it starts.
        """
        self._keys = [
            key for key, (info, _) in DECLARATIONS.items()
            if info.runtime == 'at next message' and key.partition('.')[0] in sections
        ]  # fmt: skip
        self._in_force = config
        self.record: list[ParameterChange] = []
        """Changes that were made while the present memory was learned, oldest first."""

    def differences(self, before: Config, now: Config) -> dict[str, Value]:
        """Return the new values that take effect with a message, by ``section.name``."""
        old, new = before.flat(), now.flat()
        return {key: new[key] for key in self._keys if new[key] != old[key]}

    def pending(self, config: Config) -> dict[str, Value]:
        """Return the values that are not in force yet, by ``section.name``."""
        return self.differences(self._in_force, config)

    def record_change(self, config: Config, from_ns: int) -> list[ParameterChange]:
        """Record and return what parameters change that hold from a stamp on."""
        values = self.pending(config)
        changes = [ParameterChange(from_ns, key, value) for key, value in values.items()]
        self._in_force = config
        self.record = [*self.record, *changes][-MAX_CHANGES:]
        return changes

    def start_over(self, config: Config, record: Iterable[Any] = ()) -> None:
        """Continue with a memory that was created with the present parameters.

        Args:
            config: the present parameters.
            record: ``state`` of the memory.
        """
        self._in_force = config
        self.record = [ParameterChange(int(at), str(key), value) for at, key, value in record]

    def state(self) -> list[list[Value]]:
        """Return the record, for ``start_over``."""
        return [list(change) for change in self.record]


def encode_values(values: Mapping[str, Value]) -> bytes:
    """Return values by ``section.name`` for the log of a process."""
    return json.dumps(values).encode()


def decode_values(data: bytes) -> Mapping[str, Value]:
    """Return what ``encode_values`` has written; {} if it is damaged."""
    try:
        values = json.loads(data)
    except ValueError:
        return {}
    return values if isinstance(values, dict) else {}
