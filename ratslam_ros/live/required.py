# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ends of processes in the launch files of ROS 2, whose ``Shutdown`` always exits with 0."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ratslam_ros.errors import UNUSABLE


def ending_launch(name: str, is_restarted: bool = False) -> Callable[[Any, Any], None]:
    """Return a handler for ``on_exit`` of a process that the launch cannot do without.

    When the process ends, the handler raises an error: launch then prints its text in one line,
    stops all other processes, and exits with 1. While launch is stopping, it does nothing.

    Args:
        name: the process.
        is_restarted: launch starts the process again if it fails, unless by ``UNUSABLE``.
    """

    def on_exit(event: Any, context: Any) -> None:
        fails = event.returncode not in (0, UNUSABLE)
        if not context.is_shutdown and not (is_restarted and fails):
            raise RuntimeError(f'{name} has ended {ending(event.returncode)}')

    return on_exit


def ending(code: int) -> str:
    """Describe an exit code."""
    return f'by signal {-code}' if code < 0 else f'with code {code}'
