# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Saving and loading the map of all nodes in one operation.

The experience map coordinates: it receives requests, sends commands to all nodes that learn, and
publishes progress and result. All nodes save the same cut, so that the states belong together. If
one of them cannot load, all return to what they had.
"""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from ratslam_ros.core.common.state import State
from ratslam_ros.errors import RatslamError, UnusableInput
from ratslam_ros.files.config import combined_yaml
from ratslam_ros.maps import live_meta, read_map, save_map
from ratslam_ros.maps.cut_grid import index_of
from ratslam_ros.messages.map_commands import (
    DEFAULT_NAME,
    LOAD,
    MAX_TEXT,
    SAVE,
    SUFFIX,
    UNDO,
    MapCommand,
    MapRequest,
    MapResult,
    MapStatus,
    Progress,
    map_path,
)
from ratslam_ros.pipeline.commands import Relocated
from ratslam_ros.ros.host import Host
from ratslam_ros.ros.host_map import own_yaml
from ratslam_ros.ros.hosted_node import HostedNode
from ratslam_ros.ros.qos import GOAL, LATCHED

TIMEOUT_S = 60.0
"""Longest time of an operation: writing or reading the largest maps takes seconds."""

LEAD_CUTS = 1
"""Distance of the saved cut from the present one: no node has passed it when the command comes."""


def part_path(path: Path, number: int, part: str) -> Path:
    """Return the temporary file of a part of a map that is being saved."""
    return path.with_name(f'.{path.name}.{number}') / f'{part}{SUFFIX}'


class MapOperations:
    """Saves and loads the part of one node on command."""

    def __init__(self, node: HostedNode, host: Host) -> None:
        """Subscribe to the commands, and offer the services of the node."""
        self.node, self.host = node, host
        self._results = node.create_payload_publisher(MapResult, GOAL)
        self._saving: MapCommand | None = None
        self._writing: threading.Thread | None = None
        self._previous: State | None = None
        node.create_payload_subscription(MapCommand, self._on_command, GOAL)
        node.offer(f'{node.SECTION}/save', self._on_save, is_logged=True)
        node.offer(f'{node.SECTION}/load', self._on_load, is_logged=True)
        host.on_cut.append(self._reach)

    def close(self) -> None:
        """Wait until a state that is being written is saved and reported."""
        if self._writing is not None:
            self._writing.join()

    def path_of(self, name: str) -> Path:
        """Return the path of a map."""
        return map_path(self.node.config.memory.memory_folder, name)

    def _reach(self, number: int | None) -> None:
        """Save the state if that was requested for a cut that is due, or at a pause."""
        if self._saving is not None and (number is None or number >= self._saving.cut):
            self._save()

    def _on_command(self, command: MapCommand) -> None:
        if command.operation == SAVE:
            self._saving = command
        elif command.operation == LOAD:
            previous = self.host.live.state_of(self.node.SECTION)
            is_loaded = self._carry_out(command, partial(self.load, self.path_of(command.name)))
            self._previous = previous if is_loaded else None
        elif self._previous is not None:
            self.replace_memory(self._previous)
            self._previous = None

    def _save(self) -> None:
        """Write the state to a file of its own, from which the coordinator builds the map."""
        command, self._saving = self._saving, None
        assert command is not None
        part = self.node.SECTION
        states, meta = {part: self.host.live.state_of(part)}, live_meta(own_yaml(self.node))
        path = part_path(self.path_of(command.name), command.number, part)

        def write() -> str:
            save_map(path, states, meta)
            return f'{part} is written'

        self._writing = threading.Thread(target=self._carry_out, args=(command, write))
        self._writing.start()

    def _carry_out(self, command: MapCommand, work: Callable[[], str]) -> bool:
        """Do the part of this node, and answer with its result; return whether it succeeded."""
        try:
            text, success = work(), True
        except RatslamError as error:
            text, success = str(error), False
        except Exception as error:  # a defect must not leave the others waiting
            text, success = f'{command.operation} of {command.name} has failed: {error!r}', False
        self.node.report(success, text)
        name = self.node.get_name()
        self._results.publish(MapResult(command.number, name, success, text[:MAX_TEXT]))
        return success

    def load(self, path: Path) -> str:
        """Replace the state by that in a file; return a report.

        Raises:
            RatslamError: that is impossible; the state is the same.
        """
        states, part = read_map(path).states, self.node.SECTION
        if part not in states:
            raise UnusableInput(
                f'{path} has no part of {part}; it has those of {", ".join(states)}'
            )
        try:
            self.replace_memory(states[part])
        except RatslamError:
            raise
        except KeyError as error:
            raise UnusableInput(
                f'{path} has no {error.args[0]!r}: it was written by an older version of '
                'ratslam_ros; map again and save'
            ) from None
        except Exception as error:  # the content can be anything; the node keeps its memory
            raise UnusableInput(f'{path} does not fit: {error!r}') from None
        return f'loaded from {path}'

    def replace_memory(self, state: State) -> None:
        """Continue with another memory; raise and change nothing if it cannot be used."""
        part = self.node.SECTION
        with self.host.ready() as live:
            live.replace(part, state)
            self.node.drop_tasks()
            live.command(Relocated(part))

    def _on_save(self) -> str:
        part = self.node.SECTION
        with self.host.ready() as live:
            live.finish()
            states = {part: live.state_of(part)}
            save_map(self._own_path, states, live_meta(own_yaml(self.node)))
        return f'saved to {self._own_path}'

    def _on_load(self) -> str:
        text = self.load(self._own_path)
        self.node.diagnostics.clear()
        return text

    @property
    def _own_path(self) -> Path:
        name = self.node.get_fully_qualified_name().lstrip('/').replace('/', '.')
        return Path(self.node.config.memory.memory_folder).expanduser() / f'{name}{SUFFIX}'


class MapCoordinator:
    """Carries out requests to save and load the map of all nodes, one after the other."""

    def __init__(self, operations: MapOperations) -> None:
        """Create the topics and services, in the node of these operations."""
        self._operations = operations
        self._node = node = operations.node
        self._commands = node.create_payload_publisher(MapCommand, GOAL)
        self._status = node.create_payload_publisher(MapStatus, LATCHED)
        self._command: MapCommand | None = None
        """That of the present operation."""
        self._nodes: list[str] = []
        """Names of the nodes that take part."""
        self._results: dict[str, MapResult] = {}
        self._is_closed = False
        self._changed = threading.Condition()
        self._finishing: threading.Thread | None = None
        node.create_payload_subscription(MapRequest, self._begin, GOAL)
        node.create_payload_subscription(MapResult, self._on_result, GOAL)
        for operation in (SAVE, LOAD):
            begin = partial(self._begin, MapRequest(operation, DEFAULT_NAME))
            node.offer(f'ratslam/{operation}_map', begin)

    def close(self) -> None:
        """End the present operation without the results that are missing."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        if self._finishing is not None:
            self._finishing.join()

    @property
    def _waiting(self) -> list[str]:
        """Names of the nodes that have not answered."""
        return [name for name in self._nodes if name not in self._results]

    def _begin(self, request: MapRequest) -> str:
        path = self._operations.path_of(request.name)
        operation = f'{request.operation} of {path}'
        with self._changed:
            if self._command is not None:
                raise UnusableInput(f'busy: {self._command.operation} of {self._command.name}')
            if request.operation == LOAD and not path.exists():
                raise UnusableInput(f'{path} does not exist; save first')
            self._nodes, self._results = self._learners(), {}
            cut = index_of(self._operations.host.map.grid.now()) + LEAD_CUTS
            self._command = MapCommand(time.time_ns(), request.operation, request.name, cut)
            self._commands.publish(self._command)
            self._report(self._command, 'running', f'{operation} has begun')
            self._finishing = threading.Thread(target=self._finish, args=(self._command, path))
            self._finishing.start()
        return f'{operation}; the result follows on {MapStatus.TOPIC}'

    def _learners(self) -> list[str]:
        """Return the names of the nodes that take part: those that publish results."""
        topic = self._node.resolve_topic_name(MapResult.TOPIC)
        return sorted(
            {info.node_name for info in self._node.get_publishers_info_by_topic(topic)}
        )

    def _on_result(self, result: MapResult) -> None:
        with self._changed:
            command = self._command
            if command is not None and result.number == command.number:
                self._results[result.node] = result
                self._report(command, 'running', result.message)
                self._changed.notify_all()

    def _finish(self, command: MapCommand, path: Path) -> None:
        """Carry out an operation and report the result; whatever happens, it ends."""
        problems = ['an error of this program, see the log of the node']
        try:
            problems = self._carried_out(command, path)
        finally:
            done = 'saved to' if command.operation == SAVE else 'loaded from'
            whose = ', '.join(self._nodes)
            text = '; '.join(problems) or f'the map of {whose} is {done} {path}'
            with self._changed:  # no late result follows, and another operation may begin
                self._report(command, 'failed' if problems else 'done', text)
                self._node.report(not problems, text)
                self._command = None

    def _carried_out(self, command: MapCommand, path: Path) -> list[str]:
        """Wait until all nodes have answered, or that takes too long; return what failed."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_closed or not self._waiting, TIMEOUT_S)
            failed = [one for one in self._results.values() if not one.success]
            texts = [f'{one.node}: {one.message}' for one in failed]
            texts += [f'{name} does not answer' for name in self._waiting]
        if command.operation == SAVE:
            self._write(command, path, texts)
        elif texts:
            self._commands.publish(MapCommand(command.number, UNDO, command.name, 0))
            texts.append('all nodes keep the map that they had')
        return texts

    def _write(self, command: MapCommand, path: Path, texts: list[str]) -> None:
        """Build the map file from the files of the parts; an earlier map stays until then."""
        folder = part_path(path, command.number, '').parent
        try:
            if not texts:
                states: dict[str, State] = {}
                configuration = ''
                for file in sorted(folder.glob(f'*{SUFFIX}')):
                    saved = read_map(file)
                    states |= saved.states
                    configuration = combined_yaml(configuration, saved.meta.configuration)
                save_map(path, states, live_meta(configuration))
        except (RatslamError, OSError) as error:
            texts.append(str(error))
        shutil.rmtree(folder, ignore_errors=True)

    def _report(self, command: MapCommand, state: Progress, text: str) -> None:
        self._status.publish(MapStatus(
            command.operation, command.name, state, sorted(self._results), self._waiting,
            text[:MAX_TEXT],
        ))
