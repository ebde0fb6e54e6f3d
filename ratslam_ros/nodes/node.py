# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the nodes: parameters, inputs in stamp order, diagnostics, services."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Generic, TypeVar

from rclpy.clock import Clock, ClockType
from std_srvs.srv import SetBool, Trigger

from ratslam_ros.core.common.odometry import MAX_GAP_NS
from ratslam_ros.core.common.stamp_order import Counts, Released, StampOrder
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.errors import RatslamError
from ratslam_ros.files import memory as memory_files
from ratslam_ros.files.version import package_version
from ratslam_ros.maps import MapMeta, MapStore, read_map
from ratslam_ros.maps.file_writer import LOG_NS
from ratslam_ros.nodes.configured_node import ConfiguredNode
from ratslam_ros.nodes.diagnostics import Diagnostics
from ratslam_ros.nodes.inputs import Input
from ratslam_ros.nodes.map_keeper import KeptInput, MapKeeper
from ratslam_ros.nodes.map_operations import MapOperations
from ratslam_ros.nodes.parameter_changes import encode_values
from ratslam_ros.nodes.single_sender import SingleSender

Item = TypeVar('Item')

DIAGNOSTICS_PERIOD_S = 1.0
FLUSH_CHECK_PERIOD_S = 0.1
"""Period of the checks whether held messages must be processed, as all inputs are silent."""

SETTLING_S = 1.0
"""Time after the end of a restart in which the messages that were missing arrive."""


class RatslamNode(ConfiguredNode, Generic[Item]):
    """A node that merges its inputs in the order of their stamps and processes each message.

    Subclasses implement ``_process_item``, which processes one message, and ``_reset_state``,
    which empties the memory.
    """

    MAPS = False
    """Whether the node learns, and so has the services ``mapping``, ``save`` and ``load``."""
    REGULAR: str | None = None
    """Stream whose next stamp is predicted, so that others need not wait for it."""
    REPEATS: tuple[str, ...] = ()
    """Streams that the node sends again after a restart from a map file."""

    def __init__(self, streams: tuple[str, ...], initial: Config) -> None:
        """Create the node.

        Args:
            streams: names of the inputs that are merged.
            initial: values of parameters that are not given to the node.
        """
        super().__init__(initial)
        self._diagnostics = Diagnostics(self)
        self._inputs: list[Input] = []
        self._was_silent = False
        self._streams = streams
        self._order: StampOrder[Item] = self._new_order()
        self._counted = Counts()
        self._paused = False
        self._is_active = True
        """False while a managed node is not in the state `active`; see nodes/managed.py."""
        self._mapping = True
        self._sender_id = time.time_ns()
        """Distinguishes this process from others with the same node; see ``SingleSender``."""
        self._senders: dict[str, SingleSender] = {}
        """By stream, for those that come from another node."""
        self._keeper: MapKeeper | None = None
        """The node's part of the map file, if there is one."""
        self._rhythm: State | None = None
        """Prediction of odometry in a restored state, until it is known whether that goes on."""
        self._kept_inputs: list[KeptInput] = []
        self._operations: MapOperations | None = None
        # With use_sim_time and no /clock, the node must still publish diagnostics.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=self._steady)
        self.create_service(Trigger, f'{self.SECTION}/reset', self._on_reset)
        self.create_service(SetBool, f'{self.SECTION}/pause', self._on_pause)
        if self.MAPS:
            self.create_service(SetBool, f'{self.SECTION}/mapping', self._on_mapping)
            self.create_service(Trigger, f'{self.SECTION}/save', self._on_save)
            self.create_service(Trigger, f'{self.SECTION}/load', self._on_load)
            self._operations = MapOperations(
                self, self.SECTION, self._saved_state, self._replace_memory,
                self._own_sections, lambda: str(self._section.memory_folder),
                self._diagnostics.warn,
            )  # fmt: skip

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load from the cache all functions that processing a message needs."""
        warm_up(cls.SECTION)

    def open_map(self) -> None:
        """Restore the state from the map file, if one is given, and save it there from now on.

        Call it once, before the node receives messages.

        Raises:
            UnusableInput: the file cannot be used, or its map does not fit the parameters.
        """
        self._restore_map()
        self._catch_up()

    def _restore_map(self) -> None:
        path = getattr(self._section, 'map', '')
        if not path:
            return
        if self._section.localize:
            self._localise_in(Path(path).expanduser())
            return
        meta = MapMeta('live', package_version(), self._own_sections())
        store = MapStore.open(
            Path(path).expanduser(), [self.SECTION], meta, self.get_logger().warning
        )
        keeper = MapKeeper(
            self, self._diagnostics, store, self.SECTION, self._kept_state, self._newest_ns,
            self._on_neighbour_restarted,
        )  # fmt: skip
        try:
            with self._lock:
                if keeper.restored is not None:
                    self._restore_saved(keeper.restored)
                    self._rhythm = keeper.restored.get('rhythm')
                    if keeper.joins:
                        self._restore_rhythm(keeper.since_ns)
                        self._resume_parameters(
                            keeper.logged(self._parameter_stream, keeper.since_ns)
                        )
                        keeper.configure(self._own_sections())
                    if not store.joins:
                        self._drop_tasks()
        except BaseException:
            store.close()
            raise
        self._keeper = keeper

    def _kept_state(self) -> State:
        """Return the memory, and what a restarted node needs for the same order of messages."""
        if self.REGULAR is None:
            return self._saved_state()
        return {**self._saved_state(), 'rhythm': self._order.rhythm}

    def _catch_up(self) -> None:
        """Get the messages that were sent since the restored state."""
        if self._keeper is not None:
            self._keeper.resume(self._kept_inputs, self.REPEATS, self._lock, self._on_caught_up)

    def _localise_in(self, path: Path) -> None:
        """Restore the state from a map file that stays unchanged, and stop learning."""
        saved = read_map(path)
        with self._lock:
            if self.SECTION in saved.states:
                self._restore_saved(saved.states[self.SECTION])
                self._drop_tasks()
                self._begin_session()
            self._mapping = False
            self._set_mapping(False)

    def close(self) -> None:
        """Process the messages that are still held, and save the last state."""
        self._close_map()

    def _close_map(self) -> None:
        with self._lock:
            self._process(self._order.flush(self._last_of_session_ns()))
            if self._keeper is not None:
                self._keeper.close()
                self._keeper = None

    def _last_of_session_ns(self) -> int | None:
        """Return the stamp up to which held messages belong to the last state; None: all do."""
        return None

    @property
    def _is_halted(self) -> bool:
        """Whether messages are ignored now."""
        return self._paused or not self._is_active

    # Implemented by subclasses

    def _process_item(self, stamp_ns: int, stream: str, item: Item) -> None:
        """Process the next message in stamp order."""
        raise NotImplementedError

    def _drop_queued(self) -> int:
        """Drop received messages that are not in the stamp order yet; return their number."""
        return 0

    def _on_caught_up(self, are_images_lost: bool) -> None:
        """Prepare for the messages that were sent while the node was restarted."""

    def _on_relocated(self) -> None:
        """Continue with the memory after the robot may have been moved unobserved."""

    def _drop_tasks(self) -> None:
        """Drop what an earlier session was asked to do."""

    def _begin_session(self) -> None:
        """Continue with a restored memory, although messages and places do not follow it."""
        self._on_relocated()

    def _diagnostic_values(self) -> dict[str, Any]:
        """Return the node's own values for the diagnostics."""
        return {}

    # Inputs, in stamp order

    def _add_input(
        self, name: str, topics: dict[str, type], callback: Callable[[Any], None],
        replay: Callable[[bytes], None] | None = None,
        resume: Callable[[Any], None] | None = None, delay_ns: int = 0,
    ) -> None:  # fmt: skip
        """Subscribe to one stream.

        Args:
            name: name of the stream.
            topics: message type by topic; see ``Input``.
            callback: receives each message.
            replay: takes a message from the log of the map file, as ``_log`` wrote it.
            resume: receives messages that were sent while the node was restarted; None: callback.
            delay_ns: what is added to the stamps for the stamp order.
        """
        late = resume or callback
        self._kept_inputs.append(KeptInput(name, topics, late, replay, delay_ns))
        receive = self._when_resumed(name, callback, late)
        self._inputs.append(Input(self, self._diagnostics, name, topics, receive))

    def _when_resumed(
        self, stream: str, callback: Callable[[Any], None], late: Callable[[Any], None]
    ) -> Callable[[Any], None]:
        """Return a callback that keeps messages for ``late`` while the node catches up."""

        def receive(message: Any) -> None:
            if self._keeper is None or self._keeper.takes(stream, message, late):
                callback(message)

        return receive

    def _log(self, stream: str, stamp_ns: int, data: Callable[[], bytes]) -> None:
        """Log a message in the map file, for neighbours that are restarted."""
        if self._keeper is not None:
            self._keeper.log(stream, stamp_ns, data())

    def _on_neighbour_restarted(self, streams: Iterable[str]) -> None:
        """Prepare for the streams of a node that was restarted."""
        for stream in streams:
            if stream in self._senders:
                self._senders[stream].expect_successor()

    def _newest_ns(self, stream: str) -> int:
        newest_ns = self._order.newest_of(stream) if stream in self._streams else None
        return newest_ns or 0

    def _new_order(self) -> StampOrder[Item]:
        lateness_s = getattr(self._section, 'max_lateness_s', 0.0)
        return StampOrder(
            self._streams, round(lateness_s * 1e9), self.REGULAR, self._is_restart_expected
        )

    def _is_restart_expected(self, waited_ns: int) -> bool:
        """Return whether a node is restarting, or has just sent what was missing.

        It can send nothing that is older than the logs from which it gets its own inputs.
        """
        return (
            waited_ns <= LOG_NS
            and self._keeper is not None and self._keeper.settled_s() < SETTLING_S
        )  # fmt: skip

    def _push(self, stream: str, stamp_ns: int, item: Item) -> None:
        """Put a message into the stamp order, and process all messages this releases."""
        if self._is_halted:
            self._diagnostics.counts['paused'] += 1
            return
        if self._keeper is not None and self._keeper.is_repeated(stream, stamp_ns):
            return
        if self._rhythm is not None and stream == self.REGULAR:
            self._restore_rhythm(stamp_ns)
        self._process(self._order.push(stream, stamp_ns, item))
        if self._order.jumped_back:
            self._handle_jump_back(stream, stamp_ns)
        self._count_dropped(stream, stamp_ns)

    def _restore_rhythm(self, stamp_ns: int) -> None:
        """Predict odometry as before the restart, if it goes on at this stamp."""
        rhythm, self._rhythm = self._rhythm, None
        if rhythm and rhythm['regular_ns'] is not None:
            gap_ns = stamp_ns - rhythm['regular_ns']
            if 0 <= gap_ns <= round(self._section.max_odom_gap_s * 1e9):
                self._order.restore_rhythm(rhythm)

    def _refuse(self, stream: str, reason: str) -> None:
        """Count and report a message that cannot be used."""
        self._diagnostics.drop('refused', f'a message of {stream} was refused: {reason}')

    def _process(self, released: Iterable[Released[Item]]) -> None:
        for stamp_ns, stream, item in released:
            if self._keeper is not None:
                self._keeper.reach(stream, stamp_ns)
            self._take(stamp_ns, stream, item)
            if self._keeper is not None:
                self._order.note_processed(stream, stamp_ns)

    def _take(self, stamp_ns: int, stream: str, item: Item) -> None:
        """Take the next message in stamp order."""
        self._save_before(stamp_ns)
        self._process_item(stamp_ns, stream, item)

    def _save_before(self, stamp_ns: int) -> None:
        """Before a message is processed, save the state if due, and take over set parameters."""
        self._save_if_due(stamp_ns)
        for config, changes in self._parameter_changes.due(stamp_ns):
            self._reconfigure(getattr(config, self.SECTION))
            for change in changes:
                self.get_logger().info(str(change))
            if self._keeper is not None:
                self._keeper.log(self._parameter_stream, stamp_ns, encode_values(changes))
                self._keeper.configure(self._own_sections())

    def _save_if_due(self, stamp_ns: int) -> None:
        if self._operations is not None:
            self._operations.before(stamp_ns)
        if self._keeper is None:
            return
        max_gap_s = getattr(self._section, 'max_odom_gap_s', MAX_GAP_NS * 1e-9)
        if self._keeper.is_other_session(stamp_ns, round(max_gap_s * 1e9)):
            self._begin_session()
        self._keeper.before(stamp_ns)

    def _process_held(self) -> None:
        """Process all messages that are held."""
        self._process(self._order.flush())

    def _flush(self) -> None:
        """Process the held messages if all inputs have been silent for flush_after_s.

        After the machine has stopped this process for so long, the timer runs before the messages
        that have arrived meanwhile are taken. So only silence that is seen twice counts.
        """
        silent_s = [one.silent_s() for one in self._inputs]
        if self._keeper is not None:
            silent_s.append(self._keeper.settled_s())
        was_silent = self._was_silent
        self._was_silent = all(one >= self._section.flush_after_s for one in silent_s)
        silent = self._was_silent and was_silent
        if silent and self._order.held:
            with self._lock:
                self._process_held()
                self._count_dropped('its inputs', self._order.newest_ns or 0)
        if silent:
            with self._lock:
                if self._operations is not None:
                    self._operations.pause()
                if self._keeper is not None:
                    self._keeper.pause()

    def _handle_jump_back(self, stream: str, stamp_ns: int) -> None:
        self._diagnostics.counts['jumps_back'] += 1
        # A recording that is played again must not delete a map on disk.
        if self._section.on_jump_back == 'start_over' and self._keeper is None:
            self._diagnostics.warn(
                f'the stamps of {stream} have jumped back: starting with an empty memory '
                '(on_jump_back)'
            )
            self._start_over()
            self._diagnostics.clear()
        else:
            self._diagnostics.warn(
                f'the stamps of {stream} have jumped back: keeping the memory (on_jump_back)'
            )
            self._process_held()
            self._on_relocated()
        if self._operations is not None:
            self._operations.start_run()
        if self._keeper is not None:
            self._keeper.start_run()
        self._process(self._order.restart())

    def _count_dropped(self, stream: str, stamp_ns: int) -> None:
        """Count and report the messages that the stamp order has dropped since the last call."""
        counts, before = self._order.counts, self._counted
        self._counted = counts
        message = f'a message of {stream} with stamp {stamp_ns * 1e-9:.3f} s'
        self._diagnostics.drop(
            'late',
            f'{message} came too late: later ones have been processed already (max_lateness_s)',
            counts.late - before.late,
        )
        self._diagnostics.drop(
            'refused',
            f'{message} or earlier was refused: stamps must increase without jumps',
            counts.refused - before.refused,
        )
        self._diagnostics.drop(
            'gaps',
            f'{stream} has a gap before {stamp_ns * 1e-9:.3f} s: it paused, or messages were lost',
            counts.gaps - before.gaps,
        )
        if counts.refused < before.refused:  # accepted later, as the beginning of a jump back
            self._diagnostics.counts['refused'] += counts.refused - before.refused

    # Timers and services

    def _publish_diagnostics(self) -> None:
        values: dict[str, Any] = {}
        for one in self._inputs:
            values[f'{one.name}_received'] = one.received
            values[f'{one.name}_hz'] = round(one.update(self._section.watchdog_after_s), 2)
        with self._lock:
            values['held'] = self._order.held
            values['memory'] = 'paused' if self._is_halted else 'mapping'
            if not self._mapping and not self._is_halted:
                values['memory'] = 'localisation only'
            values |= self._diagnostic_values()
            if self._parameter_changes.record:
                values['parameters_set'] = len(self._parameter_changes.record)
                values['last_parameter_set'] = str(self._parameter_changes.record[-1])
            if self._keeper is not None:
                values |= self._keeper.diagnostic_values()
        self._diagnostics.publish(values, self._state())

    def _state(self) -> str:
        """Return what the node does, judged by its inputs."""
        by_state = {
            state: [one.name for one in self._inputs if one.state == state]
            for state in ('waiting', 'finished')
        }
        if self._inputs and len(by_state['finished']) == len(self._inputs):
            return f'finished: {", ".join(by_state["finished"])} ended'
        if by_state['waiting']:
            return f'waiting for {", ".join(by_state["waiting"])}'
        return 'running'

    def _on_reset(self, request: Any, response: Any) -> Any:
        self._forget()
        return self._answer(response, True, f'{self.SECTION} has an empty memory')

    def _forget(self) -> None:
        """Drop all messages, and start with an empty memory."""
        with self._lock:
            self._drop_queued()
            self._order = self._new_order()
            self._counted = Counts()
            self._start_over()
            self._diagnostics.clear()

    def _on_pause(self, request: Any, response: Any) -> Any:
        with self._lock:
            if request.data and not self._paused:
                self._process_held()
            elif self._paused and not request.data:
                self._on_relocated()
            self._paused = bool(request.data)
        state = 'paused' if self._paused else 'running'
        return self._answer(response, True, f'{self.SECTION} is {state}')

    def _on_mapping(self, request: Any, response: Any) -> Any:
        with self._lock:
            self._mapping = bool(request.data)
            self._set_mapping(self._mapping)
        state = 'is mapping' if self._mapping else 'localises only; learning is off'
        return self._answer(response, True, f'{self.SECTION} {state}')

    def _on_save(self, request: Any, response: Any) -> Any:
        try:
            with self._lock:
                self._process_held()
                memory_files.save(self._memory_path, self.SECTION, self._saved_state())
        except RatslamError as error:
            return self._answer(response, False, str(error))
        return self._answer(response, True, f'saved to {self._memory_path}')

    def _on_load(self, request: Any, response: Any) -> Any:
        try:
            self._replace_memory(memory_files.load(self._memory_path, self.SECTION))
        except RatslamError as error:
            return self._answer(response, False, str(error))
        except KeyError as error:
            return self._answer(
                response, False, f'{self._memory_path} has no {error.args[0]!r}: it was written '
                'by an older version of ratslam_ros; map again and save',
            )  # fmt: skip
        except Exception as error:  # the content can be anything; the node keeps its memory
            return self._answer(response, False, f'{self._memory_path} does not fit: {error!r}')
        self._diagnostics.clear()
        return self._answer(response, True, f'loaded from {self._memory_path}')

    def _replace_memory(self, state: State) -> None:
        """Continue with another memory; raise and change nothing if it cannot be used."""
        with self._lock:
            self._restore_saved(state)
            self._drop_tasks()
            self._on_relocated()
            self._order = self._new_order()
            self._counted = Counts()
            if self._keeper is not None:
                self._keeper.changed()

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

    # Implemented by the nodes that learn

    def _set_mapping(self, mapping: bool) -> None:
        """Switch learning on or off."""
        raise NotImplementedError
