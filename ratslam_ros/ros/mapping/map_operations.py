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
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ratslam_ros.core.common.state import State
from ratslam_ros.errors import RatslamError
from ratslam_ros.files.config import combined_yaml
from ratslam_ros.maps import live_meta, read_map, read_part, save_map
from ratslam_ros.maps.cut_grid import CutGrid
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.map_commands import (
    COMMAND,
    DEFAULT_NAME,
    LOAD,
    MAX_TEXT,
    REQUEST,
    RESULT,
    SAVE,
    STATUS,
    SUFFIX,
    UNDO,
    MapCommand,
    MapRequest,
    MapResult,
    MapStatus,
    Operation,
    Progress,
    map_path,
)
from ratslam_ros.ros.decoded import decoded
from ratslam_ros.ros.qos import GOAL, LATCHED

TIMEOUT_S = 60.0
"""Longest time of an operation: writing or reading the largest maps takes seconds."""

CHECK_PERIOD_S = 0.1
LEAD_CUTS = 1
"""Distance of the saved cut from the present one: no node has passed it when the command comes."""


def part_path(path: Path, number: int, part: str) -> Path:
    """Return the temporary file of a part of a map that is being saved."""
    return path.with_name(f'.{path.name}.{number}') / f'{part}{SUFFIX}'


class MapOperations:
    """Saves and loads the part of one node on command."""

    def __init__(
        self, node: Node, part: str, state: Callable[[], State],
        replace: Callable[[State], None], configuration: Callable[[], str],
        folder: Callable[[], str], refuse: Callable[[str, str], None],
    ) -> None:  # fmt: skip
        """Subscribe to the commands.

        Args:
            node: the node.
            part: name of its part of the file.
            state: returns the state of the node.
            replace: replaces it; raises and changes nothing if the new one cannot be used.
            configuration: returns the parameters of the node, as YAML.
            folder: returns the map folder.
            refuse: called with the topic and the reason if a command is malformed.
        """
        self._node, self._part, self._refuse = node, part, refuse
        self._state, self._replace, self._folder = state, replace, folder
        self._configuration = configuration
        self._results = node.create_publisher(String, RESULT, GOAL)
        self._saving: MapCommand | None = None
        self._previous: State | None = None
        self.grid = CutGrid()
        """Cuts of the node, whether or not it keeps a map file."""
        node.create_subscription(String, COMMAND, self._on_command, GOAL)

    def before(self, stamp_ns: int) -> None:
        """Save the state if that was requested for a cut before this stamp."""
        cut = self.grid.before(stamp_ns)
        if cut is not None and self._saving is not None and cut.number >= self._saving.cut:
            self._save()

    def present_grid(self) -> CutGrid:
        """Return the cuts of the node."""
        return self.grid

    def start_run(self) -> None:
        """Expect stamps that are earlier than the last ones."""
        self.grid = CutGrid()

    def pause(self) -> None:
        """Save the state if that was requested, as no further messages arrive at present."""
        if self._saving is not None:
            self._save()

    @decoded(MapCommand)
    def _on_command(self, command: MapCommand) -> None:
        if command.operation == SAVE:
            self._saving = command
        elif command.operation == LOAD:
            self._load(command)
        elif self._previous is not None:
            self._replace(self._previous)
            self._previous = None

    def _save(self) -> None:
        """Write the state to a file of its own, from which the coordinator builds the map."""
        command, self._saving = self._saving, None
        assert command is not None
        state, configuration = self._state(), self._configuration()
        path = part_path(map_path(self._folder(), command.name), command.number, self._part)

        def write() -> None:
            try:
                save_map(path, {self._part: state}, live_meta(configuration))
            except RatslamError as error:
                self._answer(command, False, str(error))
            except Exception as error:  # a defect must not leave the others waiting
                self._answer(command, False, f'{path} cannot be written: {error!r}')
            else:
                self._answer(command, True, f'{self._part} is written')

        threading.Thread(target=write).start()

    def _load(self, command: MapCommand) -> None:
        previous = self._state()
        is_loaded, text = self.load(map_path(self._folder(), command.name))
        if is_loaded:
            self._previous = previous
        self._answer(command, is_loaded, text)

    def load(self, path: Path) -> tuple[bool, str]:
        """Replace the state by that in a file; return whether it is replaced, and a report."""
        try:
            self._replace(read_part(path, self._part))
        except RatslamError as error:
            return False, str(error)
        except KeyError as error:
            return False, (
                f'{path} has no {error.args[0]!r}: it was written by an older version of '
                'ratslam_ros; map again and save'
            )
        except Exception as error:  # the content can be anything; the node keeps its memory
            return False, f'{path} does not fit: {error!r}'
        return True, f'loaded from {path}'

    def _answer(self, command: MapCommand, success: bool, text: str) -> None:
        if success:  # a line of code must always log with the same severity
            self._node.get_logger().info(text)
        else:
            self._node.get_logger().error(text)
        result = MapResult(command.number, self._node.get_name(), success, text[:MAX_TEXT])
        self._results.publish(String(data=encode(result)))


class MapCoordinator:
    """Carries out requests to save and load the map of all nodes."""

    def __init__(
        self, node: Node, folder: Callable[[], str], grid: Callable[[], CutGrid],
        refuse: Callable[[str, str], None],
    ) -> None:  # fmt: skip
        """Create the topics and services.

        Args:
            node: the node of the topics and services.
            folder: returns the map folder.
            grid: returns the cuts of the node.
            refuse: called with the topic and the reason if a message cannot be used.
        """
        self._node, self._folder, self._grid, self._refuse = node, folder, grid, refuse
        self._commands = node.create_publisher(String, COMMAND, GOAL)
        self._status = node.create_publisher(String, STATUS, LATCHED)
        self._request: MapRequest | None = None
        self._number = 0
        self._results: dict[str, MapResult] = {}
        self._nodes: list[str] = []
        self._end_s = 0.0
        self._writing = False
        node.create_subscription(String, REQUEST, self._on_request, GOAL)
        node.create_subscription(String, RESULT, self._on_result, GOAL)
        node.create_service(Trigger, 'ratslam/save_map', self._on_save)
        node.create_service(Trigger, 'ratslam/load_map', self._on_load)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(CHECK_PERIOD_S, self._check, clock=steady)

    def _on_save(self, request: Any, response: Any) -> Any:
        return self._begin(MapRequest(SAVE, DEFAULT_NAME), response)

    def _on_load(self, request: Any, response: Any) -> Any:
        return self._begin(MapRequest(LOAD, DEFAULT_NAME), response)

    @decoded(MapRequest)
    def _on_request(self, request: MapRequest) -> None:
        response = self._begin(request, Trigger.Response())
        if not response.success:
            self._refuse(REQUEST, response.message)

    def _begin(self, request: MapRequest, response: Any) -> Any:
        path = map_path(self._folder(), request.name)
        if self._request is not None:
            response.success = False
            response.message = f'busy: {self._request.operation} of {self._request.name}'
            return response
        if request.operation == LOAD and not Path(path).exists():
            response.success, response.message = False, f'{path} does not exist; save first'
            return response
        self._nodes = self._learners()
        self._request, self._results = request, {}
        self._number, self._end_s = time.time_ns(), time.monotonic() + TIMEOUT_S
        cut = self._grid().now()
        self._command(request.operation, (0 if cut is None else cut.number) + LEAD_CUTS)
        self._report('running', f'{request.operation} of {path} has begun')
        response.success = True
        response.message = f'{request.operation} of {path}; the result follows on {STATUS}'
        return response

    def _command(self, operation: Operation, cut: int = 0) -> None:
        assert self._request is not None
        command = MapCommand(self._number, operation, self._request.name, cut)
        self._commands.publish(String(data=encode(command)))

    def _learners(self) -> list[str]:
        """Return the names of the nodes that take part: those that publish results."""
        topic = self._node.resolve_topic_name(RESULT)
        found = {info.node_name for info in self._node.get_publishers_info_by_topic(topic)}
        return sorted(found)

    @decoded(MapResult)
    def _on_result(self, result: MapResult) -> None:
        if result.number == self._number and self._request is not None:
            self._results[result.node] = result
            self._report('running', result.message)
            self._check()

    def _check(self) -> None:
        """End the operation if all nodes have answered, or if that takes too long."""
        if self._request is None:
            return
        waiting = [name for name in self._nodes if name not in self._results]
        failed = [one for one in self._results.values() if not one.success]
        if waiting and time.monotonic() < self._end_s:
            return
        texts = [f'{one.node}: {one.message}' for one in failed]
        texts += [f'{name} does not answer' for name in waiting]
        if self._request.operation == LOAD:
            if texts:
                self._command(UNDO)
                texts.append('all nodes keep the map that they had')
            self._end(texts)
        elif not self._writing:
            self._writing = True
            threading.Thread(target=self._write, args=(texts,)).start()

    def _write(self, texts: list[str]) -> None:
        """Build the map file from the files of the parts; an earlier map stays until then."""
        assert self._request is not None
        path = map_path(self._folder(), self._request.name)
        folder = part_path(path, self._number, '').parent
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
        self._end(texts)

    def _end(self, texts: list[str]) -> None:
        assert self._request is not None
        path = map_path(self._folder(), self._request.name)
        done = 'saved to' if self._request.operation == SAVE else 'loaded from'
        text = '; '.join(texts) or f'the map of {", ".join(self._nodes)} is {done} {path}'
        self._report('failed' if texts else 'done', text)
        if texts:
            self._node.get_logger().error(text)
        else:
            self._node.get_logger().info(text)
        self._request, self._writing = None, False

    def _report(self, state: Progress, text: str) -> None:
        assert self._request is not None
        done = sorted(self._results)
        waiting = [name for name in self._nodes if name not in self._results]
        status = MapStatus(
            self._request.operation, self._request.name, state, done, waiting, text[:MAX_TEXT]
        )
        self._status.publish(String(data=encode(status)))
