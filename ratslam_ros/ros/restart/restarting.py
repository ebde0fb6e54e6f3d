# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes that are being restarted, by what they announce."""

from __future__ import annotations

import time

from ratslam_ros.messages.restarts import Restart

TIMEOUT_S = 20.0
"""Longest time to wait for a restarted process to catch up."""


class Restarting:
    """Table of the processes that have announced a restart, and not yet its end."""

    def __init__(self) -> None:
        self._until_s: dict[tuple[str, ...], float] = {}

    def note(self, restart: Restart) -> None:
        """Note an announcement; answers to others mean nothing here."""
        if restart.done:
            self._until_s.pop(restart.nodes, None)
        elif not restart.heard:
            self._until_s[restart.nodes] = time.monotonic() + TIMEOUT_S

    def __bool__(self) -> bool:
        """Whether a process is being restarted."""
        now_s = time.monotonic()
        return any(now_s < end_s for end_s in self._until_s.values())
