# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What all nodes share: parameters, inputs in order, diagnostics, services."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Generic, TypeVar

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from ratslam_ros.core.common.stamp_order import Counts, Released, StampOrder
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.errors import RatslamError
from ratslam_ros.files import memory as memory_files
from ratslam_ros.nodes.diagnostics import Diagnostics
from ratslam_ros.nodes.inputs import Input
from ratslam_ros.nodes.parameters import NodeParameters

Item = TypeVar('Item')

HOUSEKEEPING_S = 1.0
FLUSH_CHECK_S = 0.1


class RatslamNode(Node, Generic[Item]):  # type: ignore[misc]
    """A node that merges its inputs by their stamps and does something with each message.

    Subclasses say what: ``_use`` processes one message, ``_forget`` empties the memory.
    """

    SECTION: str
    """Name of the node, of its parameters and of the topics it publishes."""
    PARTS: tuple[str, ...] = ()
    """Other sections of parameters that the node reads: what it can do besides."""
    MAPS = False
    """Whether the node learns, so that this can be switched off."""

    def __init__(self, streams: tuple[str, ...]) -> None:
        super().__init__(self.SECTION, automatically_declare_parameters_from_overrides=True)
        try:
            self._checked = NodeParameters(self, self.SECTION, *self.PARTS)
        except BaseException:
            self.destroy_node()  # nobody else has it yet
            raise
        self._diagnostics = Diagnostics(self)
        self._inputs: list[Input] = []
        self._streams = streams
        self._lock = threading.RLock()
        """Held while the memory is used: images are looked at in a thread of their own."""
        self._order: StampOrder[Item] = self._new_order()
        self._counted = Counts()
        self._paused = False
        self._mapping = True
        # Wall time that never jumps: with use_sim_time and no clock, a node must still tell so.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(HOUSEKEEPING_S, self._keep_house, clock=self._steady)
        self.create_service(Trigger, f'{self.SECTION}/reset', self._on_reset)
        self.create_service(SetBool, f'{self.SECTION}/pause', self._on_pause)
        if self.MAPS:
            self.create_service(SetBool, f'{self.SECTION}/mapping', self._on_mapping)
            self.create_service(Trigger, f'{self.SECTION}/save', self._on_save)
            self.create_service(Trigger, f'{self.SECTION}/load', self._on_load)

    @classmethod
    def warm_up(cls) -> None:
        """Compile, or load from the cache, what a message needs."""
        warm_up(cls.SECTION)

    @property
    def config(self) -> Config:
        """All parameters; those of other nodes have their defaults."""
        return self._checked.config

    @property
    def parts(self) -> tuple[str, ...]:
        """Those of PARTS that are in use."""
        return self.PARTS

    @property
    def _section(self) -> Any:
        return getattr(self.config, self.SECTION)

    def close(self) -> None:
        """Process what still waits, and stop."""
        with self._lock:
            self._process(self._order.flush())

    # What subclasses do

    def _use(self, stamp_ns: int, stream: str, item: Item) -> None:
        """Process one message whose turn it is."""
        raise NotImplementedError

    def _forget(self) -> None:
        """Begin with an empty memory."""
        raise NotImplementedError

    def _drop_waiting(self) -> int:
        """Drop what has come and waits outside of the order; return how much that was."""
        return 0

    def _carried(self) -> None:
        """Go on with the memory, after a time in which nobody watched the odometry."""

    def _state(self) -> dict[str, Any]:
        """Return what the diagnostics show."""
        return {}

    # Inputs, in order

    def _listen(self, name: str, topics: dict[str, type], callback: Callable[[Any], None]) -> None:
        self._inputs.append(Input(self, self._diagnostics, name, topics, callback))

    def _new_order(self) -> StampOrder[Item]:
        lateness_s = getattr(self._section, 'max_lateness_s', 0.0)
        return StampOrder(self._streams, round(lateness_s * 1e9))

    def _push(self, stream: str, stamp_ns: int, item: Item) -> None:
        """Take one message into the order, and process all whose turn has come."""
        if self._paused:
            self._diagnostics.counts['paused'] += 1
            return
        self._process(self._order.push(stream, stamp_ns, item))
        if self._order.jumped_back:
            self._jump_back(stream, stamp_ns)
        self._count(stream, stamp_ns)

    def _refuse(self, stream: str, reason: str) -> None:
        """Count a message that cannot be used, and warn."""
        self._diagnostics.drop('refused', f'a message of {stream} was refused: {reason}')

    def _process(self, released: Iterable[Released[Item]]) -> None:
        for stamp_ns, stream, item in released:
            self._use(stamp_ns, stream, item)

    def _flush(self) -> None:
        """Process what waits, if nothing has come for a while."""
        silent = all(put.silent_s() >= self._section.flush_after_s for put in self._inputs)
        if silent and self._order.held:
            with self._lock:
                self._process(self._order.flush())
                self._count('its inputs', self._order.newest_ns or 0)

    def _jump_back(self, stream: str, stamp_ns: int) -> None:
        self._diagnostics.counts['jumps_back'] += 1
        if self._section.on_jump_back == 'start_over':
            self.get_logger().warning(
                f'the stamps of {stream} have jumped back: starting over with an empty memory '
                '(on_jump_back)'
            )
            self._forget()
            self._diagnostics.missing.clear()
        else:
            self.get_logger().warning(
                f'the stamps of {stream} have jumped back: going on with what is known '
                '(on_jump_back)'
            )
            self._process(self._order.flush())
            self._carried()
        self._process(self._order.restart())

    def _count(self, stream: str, stamp_ns: int) -> None:
        """Take over what the order has dropped since the last time."""
        now, before = self._order.counts, self._counted
        self._counted = now
        at = f'a message of {stream} with stamp {stamp_ns * 1e-9:.3f} s'
        self._diagnostics.drop(
            'late',
            f'{at} came too late, behind later ones that are in the map already (max_lateness_s)',
            now.late - before.late,
        )
        self._diagnostics.drop(
            'refused',
            f'{at} or before it was refused: stamps must increase, and not leap',
            now.refused - before.refused,
        )
        self._diagnostics.drop(
            'gaps',
            f'{stream} has a gap before {stamp_ns * 1e-9:.3f} s: it paused, or messages were lost',
            now.gaps - before.gaps,
        )
        if now.refused < before.refused:  # a jump back made them believed after all
            self._diagnostics.counts['refused'] += now.refused - before.refused

    # Timers and services

    def _keep_house(self) -> None:
        state: dict[str, Any] = {}
        for put in self._inputs:
            state[f'{put.name}_received'] = put.received
            state[f'{put.name}_hz'] = round(put.update(self._section.watchdog_after_s), 2)
        with self._lock:
            state['held'] = self._order.held
            state['memory'] = 'paused' if self._paused else 'mapping'
            if not self._mapping and not self._paused:
                state['memory'] = 'localisation only'
            state |= self._state()
        self._diagnostics.publish(state)

    def _on_reset(self, request: Any, response: Any) -> Any:
        with self._lock:
            self._drop_waiting()
            self._order = self._new_order()
            self._counted = Counts()
            self._forget()
            self._diagnostics.missing.clear()
        return self._answer(response, True, f'{self.SECTION} has an empty memory')

    def _on_pause(self, request: Any, response: Any) -> Any:
        with self._lock:
            if request.data and not self._paused:
                self._process(self._order.flush())
            elif self._paused and not request.data:
                self._carried()
            self._paused = bool(request.data)
        state = 'paused' if self._paused else 'running'
        return self._answer(response, True, f'{self.SECTION} is {state}')

    def _on_mapping(self, request: Any, response: Any) -> Any:
        with self._lock:
            self._mapping = bool(request.data)
            self._set_mapping(self._mapping)
        state = 'learns' if self._mapping else 'learns nothing more: localisation only'
        return self._answer(response, True, f'{self.SECTION} {state}')

    def _on_save(self, request: Any, response: Any) -> Any:
        try:
            with self._lock:
                self._process(self._order.flush())
                memory_files.save(self._memory_path, self.SECTION, self._learned())
        except RatslamError as error:
            return self._answer(response, False, str(error))
        return self._answer(response, True, f'saved to {self._memory_path}')

    def _on_load(self, request: Any, response: Any) -> Any:
        try:
            state = memory_files.load(self._memory_path, self.SECTION)
            with self._lock:
                self._restore(state)
                self._order = self._new_order()
                self._counted = Counts()
        except RatslamError as error:
            return self._answer(response, False, str(error))
        except KeyError as error:
            return self._answer(
                response, False, f'{self._memory_path} has no {error.args[0]!r}: it was written '
                'by an older version of ratslam_ros; map again and save',
            )  # fmt: skip
        except Exception as error:  # whatever was in the file: the node goes on as it was
            return self._answer(response, False, f'{self._memory_path} does not fit: {error!r}')
        self._diagnostics.missing.clear()
        return self._answer(response, True, f'loaded from {self._memory_path}')

    def _answer(self, response: Any, success: bool, text: str) -> Any:
        if success:
            self.get_logger().info(text)
        else:
            self.get_logger().error(text)
        response.success, response.message = success, text
        return response

    @property
    def _memory_path(self) -> Path:
        name = self.get_fully_qualified_name().lstrip('/').replace('/', '.')
        return Path(self._section.memory_folder).expanduser() / f'{name}.npz'

    # What nodes that map do

    def _set_mapping(self, mapping: bool) -> None:
        """Switch learning on or off."""
        raise NotImplementedError

    def _learned(self) -> State:
        """Return all that was learned."""
        raise NotImplementedError

    def _restore(self, state: State) -> None:
        """Take what ``_learned`` gave in place of what is known; all of it, or raise."""
        raise NotImplementedError
