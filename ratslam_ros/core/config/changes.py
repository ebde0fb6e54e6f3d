# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of parameters during a run, each from a stamp on."""

from __future__ import annotations

from collections import deque

from ratslam_ros.core.config.config import Config


class ConfigChanges:
    """Configurations that a part takes over before it processes messages of certain stamps."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[int, Config]] = deque()

    def __len__(self) -> int:
        """Return the number of configurations that are not in force yet."""
        return len(self._waiting)

    def add(self, config: Config, from_ns: int = 0) -> None:
        """Add a configuration, after all that were added before.

        Args:
            config: all parameters.
            from_ns: it holds from the first message with this stamp or a later one on; 0: from
                the next message on.
        """
        self._waiting.append((from_ns, config))

    def due(self, stamp_ns: int) -> list[Config]:
        """Remove and return the configurations to take over before a message, oldest first."""
        found = []
        while self._waiting and self._waiting[0][0] <= stamp_ns:
            found.append(self._waiting.popleft()[1])
        return found
