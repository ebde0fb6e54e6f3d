# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the parts of a node have in common, and callback groups."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, NamedTuple

from ratslam_ros.standalone.exceptions import InvalidHandle, RCLError

UNREADABLE = 'what came is left out, as it is no'


class Source(NamedTuple):
    """Something an executor waits for, and what it then calls."""

    reference: int
    run: Callable[[], bool]
    """Returns whether there was anything to do."""


class CallbackGroup:
    """Which callbacks may run at the same time: none, as there is one thread."""


class MutuallyExclusiveCallbackGroup(CallbackGroup):
    """Callbacks one at a time."""


class ReentrantCallbackGroup(CallbackGroup):
    """Callbacks that could run at the same time, if there were more than one thread."""


class NodePart:
    """Something that belongs to a node until it is destroyed."""

    def __init__(self, node: Any, callback_group: CallbackGroup | None = None) -> None:
        self._node = node
        self._closed = False
        self.callback_group = callback_group or node.default_callback_group

    def sources(self) -> list[Source]:
        """Return what to wait for."""
        return []

    def gids(self) -> tuple[list[bytes], list[bytes]]:
        """Return the readers and writers that the graph is told of."""
        return [], []

    def close(self) -> None:
        """Let go of what DDS holds."""

    def destroy(self) -> None:
        """Take it from its node."""
        self._node.discard(self)

    def _check_alive(self) -> None:
        if self._closed:
            raise InvalidHandle('cannot use it because destruction was requested')
        if not self._node.context.ok():
            raise RCLError("the node's context is invalid: it was shut down")


def callable_with(callback: Any, *counts: int) -> int:
    """Return how many of ``counts`` arguments a callback takes, the first that fits.

    Raises:
        RuntimeError: it takes another number of them.
        NotImplementedError: it is a coroutine.
    """
    if inspect.iscoroutinefunction(callback):
        raise NotImplementedError('the stand-in for rclpy does not offer async callbacks')
    try:
        signature = inspect.signature(callback)
    except (TypeError, ValueError):
        return counts[0]
    for count in counts:
        try:
            signature.bind(*[None] * count)
        except TypeError:
            continue
        return count
    raise RuntimeError(
        f'{callback!r}: expected a function of {" or ".join(map(str, counts))} arguments'
    )
