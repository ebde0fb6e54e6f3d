# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Host: the stages of all nodes of a process, as one pipeline.

A process with one node has the stage of this node, and takes its inputs from the topics of the
others. A process with all nodes has all stages, and its pipeline replaces these topics. Everything
else is the same. What a process receives from topics follows from the list of its stages alone.
"""

from __future__ import annotations

import json
import threading
from collections import ChainMap
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from std_msgs.msg import String

from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import SHARED, Config
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.files.config import to_yaml
from ratslam_ros.maps import MapStore, read_map
from ratslam_ros.maps.file_writer import LOG_NS
from ratslam_ros.messages.commands import CommandPayload
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.pipeline.commands import (
    NOW,
    Command,
    Configure,
    NewSession,
    Relocated,
    Reset,
    SetBehaviour,
    SetMapping,
    SetPaused,
    UseOdometry,
    concerns,
)
from ratslam_ros.pipeline.item_states import command_from_state, command_state
from ratslam_ros.pipeline.order import Counts
from ratslam_ros.pipeline.pipeline import COMMAND, Pipeline, lateness_ns
from ratslam_ros.pipeline.streams import STREAMS
from ratslam_ros.ros.hosted_node import HostedNode
from ratslam_ros.ros.inputs import Input
from ratslam_ros.ros.mapping.map_operations import live_meta
from ratslam_ros.ros.parameter_changes import encode_values
from ratslam_ros.ros.qos import STATIC
from ratslam_ros.ros.restart.map_keeper import KeptInput, MapKeeper
from ratslam_ros.ros.restart.single_sender import SingleSender

SETTLING_S = 1.0
"""Time after the end of a restart in which the messages that were missing arrive."""

Listener = Callable[[Any], None]


class Host:
    """Runs the stages of some nodes on the messages that these receive.

    Nodes add themselves. ``start`` creates the stages when all have done so.
    """

    def __init__(self, is_answered: bool = True, decided: str = '') -> None:
        """Prepare a host without nodes.

        Args:
            is_answered: if the pose cells are run without the map, an experience_map in another
                process may answer their actions; they wait for it once it has.
            decided: what `auto` has decided about the odometry (``UseOdometry``), '' if nothing.
        """
        self._streams = [one for one in STREAMS if is_answered or not one.answers]
        self.lock = threading.RLock()
        """Serialises the thread that processes images with services and timers."""
        self.nodes: list[HostedNode] = []
        self.pipeline: Pipeline
        self.inputs: list[Input] = []
        """Subscriptions of the nodes."""
        self.keeper: MapKeeper | None = None
        """What the nodes save in the map file, if there is one."""
        self.kept_inputs: list[KeptInput] = []
        self.senders: dict[str, SingleSender] = {}
        """By stream, for those that come from another node."""
        self._listeners: dict[str, list[Listener]] = {}
        self._decided = decided
        self._settings: dict[tuple[type, str], SetMapping | SetPaused | UseOdometry] = {}
        """The last command of each kind for each stage."""
        self._counted = Counts()
        self._was_silent = False
        self._rhythm: State | None = None
        """Prediction of odometry in a restored state, until it is known whether that goes on."""

    # Set-up

    def add(self, node: HostedNode) -> None:
        """Add a node before ``start``."""
        self.nodes.append(node)

    def start(self) -> None:
        """Create the stages of all nodes, connect them, and subscribe to the inputs."""
        self._share()
        for node in self.nodes:
            node.checked.declare()
        self._config = self._given()
        self._max_gap_ns = round(1e9 * self._config.inputs.max_odom_gap_s)
        stages = [stage for node in self.nodes for stage in node.new_stages(self._config)]
        self.pipeline = Pipeline(
            stages, lateness_ns(self._config), self._stopwatch, self._streams,
            self._is_restart_expected,
        )  # fmt: skip
        for stream in self.pipeline.inputs:
            self.pipeline.observe(stream, partial(self._before, stream))
        self._commands = self.nodes[0].create_publisher(
            String, CommandPayload.TOPIC, STATIC
        )
        self.pipeline.observe(COMMAND, self._obeyed)
        for node in self.nodes:
            node.connect(self.pipeline)
        self._takers = {
            stream: [node for node in self.nodes if stream in node.TAKES]
            for stream in (*self.pipeline.inputs, *self.pipeline.answers)
        }
        for stream, takers in self._takers.items():
            # Images are prepared by the first node, and odometry has frames that the last needs.
            (takers[0] if stream == 'image' else takers[-1]).subscribe(stream)
        if self._decided:
            self.command(UseOdometry(self._decided))

    def _share(self) -> None:
        """Use the shared values that some nodes were given for all of the process.

        Raises:
            UnusableParameter: nodes have different values of a shared parameter.
        """
        shared = ChainMap(*(node.checked.shared for node in self.nodes))
        for node in self.nodes:
            node.checked.share({**shared, **node.checked.shared})
        first, values = self.nodes[0].SECTION, self.nodes[0].config.flat()
        for other in self.nodes[1:]:
            for key, value in other.config.flat().items():
                section, _, name = key.partition('.')
                if section in SHARED and value != values[key]:
                    raise UnusableParameter(
                        f'{name} is {values[key]!r} for {first} and {value!r} for '
                        f'{other.SECTION}; expected one value for all nodes of a process: set it '
                        'for all, in a file below /**'
                    )

    def _given(self) -> Config:
        """Return a configuration with the sections of all nodes."""
        return replace(self.nodes[0].config, **{
            section: getattr(node.config, section)
            for node in self.nodes for section in (node.SECTION, *node.PARTS)
        })  # fmt: skip

    def _stopwatch(self, name: str) -> Any:
        section = name.partition('.')[0]
        node = next((one for one in self.nodes if section == one.SECTION), self.nodes[0])
        return node.diagnostics.times(name)

    def listen(self, stream: str, listener: Listener) -> None:
        """Call a function with each received message of a stream, before it is fed."""
        self._listeners.setdefault(stream, []).append(listener)

    # Inputs

    def feed(self, node: HostedNode, stream: str, stamp_ns: int, item: Any) -> None:
        """Feed a received item, and process all that need not wait any longer.

        Args:
            node: the node that has received it, and reports what is dropped.
            stream: name of the stream.
            stamp_ns: stamp of the item.
            item: the item.
        """
        with self.lock:
            for one in self._takers[stream]:
                if self.is_halted(one):
                    one.diagnostics.counts['paused'] += 1
            if all(map(self.is_halted, self.nodes)):
                return
            if self.keeper is not None and self.keeper.is_repeated(stream, stamp_ns):
                return
            order = self.pipeline.order
            if self._rhythm is not None and stream == 'odometry':
                self._restore_rhythm(stamp_ns)
            self.pipeline.feed(stream, stamp_ns, item)
            if order.jumped_back:
                self._handle_jump_back(node, stream)
            self._count_dropped(node, stream, stamp_ns)
            self._limit_waiting(node)
            for one in self.nodes:
                one.processed(stream)

    def heard(self, stream: str, message: Any) -> None:
        """Pass a message that was received, or that a node of this process has sent."""
        for listener in self._listeners.get(stream, ()):
            listener(message)

    def _limit_waiting(self, node: HostedNode) -> None:
        """Wait for an answer of the map no longer than for the inputs."""
        pipeline = self.pipeline
        while pipeline.unanswered_ns > pipeline.max_lateness_ns:
            node.diagnostics.drop(
                'missed', 'experience_map does not answer: its relocations may be adopted later '
                'than in a replay',
            )  # fmt: skip
            pipeline.go_on_unanswered()

    def _before(self, stream: str, stamp_ns: int, item: Any) -> None:
        """Prepare for the next item of the stream: save if due."""
        for node in self.nodes:
            node.before(stamp_ns)
        keeper = self.keeper
        if keeper is not None:
            keeper.reach(stream, stamp_ns)
            if keeper.is_other_session(stamp_ns, self._max_gap_ns):
                self.pipeline.obey(NewSession())
            keeper.before(stamp_ns)
            self.pipeline.order.note_processed(stream, stamp_ns)

    def newest_ns(self, stream: str) -> int:
        """Return the newest stamp of an input, 0 if there is none."""
        order = self.pipeline.order
        return (order.newest_of(stream) or 0) if stream in order.streams else 0

    def _restore_rhythm(self, stamp_ns: int) -> None:
        """Predict odometry as before the restart, if it goes on at this stamp."""
        rhythm, self._rhythm = self._rhythm, None
        if rhythm and rhythm['regular_ns'] is not None and (
            0 <= stamp_ns - rhythm['regular_ns'] <= self._max_gap_ns
        ):
            self.pipeline.order.restore_rhythm(rhythm)

    def _handle_jump_back(self, node: HostedNode, stream: str) -> None:
        node.diagnostics.counts['jumps_back'] += 1
        # A recording that is played again must not delete a map on disk.
        if node.config.inputs.on_jump_back == 'start_over' and self.keeper is None:
            node.diagnostics.warn(
                f'the stamps of {stream} have jumped back: starting with an empty memory '
                '(on_jump_back)'
            )
            self.pipeline.obey(Reset())
        else:
            node.diagnostics.warn(
                f'the stamps of {stream} have jumped back: keeping the memory (on_jump_back)'
            )
            self.pipeline.finish()
            self.command(Relocated())
        for one in self.nodes:
            one.start_run()
        if self.keeper is not None:
            self.keeper.start_run()
        self.pipeline.restart()

    def _count_dropped(self, node: HostedNode, stream: str, stamp_ns: int) -> None:
        """Count and report the messages that the stamp order has dropped since the last call."""
        counts, before = self.pipeline.counts, self._counted
        if counts == before:
            return
        self._counted = counts
        message = f'a message of {stream} with stamp {stamp_ns * 1e-9:.3f} s'
        node.diagnostics.drop(
            'late', f'{message} came too late: later ones have been processed already '
            '(max_lateness_s)', counts.late - before.late,
        )  # fmt: skip
        node.diagnostics.drop(
            'refused', f'{message} or earlier was refused: stamps must increase without jumps',
            counts.refused - before.refused,
        )  # fmt: skip
        node.diagnostics.drop(
            'gaps', f'{stream} has a gap before {stamp_ns * 1e-9:.3f} s: it paused, or messages '
            'were lost', counts.gaps - before.gaps,
        )  # fmt: skip
        if counts.refused < before.refused:  # accepted later, as the beginning of a jump back
            node.diagnostics.counts['refused'] += counts.refused - before.refused

    def flush(self) -> None:
        """Process the held messages if all inputs have been silent for flush_after_s.

        After the machine has stopped this process for so long, the timer runs before the messages
        that have arrived meanwhile are taken. So only silence that is seen twice counts.
        """
        if any(node.is_busy for node in self.nodes):
            return
        silent_s = [one.silent_s() for one in self.inputs]
        if self.keeper is not None:
            silent_s.append(self.keeper.settled_s())
        after_s = min(node.config.inputs.flush_after_s for node in self.nodes)
        was_silent, self._was_silent = (
            self._was_silent, all(one >= after_s for one in silent_s)
        )  # fmt: skip
        if not (self._was_silent and was_silent):
            return
        with self.lock:
            order = self.pipeline.order
            if order.held or self.pipeline.is_waiting:
                self.pipeline.finish()
                self._count_dropped(self.nodes[0], 'its inputs', order.newest_ns or 0)
            for node in self.nodes:
                node.silent()
            if self.keeper is not None:
                self.keeper.pause()

    # Commands

    def command(self, command: Command, stamp_ns: int = NOW) -> None:
        """Let a command take effect at its stamp, in all stages.

        Args:
            command: the command.
            stamp_ns: see commands.py. A request has none, as its arrival has no stamp: it acts
                after the inputs that were released, at a stamp by which that can be repeated.
        """
        with self.lock:
            if isinstance(command, SetMapping | SetPaused | UseOdometry):
                self._settings[type(command), command.stage] = command
            self.pipeline.command(command, stamp_ns)

    @property
    def _command_log(self) -> str:
        return f'{self.nodes[0].SECTION}_commands'

    def configure(self, node: HostedNode, stamp_ns: int = NOW) -> None:
        """Continue with the present parameters of a node; record what changes, and from when."""
        with self.lock:
            self._config = self._given()
            stamp_ns = self.pipeline.command(Configure(self._config), stamp_ns)
            changes = node.parameter_changes.record_change(node.config, stamp_ns)
            for change in changes:
                node.get_logger().info(str(change))
            if self.keeper is not None:
                self.keeper.log(node.parameter_stream, stamp_ns, encode_values(changes))
                self.keeper.changed(stamp_ns)
                self.keeper.configure(self._own_sections())

    def is_halted(self, node: HostedNode) -> bool:
        """Return whether the stage of a node skips its messages now."""
        setting = self._settings.get((SetPaused, node.SECTION))
        return isinstance(setting, SetPaused) and setting.paused

    def is_mapping(self, node: HostedNode) -> bool:
        """Return whether the stage of a node learns."""
        setting = self._settings.get((SetMapping, node.SECTION))
        return not isinstance(setting, SetMapping) or setting.mapping

    def halt(self, node: HostedNode, halted: bool, moved: bool = True) -> None:
        """Let the stage of a node skip its messages, or process them again.

        Args:
            node: the node; the others of the host go on.
            halted: whether its messages are skipped.
            moved: whether the robot may have been moved meanwhile.
        """
        with self.lock:
            if halted == self.is_halted(node):
                return
            if halted and all(self.is_halted(one) for one in self.nodes if one is not node):
                self.pipeline.finish()  # nothing will be received that it could wait for
            self.command(SetPaused(halted, node.SECTION))
            if moved and not halted:
                self.command(Relocated(node.SECTION))

    def reset(self, node: HostedNode) -> None:
        """Start the stage of a node with an empty memory; inputs that wait belong to it."""
        self.command(Reset(node.SECTION))

    def _obeyed(self, stamp_ns: int, command: Command) -> None:
        """Publish a command, and log a request for a restart.

        Parameters are logged by name, and other commands follow from what others log.
        """
        payload = CommandPayload.of(stamp_ns, command_state(command))
        self._commands.publish(String(data=encode(payload)))
        is_request = not isinstance(command, Configure | NewSession | SetBehaviour)
        if self.keeper is not None and is_request:
            text = json.dumps(command_state(command))
            self.keeper.log(self._command_log, stamp_ns, text.encode())
            self.keeper.changed(stamp_ns)
        if isinstance(command, Reset):
            for node in self.nodes:
                if concerns(command, node.SECTION):
                    node.started_over()

    def replace(self, node: HostedNode, state: State) -> None:
        """Continue with another memory of a node; raise and keep the present one if unfit."""
        with self.lock:
            before = node.saved_state()
            try:
                self._restore_node(node, state)
            except BaseException:
                self._restore_node(node, before)
                raise

    def _restore_node(self, node: HostedNode, state: State) -> None:
        self.pipeline.restore_stage(node.SECTION, state)
        node.restored(state)

    # The map file

    def open_map(self) -> None:
        """Restore the stages from the map file, if one is given, and save them there.

        Raises:
            UnusableInput: the file cannot be used, or its map does not fit the parameters.
        """
        self.restore_map()
        self.catch_up()

    def restore_map(self) -> None:
        """Do the first part of ``open_map``."""
        memory = self._config.memory
        if not memory.map:
            return
        path = Path(memory.map).expanduser()
        if memory.localize:
            self._localise_in(path)
            return
        parts = [node.SECTION for node in self.nodes]
        meta = live_meta(self._own_sections())
        store = MapStore.open(path, parts, meta, self.nodes[0].get_logger().warning)
        keeper = MapKeeper(
            self.nodes[0], self.nodes[0].diagnostics, store, tuple(parts), self._kept_states,
            self.newest_ns, self._on_neighbour_restarted,
        )  # fmt: skip
        try:
            with self.lock:
                if keeper.restored is not None:
                    self._restore(keeper, store.joins)
        except BaseException:
            store.close()
            raise
        self.keeper = keeper

    def _restore(self, keeper: MapKeeper, joins: bool) -> None:
        assert keeper.restored is not None
        for node in self.nodes:
            state = keeper.restored.get(node.SECTION)
            if state is None:
                continue
            node.restore_saved(state)
            self._rhythm = state.get('rhythm')
            if keeper.joins:
                node.resume_parameters(keeper.logged(node.parameter_stream, keeper.since_ns))
                for setting in state.get('settings', ()):
                    self.command(command_from_state(setting))
            if not joins:
                node.drop_tasks()
        if keeper.joins:
            for stamp_ns, data in keeper.logged(self._command_log, keeper.since_ns):
                self.command(command_from_state(json.loads(data)), stamp_ns)
            self._restore_rhythm(keeper.since_ns)
            keeper.configure(self._own_sections())

    def _kept_states(self) -> dict[str, State]:
        """Return the memories, and what a restarted node needs for the same order of messages."""
        rhythm = self.pipeline.order.rhythm if self.pipeline.has_regular else None
        return {
            node.SECTION: {
                **node.saved_state(), **({} if rhythm is None else {'rhythm': rhythm}),
                **({'settings': settings} if (settings := self._settings_of(node)) else {}),
            }
            for node in self.nodes
        }  # fmt: skip

    def _settings_of(self, node: HostedNode) -> list[State]:
        return [
            command_state(command) for (_, stage), command in self._settings.items()
            if stage == node.SECTION
        ]  # fmt: skip

    def catch_up(self) -> None:
        """Get the messages that were sent since the restored state."""
        if self.keeper is not None:
            repeats = tuple(stream for node in self.nodes for stream in node.REPEATS)
            self.keeper.resume(self.kept_inputs, repeats, self.lock, self._on_caught_up)

    def _on_caught_up(self, are_images_lost: bool) -> None:
        for node in self.nodes:
            node.caught_up(are_images_lost)

    def _localise_in(self, path: Path) -> None:
        """Restore the stages from a map file that stays unchanged, and stop learning."""
        saved = read_map(path)
        with self.lock:
            for node in self.nodes:
                if node.SECTION in saved.states:
                    node.restore_saved(saved.states[node.SECTION])
                    node.drop_tasks()
            self.command(NewSession())
            for node in self.nodes:
                node.localise()

    def close_map(self) -> None:
        """Process the messages that are still held, and save the last state."""
        with self.lock:
            self.pipeline.finish()
            if self.keeper is not None:
                self.keeper.close()
                self.keeper = None

    def log(self, stream: str, stamp_ns: int, data: Callable[[], bytes]) -> None:
        """Log a message in the map file, for neighbours that are restarted."""
        if self.keeper is not None:
            self.keeper.log(stream, stamp_ns, data())

    def _own_sections(self) -> str:
        sections = [section for node in self.nodes for section in (node.SECTION, *node.PARTS)]
        return to_yaml(self._given(), tuple(sections))

    def _on_neighbour_restarted(self, streams: Iterable[str]) -> None:
        """Prepare for the streams of a node that was restarted."""
        for stream in streams:
            if stream in self.senders:
                self.senders[stream].expect_successor()

    def _is_restart_expected(self, waited_ns: int) -> bool:
        """Return whether a node is restarting, or has just sent what was missing.

        It can send nothing that is older than the logs from which it gets its own inputs.
        """
        return (
            waited_ns <= LOG_NS
            and self.keeper is not None and self.keeper.settled_s() < SETTLING_S
        )  # fmt: skip
