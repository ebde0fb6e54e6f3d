# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the nodes with a stage: parameters, inputs, diagnostics, services."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar

from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from std_srvs.srv import SetBool

from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.common.scan import scan_stream
from ratslam_ros.core.config import SHARED, Config
from ratslam_ros.core.config.experience_map import MAX_LASERS
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.messages.mapping import ActionPayload, TemplatePayload
from ratslam_ros.pipeline.commands import Reset, SetMapping
from ratslam_ros.pipeline.items import NumberedAction, Template
from ratslam_ros.ros.convert import odometry_of
from ratslam_ros.ros.host import Host
from ratslam_ros.ros.hosted_node import HostedNode
from ratslam_ros.ros.inputs import Input, SingleSender
from ratslam_ros.ros.mapping.map_operations import MapOperations
from ratslam_ros.ros.mapping.odometry_frames import OdometryFrames
from ratslam_ros.ros.mapping.scans import ScanInput
from ratslam_ros.ros.parameters import NodeParameters
from ratslam_ros.ros.payloads import decoded

NO_ODOMETRY = (
    'images arrive, but nothing is mapped without odometry: start visual_odometry, which computes '
    'it from the images (ratslam launch --odometry camera; with ros2 launch '
    'odometry:=camera), or name the topic of the robot (--odom-topic T; odom_topic:=T)'
)
FLUSH_CHECK_PERIOD_S = 0.1
"""Period of the checks whether held messages must be processed, as all inputs are silent."""

LASERS = {scan_stream(laser): laser for laser in range(MAX_LASERS)}
"""Number of the laser by stream of scans."""

RESULTS: dict[str, tuple[Any, Callable[[Any], Any]]] = {
    'template': (TemplatePayload, lambda one: Template(one.match, one.memory)),
    'action': (
        ActionPayload, lambda one: NumberedAction(one.sequence, one.change, one.memory)
    ),
}
"""Streams that a stage in another process may write: payload, and what makes an item of it."""


class RatslamNode(HostedNode):
    """The ROS side of a stage, which a host runs: topics, parameters, services and diagnostics.

    Subclasses implement ``connect``, and ``new_stage`` for a stage of their own.

    Changes of parameters that influence the map are commands of the stream, and are recorded with
    the memory that is learned with them.
    """

    SHARED: tuple[str, ...] = SHARED
    """Shared sections of parameters that the node reads."""
    MAPS = False
    """Whether the node learns, and so has the services ``mapping``, ``save`` and ``load``."""
    operations: MapOperations
    """Saving and loading of maps, for nodes that learn."""
    UNLOCKED: ClassVar[tuple[type, ...]] = ()
    """Types of messages whose callbacks touch nothing that the thread of the images uses."""

    def __init__(self, initial: Config = Config(), host: Host | None = None) -> None:
        """Create the node.

        Args:
            initial: values of parameters that are not given to the node.
            host: what runs the stages of several nodes; None: the node has one of its own.

        Raises:
            UnusableParameter: a given parameter is unknown, of the wrong type or out of range.
        """
        self.host = host or Host()
        self._lock = self.host.lock
        self._initial, self._has_own_host = initial, host is None
        super().__init__()

    def _begin(self) -> None:
        self.checked = NodeParameters(
            self, self._initial, (*self.SHARED, self.SECTION), self.PARTS, self.host.map.replay,
            self._on_set,
        )
        self.host.nodes.append(self)
        self.inputs = []
        self._lasers: list[ScanInput] = []
        self.frames = OdometryFrames(self.diagnostics.note)
        self._is_paused = False
        self._is_active = True
        """False while a managed node is not in the state `active`; see ros/managed.py."""
        self._sender_id = time.time_ns()
        """Distinguishes this process from others with the same node; see ``SingleSender``."""
        self.create_timer(FLUSH_CHECK_PERIOD_S, self._on_timer, clock=self.steady)
        self.offer(f'{self.SECTION}/reset', self._on_reset, is_logged=True)
        self.offer(f'{self.SECTION}/pause', self._on_pause, SetBool, is_logged=True)
        if self.MAPS:
            self.offer(f'{self.SECTION}/mapping', self._on_mapping, SetBool, is_logged=True)
            self.operations = MapOperations(self, self.host)
        if self._has_own_host:
            self.host.start()

    def subscribe(self, stream: str) -> None:
        """Subscribe to a stream that comes from outside."""
        if stream == 'odometry':
            self._add_input(stream, {'odom': OdometryMessage}, self._on_odometry)
        elif stream in LASERS:
            self._add_laser(stream)
        else:
            self._add_results(stream)

    @property
    def scan_topics(self) -> Sequence[str]:
        """Topics of the scans by laser."""
        return self.host.chain.scans or ('scan',)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load from the cache all functions that processing a message needs."""
        warm_up(cls.SECTION)

    def _diagnostic_values(self) -> dict[str, Any]:
        """Return the node's own values for the diagnostics."""
        return {}

    # Inputs

    def create_subscription(
        self, kind: Any, topic: str, callback: Callable[[Any], None], qos: Any, **options: Any
    ) -> Any:
        """Subscribe; messages wait while the thread of the images runs the stages."""
        if kind not in self.UNLOCKED:
            callback = self._locked(callback)
        return super().create_subscription(kind, topic, callback, qos, **options)

    def create_service(
        self, kind: Any, name: str, callback: Callable[[Any, Any], Any], **options: Any
    ) -> Any:
        """Offer a service; requests wait while the thread of the images runs the stages."""
        return super().create_service(kind, name, self._locked(callback), **options)

    def _locked(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        def locked(*arguments: Any) -> Any:
            with self._lock:
                return callback(*arguments)

        return locked

    def _add_input(
        self, name: str, topics: dict[str, type], callback: Callable[[Any], None],
        resume: Callable[[Any], None] | None = None,
    ) -> None:
        """Subscribe to one stream.

        Args:
            name: name of the stream.
            topics: message type by topic; see ``Input``.
            callback: receives each message.
            resume: receives messages that were sent while the node was restarted; None: callback.
        """
        receive = self.host.map.recovery.receiver(name, topics, callback, resume or callback)
        self.inputs.append(Input(self, name, topics, receive))

    def _add_results(self, stream: str) -> None:
        """Subscribe to the results of another node, as long as only one sends them."""
        kind, item_of = RESULTS[stream]
        single = SingleSender(self, kind.TOPIC)

        def take(received: Any) -> None:
            single.check(received.sender)
            self._push(stream, received.stamp.ns, item_of(received))

        receive = decoded(kind, take, self._refuse, stream)
        self._add_input(stream, {kind.TOPIC: String}, receive)

    def _push(self, stream: str, stamp_ns: int, item: Any) -> None:
        """Pass an item to the host."""
        self.host.feed(stream, stamp_ns, item)

    def _on_odometry(self, message: OdometryMessage) -> None:
        self.host.heard('odometry', message)
        odometry = odometry_of(message)
        if not self._motion.accepts(odometry):
            reason = f'{self._motion.source} is not finite, or too large: {odometry}'
            self._refuse('odometry', reason)
            return
        self._push('odometry', odometry.stamp_ns, odometry)
        order = self.host.pipeline.order
        if not self._is_halted and odometry.stamp_ns == order.newest_of('odometry'):
            self._locate(odometry)  # not refused, late, or unconfirmed by the stamp order

    def _locate(self, odometry: Odometry) -> None:
        """Publish where the robot is at an odometry message, before it is processed."""

    def _add_laser(self, stream: str) -> None:
        """Subscribe to the scans of a laser."""
        laser = LASERS[stream]
        scans = ScanInput(
            self, self.diagnostics.note, lambda: self.frames.known_base,
            lambda _, reason: self._refuse(stream, reason),
            lambda scan: self._push(stream, scan.stamp_ns, replace(scan, laser=laser)),
        )
        self._lasers.append(scans)
        self._add_input(stream, {self.scan_topics[laser]: LaserScan}, scans.receive)

    def _on_set(self) -> None:
        """Use parameters that were set."""
        with self._lock:
            self.host.live.set_values(self.SECTION, self.stage_values)

    @property
    def _is_halted(self) -> bool:
        """Whether messages are ignored now."""
        return self.host.live.is_paused(self.SECTION)

    def _update_halted(self) -> None:
        with self.host.ready() as live:
            live.set_paused(self.SECTION, self._is_paused or not self._is_active)

    def _on_timer(self) -> None:
        """Let the host check whether all inputs are silent; one node of each host does."""
        for laser in self._lasers:
            laser.update()
        if self.host.nodes[0] is self:
            self.host.flush()

    # The map

    def close(self) -> None:
        """Process the messages that are still held, and save the last state."""
        self.host.map.close()
        if self.MAPS:
            self.operations.close()

    # Timers and services

    def _publish_diagnostics(self) -> None:
        values: dict[str, Any] = {}
        has_views = any(
            one.received for node in self.host.nodes for one in node.inputs
            if one.name in ('image', 'template')
        )
        for one in self.inputs:
            if one.name == 'odometry':
                is_absent = not (one.received or one.has_publisher)
                one.advice = NO_ODOMETRY if has_views and is_absent else ''
            values[f'{one.name}_received'] = one.received
            values[f'{one.name}_hz'] = round(one.update(self.config.inputs.watchdog_after_s), 2)
        with self._lock:
            values['held'] = self.host.pipeline.order.held
            values['memory'] = 'paused' if self._is_halted else 'mapping'
            if not (self._is_halted or self.host.live.is_mapping(self.SECTION)):
                values['memory'] = 'localisation only'
            values |= self._diagnostic_values()
            if changes := self.host.live.changes[self.SECTION]:
                values['parameters_set'] = len(changes)
                values['last_parameter_set'] = str(changes[-1])
            values |= self.host.map.diagnostic_values()
        self.diagnostics.publish(values, self._state())

    def _state(self) -> str:
        """Return what the node does, judged by its inputs."""
        if self.inputs and all(one.state == 'finished' for one in self.inputs):
            return f'finished: {", ".join(one.name for one in self.inputs)} ended'
        waiting = [one.name for one in self.inputs if one.state == 'waiting']
        return f'waiting for {", ".join(waiting)}' if waiting else 'running'

    def _on_reset(self) -> str:
        self.host.command(Reset(self.SECTION))
        return f'{self.SECTION} has an empty memory'

    def _on_pause(self, is_paused: bool) -> str:
        self._is_paused = bool(is_paused)
        self._update_halted()
        return f'{self.SECTION} is {"paused" if is_paused else "running"}'

    def _on_mapping(self, is_mapping: bool) -> str:
        self.host.command(SetMapping(bool(is_mapping), self.SECTION))
        state = 'is mapping' if is_mapping else 'localises only; learning is off'
        return f'{self.SECTION} {state}'
