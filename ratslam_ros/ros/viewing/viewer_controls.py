# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a user of the live view can ask of the nodes: their goals, services and parameters."""

from __future__ import annotations

import functools
import json
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from msgspec.structs import replace
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from ratslam_ros.core.config import DECLARATIONS, SHARED, Config, Value, declared
from ratslam_ros.messages.goals import GoalRequest, GoalStatus, NameRequest
from ratslam_ros.messages.map_commands import MapStatus
from ratslam_ros.pipeline.choice import NAMES
from ratslam_ros.ros.payloads import PayloadPublisher, decoded
from ratslam_ros.ros.qos import GOAL, LATCHED
from ratslam_ros.viewer.run_source import Answer

NODES = *NAMES, 'goal_follower', 'landmark_map'
"""Nodes with the services of RatslamNode; those present are found by their services."""

PARTS = {'goal_recall': 'experience_map', 'goal_memory': 'pose_cells'}
"""Node of every section that has no node of its own but parameters that can be set."""

DISCOVERY_S = 1.0
"""Time to wait for a service to appear."""

ANSWER_S = 5.0
"""Time to wait for the answer of a service."""

SAVING_S = 60.0
"""The same for save and load, which read or write a file."""

STATUS_S = 2.0
"""Time to wait for the status that follows a goal or a name."""

SILENT_S = 3.5
"""Age of the last diagnostics, sent once a second, above which a node counts as ended."""

REFRESH_S = 5.0
"""Period at which the named places and the values of parameters are read again."""

LEVELS = 'OK', 'WARN', 'ERROR', 'STALE'


class RosControls:
    """Requests to the nodes, and what they report about themselves.

    Requests block, for a limited time, while another thread spins the node. They are called from
    threads of the viewer, which may run at the same time. ``refresh`` and the callbacks run in
    the thread that spins.
    """

    def __init__(self, node: Node) -> None:
        self.actions: dict[str, Callable[..., Answer]] = {
            'go_to': self.go_to,
            'go_to_place': self.go_to_place,
            'name_place': self.name_place,
            'cancel_goals': lambda: self._call(Trigger, 'experience_map/cancel_goal'),
            'explore': self.explore,
            'pause_nodes': lambda on: self._call_all(SetBool, 'pause', data=bool(on)),
            'mapping': lambda on: self._call_all(SetBool, 'mapping', data=bool(on)),
            'relocate': lambda: self._call(Trigger, 'experience_map/relocate', SAVING_S),
            'save': lambda: self._change_map('ratslam/save_map'),
            'load': lambda: self._change_map('ratslam/load_map'),
            'reset': lambda: self._call_all(Trigger, 'reset'),
            'set_parameter': self.set_parameter,
        }
        self._node = node
        self._goal = PayloadPublisher(node, GoalRequest, GOAL)
        self._name = PayloadPublisher(node, NameRequest, GOAL)
        self._clients: dict[str, Any] = {}
        self._lock = threading.Lock()
        self._reported: dict[str, tuple[DiagnosticStatus, float]] = {}
        """Last status of every node in the diagnostics, and when it came."""
        self._refreshed_s = 0.0
        self._changed = threading.Condition()
        self._status: GoalStatus | None = None
        self._map_result: Answer | None = None
        node.create_subscription(
            String, MapStatus.TOPIC,
            decoded(MapStatus, self._on_map_status, lambda *_: None), LATCHED,
        )
        self.places: Sequence[str] = ()
        """Names of the named places."""
        self.values: dict[str, Value] = Config().flat()
        """All parameters of the nodes, by ``section.name``; the defaults until they are read."""

    @property
    def parameters(self) -> dict[str, object]:
        """Current values of the parameters that can be changed, by ``section.name``."""
        return {key: self.values[key] for key in _SETTABLE_KEYS}

    @property
    def diagnostics(self) -> dict[str, tuple[str, str]]:
        """Level and message of every node."""
        now_s, shown = time.monotonic(), {}
        for name, (status, at_s) in list(self._reported.items()):
            level = status.level
            number = level[0] if isinstance(level, bytes) else int(level)
            shown[name] = LEVELS[min(number, len(LEVELS) - 1)], status.message
            if now_s - at_s > SILENT_S:
                shown[name] = 'ERROR', f'silent for {now_s - at_s:.0f} s: has it ended?'
        return shown

    @property
    def switches(self) -> dict[str, bool]:
        """Whether ``explore``, ``mapping`` and ``pause_nodes`` are on, if it is known."""
        memories = {
            item.value for status, _ in list(self._reported.values())
            for item in status.values if item.key == 'memory'
        }
        found = {'explore': bool(self.values['goal_follower.explore'])}
        if memories:
            found['pause_nodes'] = 'paused' in memories
            if memories != {'paused'}:  # Nodes that do not learn are always mapping.
                found['mapping'] = 'localisation only' not in memories
        return found

    # The thread that spins

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Store the levels of the nodes of this project."""
        for status in message.status:
            prefix, _, name = status.name.partition(': ')
            if prefix == 'ratslam':
                self._reported[name] = status, time.monotonic()

    def on_status(self, status: GoalStatus) -> None:
        """Store the status of the goals, for which requests wait."""
        with self._changed:
            self._status = status
            self._changed.notify_all()

    def refresh(self) -> None:
        """Ask for the named places and parameters, without waiting for the answers."""
        if time.monotonic() - self._refreshed_s < REFRESH_S:
            return
        self._refreshed_s = time.monotonic()
        self.ask(Trigger, 'experience_map/list_goals', Trigger.Request(), self._set_places)
        for name in self.present():
            self.ask(
                ListParameters, f'{name}/list_parameters', ListParameters.Request(),
                functools.partial(self._read, name),
            )

    def present(self) -> list[str]:
        """Return the nodes that offer the services of RatslamNode."""
        return self._offering('reset')

    def _offering(self, service: str) -> list[str]:
        resolve = self._node.resolve_service_name
        offered = {name for name, _ in self._node.get_service_names_and_types()}
        return [name for name in NODES if resolve(f'{name}/{service}') in offered]

    def ask(self, kind: Any, name: str, request: Any, then: Callable[[Any], None]) -> None:
        """Call a service if it is there, without waiting for the response."""
        client = self._client(kind, name)
        if client.service_is_ready():
            client.call_async(request).add_done_callback(lambda future: then(future.result()))

    def _set_places(self, response: Any) -> None:
        if response.success:
            self.places = tuple(goal['name'] for goal in json.loads(response.message)['goals'])

    def _read(self, node: str, response: Any) -> None:
        keys = {
            name: key for name in response.result.names
            for key in declared(name if '.' in name else f'{node}.{name}')
        }
        names = list(keys)

        def store(response: Any) -> None:
            if len(response.values) != len(names):
                return  # one of them was undeclared in the meantime
            self.values = self.values | {
                keys[name]: parameter_value_to_python(value)
                for name, value in zip(names, response.values, strict=True)
            }

        request = GetParameters.Request(names=names)
        self.ask(GetParameters, f'{node}/get_parameters', request, store)

    # Requests

    def go_to(self, x_m: float, y_m: float, then: bool = False) -> Answer:
        """Send a goal on the map; with ``then`` after the goals that have been sent."""
        return self._send_goal(GoalRequest(x_m=float(x_m), y_m=float(y_m), append=then))

    def go_to_place(self, name: str, then: bool = False) -> Answer:
        """Send a named place as goal."""
        return self._send_goal(GoalRequest(name=name, append=then))

    def name_place(self, name: str) -> Answer:
        """Name the robot's place."""
        if self._name.get_subscription_count() == 0:
            return _no_answer('experience_map')
        self._name.publish(NameRequest(name))
        end_s = time.monotonic() + STATUS_S
        while time.monotonic() < end_s:
            answer = self._call(Trigger, 'experience_map/list_goals')
            if not answer.success:
                return answer
            self._set_places(answer)
            if name in self.places:
                return Answer(True, f'this place is named {name}')
            time.sleep(0.1)
        return Answer(False, f'experience_map has not named the place: {self._reason()}')

    def explore(self, on: bool) -> Answer:
        """Start or end exploration."""
        answer = self.set_parameter('goal_follower.explore', bool(on))
        if not answer.success:
            return answer
        return Answer(True, 'exploring while there is no goal' if on else 'not exploring')

    def set_parameter(self, name: str, value: object) -> Answer:
        """Change a parameter, by ``section.name``."""
        section, _, short = name.partition('.')
        if name not in _SETTABLE_KEYS:
            return Answer(False, f'{name} cannot be changed while the nodes run')
        if isinstance(DECLARATIONS[name][1], float) and isinstance(value, int):
            value = float(value)
        own = Parameter(name if section in PARTS else short, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[own])
        reasons = []
        for node in self.present() if section in SHARED else [PARTS.get(section, section)]:
            response = self._response(SetParameters, f'{node}/set_parameters', request)
            if isinstance(response, Answer):
                return response
            reasons += ['' if one.successful else one.reason for one in response.results]
        if all(reasons):  # not every node has all shared parameters
            return Answer(False, reasons[0] if reasons else 'no node is running')
        self.values = {**self.values, name: value}  # type: ignore[dict-item]
        return Answer(True, f'{name} is {value}')

    def _send_goal(self, target: GoalRequest) -> Answer:
        """Send a goal, and wait for the status that lists or refuses it."""
        if self._goal.get_subscription_count() == 0:
            return _no_answer('experience_map')
        name = f'viewer {time.time_ns()}'

        def is_answered() -> bool:
            status = self._status
            return status is not None and name in (
                status.refused, *(task.request for task in (*status.queue, *status.outcomes))
            )

        with self._changed:
            self._goal.publish(replace(target, request=name))
            is_known, status = self._changed.wait_for(is_answered, STATUS_S), self._status
        if not is_known or status is None:
            return Answer(
                False, 'experience_map has not answered the goal: does it receive odometry?'
            )
        if status.refused == name:
            return Answer(False, status.reason)
        remaining_s = status.remaining_s
        text = 'queued' if target.append and len(status.queue) > 1 else 'the robot is sent'
        expected = '' if remaining_s is None else f'; {remaining_s:.0f} s to go'
        return Answer(True, text + expected)

    def _change_map(self, service: str) -> Answer:
        """Save or load the map, and wait for the result, which is a message of its own."""
        self._map_result = None
        answer = self._call(Trigger, service)
        if not answer.success:
            return answer
        with self._changed:
            self._changed.wait_for(lambda: self._map_result is not None, SAVING_S)
            no_result = Answer(False, f'no result within {SAVING_S:g} s: {answer.message}')
            return self._map_result or no_result

    def _on_map_status(self, status: MapStatus) -> None:
        with self._changed:
            if status.success is not None:
                self._map_result = Answer(status.success, status.message)
                self._changed.notify_all()

    def _reason(self) -> str:
        for name, (level, message) in self.diagnostics.items():
            if name.rpartition('/')[2] == 'experience_map' and level != 'OK':
                return message
        return 'does it have a map yet?'

    def _call_all(self, kind: Any, service: str, **fields: bool) -> Answer:
        """Call a service of all nodes that have it."""
        nodes = self._offering(service)
        if not nodes:
            return Answer(False, f'no node offers {service}: are the nodes running?')
        answers = [self._call(kind, f'{node}/{service}', **fields) for node in nodes]
        failed = [answer.message for answer in answers if not answer.success]
        texts = failed or [answer.message for answer in answers]
        return Answer(not failed, '; '.join(texts))

    def _call(
        self, kind: Any, name: str, timeout_s: float = ANSWER_S, **fields: bool
    ) -> Answer:
        response = self._response(kind, name, kind.Request(**fields), timeout_s)
        if isinstance(response, Answer):
            return response
        return Answer(bool(response.success), str(response.message))

    def _response(
        self, kind: Any, name: str, request: Any, timeout_s: float = ANSWER_S
    ) -> Any:
        """Return the response of a service, or an Answer if there is none."""
        node = name.partition('/')[0].replace('ratslam', 'experience_map')
        client = self._client(kind, name)
        if not client.wait_for_service(timeout_sec=DISCOVERY_S):
            return _no_answer(node)
        done = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: done.set())
        if not done.wait(timeout_s):
            client.remove_pending_request(future)
            return Answer(False, f'{node} has not answered {name} within {timeout_s:g} s')
        return future.result()

    def _client(self, kind: Any, name: str) -> Any:
        with self._lock:
            if name not in self._clients:
                self._clients[name] = self._node.create_client(kind, name)
            return self._clients[name]


def _no_answer(node: str) -> Answer:
    return Answer(False, f'{node} does not answer: is it running?')


_SETTABLE_KEYS = tuple(key for key, (info, _) in DECLARATIONS.items() if info.runtime != 'no')
