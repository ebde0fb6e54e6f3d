# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The internal state of a node: its parts, its executor and its place in the graph.

Separate from Node, because subclasses of Node may define attributes of any name.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any, TypeVar

from rclpy_standin import logging
from rclpy_standin.arguments import Names
from rclpy_standin.context import Context
from rclpy_standin.graph import NodeName
from rclpy_standin.node_parts import NodePart, Waitable

Part = TypeVar('Part', bound=NodePart)


class NodeHandle:
    """Interface of a node to the graph, to executors and to its own parts."""

    def __init__(self, context: Context, names: Names) -> None:
        """Announce the node in the graph."""
        self.context = context
        self.names = names
        self.graph_name = NodeName(names.node, names.namespace)
        self.logger = logging.get_logger(names.full[1:].replace('/', '.'))
        self.executor: Any = None
        self._parts: dict[NodePart, None] = {}
        self._lock = threading.RLock()
        context.nodes.add(self)
        context.graph.add_node(self.graph_name)

    @property
    def is_open(self) -> bool:
        """Whether the node can still send messages."""
        return self.context.ok() and self in self.context.nodes

    def add(self, part: Part) -> Part:
        """Add a part, and announce its endpoints."""
        with self._lock:
            self._parts[part] = None
        readers, writers = part.gids()
        if readers or writers:
            self.context.graph.add(self.graph_name, readers, writers)
        self._notify_executor()
        return part

    def discard(self, part: NodePart) -> bool:
        """Destroy a part; return whether it belonged to the node."""
        with self._lock:
            if part not in self._parts:
                return False
            del self._parts[part]
        readers, writers = part.gids()
        if readers or writers:
            self.context.graph.remove(self.graph_name, [*readers, *writers])
        self._notify_executor()
        part.close()
        return True

    def parts(self, kind: type[Part]) -> Iterator[Part]:
        """Return the parts of one class."""
        with self._lock:
            return iter([part for part in self._parts if isinstance(part, kind)])

    def waitables(self) -> list[Waitable]:
        """Return the entities that an executor waits for."""
        with self._lock:
            return [waitable for part in self._parts for waitable in part.waitables()]

    def wake(self) -> None:
        """End the wait of the executor, which then checks the timers again."""
        executor = self.executor
        if executor is not None:
            executor.wake()

    def forget_executor(self, executor: Any) -> None:
        """Clear the executor if it is this one."""
        if self.executor is executor:
            self.executor = None

    def close(self) -> None:
        """Destroy the node and its parts; further calls do nothing."""
        if self not in self.context.nodes:
            return
        logging.set_publisher(self.logger.name, None)
        with self._lock:
            parts, self._parts = list(self._parts), {}
        for part in reversed(parts):
            part.close()
        self.context.graph.remove_node(self.graph_name)
        self.context.nodes.discard(self)
        self.context.close_if_unused()

    def _notify_executor(self) -> None:
        executor = self.executor
        if executor is not None:
            executor.entities_changed()
