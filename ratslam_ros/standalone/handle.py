# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is behind a node: its parts, and who must know of them.

Apart from Node, whose subclasses may have attributes of any name.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any, TypeVar

from ratslam_ros.standalone import logging
from ratslam_ros.standalone.arguments import Names
from ratslam_ros.standalone.context import Context
from ratslam_ros.standalone.graph import NodeName
from ratslam_ros.standalone.node_parts import MutuallyExclusiveCallbackGroup, NodePart, Source

Part = TypeVar('Part', bound=NodePart)


class NodeHandle:
    """A node as the graph, executors and its own parts see it."""

    def __init__(self, context: Context, names: Names) -> None:
        """Announce it."""
        self.context = context
        self.names = names
        self.graph_name = NodeName(names.node, names.namespace)
        self.logger = logging.get_logger(names.full[1:].replace('/', '.'))
        self.default_callback_group = MutuallyExclusiveCallbackGroup()
        self.executor: Any = None
        self._parts: dict[NodePart, None] = {}
        self._lock = threading.RLock()
        context.nodes.add(self)
        context.graph.add_node(self.graph_name)

    @property
    def is_open(self) -> bool:
        """Whether it can send anything."""
        return self.context.ok() and self in self.context.nodes

    def add(self, part: Part) -> Part:
        """Take a new part, and announce it."""
        with self._lock:
            self._parts[part] = None
        readers, writers = part.gids()
        if readers or writers:
            self.context.graph.add(self.graph_name, readers, writers)
        self._changed()
        return part

    def discard(self, part: NodePart) -> bool:
        """Take back one part; return whether it was there."""
        with self._lock:
            if part not in self._parts:
                return False
            del self._parts[part]
        readers, writers = part.gids()
        if readers or writers:
            self.context.graph.remove(self.graph_name, [*readers, *writers])
        self._changed()
        part.close()
        return True

    def parts(self, kind: type[Part]) -> Iterator[Part]:
        """Return the parts of one kind."""
        with self._lock:
            return iter([part for part in self._parts if isinstance(part, kind)])

    def sources(self) -> list[Source]:
        """Return what an executor waits for."""
        with self._lock:
            return [source for part in self._parts for source in part.sources()]

    def wake(self) -> None:
        """Have the executor look at the timers again."""
        executor = self.executor
        if executor is not None:
            executor.wake()

    def forget_executor(self, executor: Any) -> None:
        """Belong to an executor no longer, if to this one."""
        if self.executor is executor:
            self.executor = None

    def close(self) -> None:
        """Take back everything; a second time does nothing."""
        if self not in self.context.nodes:
            return
        logging.publish_with(self.logger.name, None)
        with self._lock:
            parts, self._parts = list(self._parts), {}
        for part in reversed(parts):
            part.close()
        self.context.graph.remove_node(self.graph_name)
        self.context.nodes.discard(self)
        self.context.end()

    def _changed(self) -> None:
        executor = self.executor
        if executor is not None:
            executor.change()
