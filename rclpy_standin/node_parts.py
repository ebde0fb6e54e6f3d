# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the parts of a node."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, NamedTuple

from rclpy_standin.exceptions import InvalidHandle, RCLError

INVALID_SAMPLE = 'dropped a sample that is not a valid'
"""Beginning of the log message; the name of the type follows."""


class Waitable(NamedTuple):
    """A DDS entity that an executor waits for, and the function to run when it triggers."""

    reference: int
    run: Callable[[], bool]
    """Returns whether there was something to do."""


class NodePart:
    """A publisher, subscription, service, client or timer of a node."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._closed = False
        self._invalid_count = 0

    def waitables(self) -> list[Waitable]:
        """Return the entities to wait for."""
        return []

    def gids(self) -> tuple[list[bytes], list[bytes]]:
        """Return the GIDs of the readers and of the writers to announce in the graph."""
        return [], []

    def close(self) -> None:
        """Delete the DDS entities."""

    def destroy(self) -> None:
        """Remove the part from its node, and delete it."""
        self._node.discard(self)

    def _count_invalid(self, name: str, kind: Any) -> None:
        """Count an invalid sample; log the first, and then whenever the count has doubled."""
        self._invalid_count += 1
        if self._invalid_count & (self._invalid_count - 1) == 0:
            self._node.logger.error(
                f'{name}: {INVALID_SAMPLE} {kind.__msgtype__} ({self._invalid_count} so far)'
            )

    def _check_alive(self) -> None:
        if self._closed:
            raise InvalidHandle('cannot use it because destruction was requested')
        if not self._node.context.ok():
            raise RCLError("the node's context is invalid: it was shut down")


def check_arguments(callback: Any, count: int) -> None:
    """Check that a callback accepts a number of arguments.

    Raises:
        RuntimeError: the callback does not accept them.
        NotImplementedError: the callback is a coroutine function.
    """
    if inspect.iscoroutinefunction(callback):
        raise NotImplementedError('the stand-in for rclpy does not support async callbacks')
    try:
        signature = inspect.signature(callback)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(*[None] * count)
    except TypeError:
        raise RuntimeError(f'{callback!r}: expected a function of {count} arguments') from None
