# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Host: the stages of all nodes of a process, as one pipeline.

A process with one node has the stage of this node, and takes its inputs from the topics of the
others. A process with all nodes has all stages, and its pipeline replaces these topics. Everything
else is the same. What a process receives from topics follows from the list of its stages alone.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from std_msgs.msg import String

from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import SHARED, Value
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.maps.input_log import Entry
from ratslam_ros.maps.live_states import Setting
from ratslam_ros.maps.log_entries import FINISH, PARAMETERS, receive
from ratslam_ros.maps.logged_items import encode_item
from ratslam_ros.maps.parameter_changes import encode_values
from ratslam_ros.messages.commands import CommandPayload
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.pipeline.commands import (
    NOW,
    Command,
    Configure,
    Hint,
    NewSession,
    Relocated,
    ReportBehaviour,
    Reset,
    SetMapping,
    SetPaused,
    UseOdometry,
    concerns,
)
from ratslam_ros.pipeline.item_states import command_state
from ratslam_ros.pipeline.order import Counts
from ratslam_ros.pipeline.pipeline import COMMAND, Pipeline, lateness_ns
from ratslam_ros.pipeline.streams import STREAMS
from ratslam_ros.ros.host_map import HostMap
from ratslam_ros.ros.hosted_node import HostedNode
from ratslam_ros.ros.inputs import Input
from ratslam_ros.ros.qos import STATIC

Listener = Callable[[Any], None]


class Host(HostMap):
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
        super().__init__()
        self._streams = [one for one in STREAMS if is_answered or not one.answers]
        self.inputs: list[Input] = []
        """Subscriptions of the nodes."""
        self._listeners: dict[str, list[Listener]] = {}
        self._decided = decided
        self._counted = Counts()
        self._was_silent = False

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
            stages, lateness_ns(self._config), self._stopwatch, self._streams
        )
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
            if not takers:
                raise UnusableParameter(
                    f'the stage of {self.nodes[-1].SECTION} reads {stream}, which no other node '
                    'of its process receives or writes; run it beside those that do '
                    '(single_process --stage)'
                )
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
            self._replay()
            self._settle()
            if self.recovery is not None and not self.recovery.accepts(stream, stamp_ns):
                return
            self.log(stream, stamp_ns, lambda: encode_item(item))
            self._take(node, stream, stamp_ns, item)

    def _take(self, node: HostedNode, stream: str, stamp_ns: int, item: Any) -> None:
        order = self.pipeline.order
        self.pipeline.feed(stream, stamp_ns, item)
        if order.jumped_back:
            self._handle_jump_back(node, stream)
        self._count_dropped(node, stream, stamp_ns)
        self._limit_waiting(node)
        for one in self.nodes:
            one.processed(stream)

    def answer(self, stream: str, item: Any) -> None:
        """Feed a received item of a stream of answers."""
        with self.lock:
            self._replay()
            self.log(stream, NOW, lambda: encode_item(item))
            self.pipeline.feed(stream, NOW, item)

    def receiver(
        self, stream: str, topics: Mapping[str, type], callback: Listener, resume: Listener
    ) -> Listener:
        """Return what receives the messages of a stream.

        Args:
            stream: its name.
            topics: type of the messages by topic.
            callback: takes each message.
            resume: takes those that were sent while the process was interrupted.
        """
        self._missed[stream] = topics, resume

        def receive(message: Any) -> None:
            if self.recovery is None or self.recovery.takes(stream, message):
                callback(message)

        return receive

    def publish(self, publisher: Any, topic: str, message: Any) -> None:
        """Publish a result, and keep it for nodes that are restarted."""
        publisher.publish(message)
        if self._history is not None:
            self._history.add(topic, message)

    def heard(self, stream: str, message: Any) -> None:
        """Pass a message that was received, or that a node of this process has sent."""
        for listener in self._listeners.get(stream, ()):
            listener(message)

    def _limit_waiting(self, node: HostedNode) -> None:
        """Wait for an answer of the map no longer than for the inputs."""
        if number := self.pipeline.limit_waiting():
            node.diagnostics.drop(
                'missed', 'experience_map does not answer: its relocations may be adopted later '
                'than in a replay', number,
            )  # fmt: skip

    def _before(self, stream: str, stamp_ns: int, item: Any) -> None:
        """Prepare for the next item of the stream: save if due."""
        for node in self.nodes:
            node.before(stamp_ns)
        keeper = self.keeper
        if keeper is not None:
            if keeper.is_other_session(stamp_ns, self._max_gap_ns):
                self.pipeline.obey(NewSession())
            keeper.before(stamp_ns)

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
            self.pipeline.end_run()
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
        if self.recovery is not None:
            if self.recovery.is_catching_up:
                return
            with self.lock:
                self._settle()
            silent_s.append(self.recovery.settled_s)
        after_s = min(node.config.inputs.flush_after_s for node in self.nodes)
        was_silent, self._was_silent = (
            self._was_silent, all(one >= after_s for one in silent_s)
        )  # fmt: skip
        if not (self._was_silent and was_silent):
            return
        with self.lock:
            order = self.pipeline.order
            if order.held or self.pipeline.is_waiting:
                self.finish()
                self._count_dropped(self.nodes[0], 'its inputs', order.newest_ns or 0)
            for node in self.nodes:
                node.silent()
            if self.recovery is not None:
                self.recovery.pause()
            if self.keeper is not None:
                self.keeper.pause()

    def finish(self) -> None:
        """Process the inputs that wait for others: none is expected before them."""
        self._replay()
        self.log(FINISH, NOW, bytes)
        self.pipeline.finish()

    # Commands

    def command(self, command: Command, stamp_ns: int = NOW) -> None:
        """Let a command take effect at its stamp, in all stages.

        Args:
            command: the command.
            stamp_ns: see commands.py. A request has none, as its arrival has no stamp: it acts
                after the inputs that were released, at a stamp by which that can be repeated.
        """
        with self.lock:
            self._replay()
            if isinstance(command, Hint) and self.keeper is not None and self.keeper.is_first:
                # The pose is one of the session that begins, although it has no message yet.
                self.keeper.is_first = False
                self.keeper.start_run()
                self.command(NewSession())
            self.log(COMMAND, stamp_ns, lambda: encode_item(command))
            if isinstance(command, Setting):
                self._settings[type(command), command.stage] = command
            self.pipeline.command(command, stamp_ns)

    def configure(self, node: HostedNode) -> None:
        """Continue with the present parameters of a node; record what changes, and from when."""
        with self.lock:
            values = node.parameter_changes.pending(node.config)
            self.log(f'{node.SECTION}{PARAMETERS}', NOW, lambda: encode_values(values))
            self._config = self._given()
            stamp_ns = self.pipeline.command(Configure(self._config))
            for change in node.parameter_changes.record_change(node.config, stamp_ns):
                node.get_logger().info(str(change))
            if self.keeper is not None:
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

    def halt(self, node: HostedNode, halted: bool) -> None:
        """Let the stage of a node skip its messages, or process them again.

        Args:
            node: the node; the others of the host go on.
            halted: whether its messages are skipped. When they are processed again, the robot may
                have been moved.
        """
        with self.lock:
            self._replay()
            if halted == self.is_halted(node):
                return
            if halted and all(self.is_halted(one) for one in self.nodes if one is not node):
                self.finish()  # nothing will be received that it could wait for
            self.command(SetPaused(halted, node.SECTION))
            if not halted:
                self.command(Relocated(node.SECTION))

    def release(self, node: HostedNode) -> None:
        """Let the stage of a node begin that was halted before anything was received."""
        with self.lock:
            command = SetPaused(False, node.SECTION)
            self._settings[SetPaused, node.SECTION] = command
            self.pipeline.command(command)

    def reset(self, node: HostedNode) -> None:
        """Start the stage of a node with an empty memory; inputs that wait belong to it."""
        self.command(Reset(node.SECTION))

    def _obeyed(self, stamp_ns: int, command: Command) -> None:
        """Publish a command, and save what it has changed."""
        if isinstance(command, ReportBehaviour):
            return
        if not self.is_replaying:
            payload = CommandPayload.of(stamp_ns, command_state(command))
            self._commands.publish(String(data=encode(payload)))
        if self.keeper is not None and not isinstance(command, NewSession):
            self.keeper.changed(stamp_ns)
        if isinstance(command, Reset):
            for node in self.nodes:
                if concerns(command, node.SECTION):
                    node.started_over()

    def replace(self, node: HostedNode, state: State) -> None:
        """Continue with another memory of a node; raise and keep the present one if unfit."""
        with self.lock:
            self._replay()
            before = node.saved_state()
            try:
                self._restore_node(node, state)
            except BaseException:
                self._restore_node(node, before)
                raise
            if self.keeper is not None:
                self.keeper.replaced(node.SECTION, state)

    def _restore_node(self, node: HostedNode, state: State) -> None:
        self.pipeline.restore_stage(node.SECTION, state)
        node.restored(state)

    def _again(self, entry: Entry, known_ns: dict[str, list[int]]) -> None:
        """Receive an entry of the log."""
        if entry.stream in self.pipeline.inputs:
            known_ns.setdefault(entry.stream, []).append(entry.stamp_ns)
        receive(entry, self)

    def take(self, stream: str, stamp_ns: int, item: Any) -> None:
        """Take an input of the log."""
        self._take(self._takers[stream][-1], stream, stamp_ns, item)

    def set_values(self, section: str, values: Mapping[str, Value]) -> None:
        """Set parameters of a node again."""
        self._node(section).set_values(values)

    def replaced(self, data: bytes) -> None:
        """Replace the memory of a node again."""
        assert self.keeper is not None
        section, state = self.keeper.load_replaced(data)
        self._node(section).restore_saved(state)

    def _node(self, section: str) -> HostedNode:
        return next(node for node in self.nodes if section == node.SECTION)
