# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Host: the stages of all nodes of a process, as one pipeline.

A process with all nodes has all stages, and its pipeline replaces the topics between them. A
process with some of them takes its inputs from the topics of the others, or, in a split, follows
the numbered stream of one (chain.py). Everything else is the same.
"""

from __future__ import annotations

import threading
import time
from collections import ChainMap, Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from std_msgs.msg import String

from ratslam_ros.chain import ALONE, Chain
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import SHARED, Value
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.maps import Cut
from ratslam_ros.maps.cut_grid import index_of
from ratslam_ros.maps.live_pipeline import LivePipeline, Process
from ratslam_ros.messages.commands import CommandPayload, PassedItem, stream_topic
from ratslam_ros.pipeline.codec import command_state
from ratslam_ros.pipeline.commands import NOW, Command, ReportBehaviour, Reset, concerns
from ratslam_ros.pipeline.order import Counts
from ratslam_ros.pipeline.pipeline import COMMAND, Pipeline
from ratslam_ros.pipeline.streams import STREAMS
from ratslam_ros.ros.host_map import HostMap, given_config
from ratslam_ros.ros.hosted_node import HostedNode
from ratslam_ros.ros.inputs import Input, SingleSender
from ratslam_ros.ros.payloads import decoded
from ratslam_ros.ros.qos import HISTORY_INPUT, STATIC, history
from ratslam_ros.ros.restart.history import MAX_KEPT

ANSWER_TIMEOUT_S = 30.0
"""Longest time to wait for an answer of the process behind, which may restart meanwhile. It never
comes if both were killed and that process had missed the action."""


class Host(Process):
    """Connects the pipeline of a process with its nodes: inputs, results, reports, map file.

    ``start`` creates the stages when all nodes have added themselves.
    """

    def __init__(self, is_answered: bool = True, chain: Chain = ALONE) -> None:
        """Prepare a host without nodes.

        Args:
            is_answered: if the pose cells are run without the map, an experience_map in another
                process may answer their actions; they wait for it once it has.
            chain: the place of the process in a split.
        """
        self.chain = chain
        self.lock = threading.RLock()
        """Serialises the thread that processes images with services and timers."""
        self.nodes: list[HostedNode] = []
        """Nodes add themselves before ``start``."""
        self.map = HostMap(self.nodes, self.lock, chain, self.follow, self.cut)
        is_answered = is_answered and (chain.is_followed or not chain.follows)
        self._streams = [one for one in STREAMS if is_answered or not one.answers]
        self.on_cut: list[Callable[[int | None], None]] = []
        """Called with the number of a cut that is due, or None as no further messages arrive."""
        self._counted, self._refused = Counts(), Counter[str]()
        self._was_silent = False
        self._awaited = 0, 0.0
        """Stamp of the item that waits for an answer in a silence, and since when."""
        self._stream: Input | None = None
        """Subscription to the stream that is followed."""

    # Set-up

    def start(self) -> None:
        """Create the stages of all nodes, connect them, and subscribe to the inputs."""
        self._share()
        for node in self.nodes:
            node.checked.declare()
        self._by_part = {node.SECTION: node for node in self.nodes}
        config = given_config(self.nodes)
        stages = [node.create_stage(config) for node in self.nodes]
        chain, last = self.chain, self.nodes[-1]
        if chain.is_followed:
            self._passed = last.create_payload_publisher(
                PassedItem, history(MAX_KEPT), stream_topic(last.SECTION)
            )
        self.live = self.map.live = LivePipeline(
            stages, config, self, chain, time.time_ns(), self._stopwatch, self._streams
        )
        pipeline = self.pipeline
        for stream in pipeline.inputs:
            pipeline.observe(stream, self._before)
        self._commands = self.nodes[0].create_payload_publisher(CommandPayload, STATIC)
        pipeline.observe(COMMAND, self._obeyed)
        for node in self.nodes:
            node.connect(pipeline)
        self._takers = {
            stream: [node for node in self.nodes if stream in node.TAKES]
            for stream in (*pipeline.inputs, *pipeline.answers)
        }
        for stream in pipeline.answers if chain.follows else self._takers:
            if not (self._takers[stream] or chain.is_followed):
                raise UnusableParameter(
                    f'the stage of {self.nodes[-1].SECTION} reads {stream}, which no other node '
                    'of its process receives or writes; run it beside those that do '
                    '(single_process --stage)'
                )
            self._receiver(stream).subscribe(stream)

    @property
    def pipeline(self) -> Pipeline:
        """The stages of all nodes."""
        return self.live.pipeline

    def _receiver(self, stream: str) -> HostedNode:
        """Return the node that receives a stream, and reports what is dropped of it."""
        # Images are prepared by the first node, and odometry has frames that the last needs.
        return (self._takers.get(stream) or self.nodes)[0 if stream == 'image' else -1]

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
        node = self._by_part.get(name.partition('.')[0], self.nodes[0])
        return node.diagnostics.times(name)

    # Inputs

    @contextmanager
    def ready(self) -> Iterator[LivePipeline]:
        """Lock the pipeline once it has received what followed the restored state; return it."""
        with self.lock:
            self.map.replay()
            yield self.live

    def feed(self, stream: str, stamp_ns: int, item: Any) -> None:
        """Feed a received item, and process all that need not wait any longer."""
        with self.ready() as live:
            self._count_paused(stream)
            if not self._is_paused:
                self.map.recovery.note(stream, stamp_ns)
                live.feed(stream, stamp_ns, item)

    @property
    def _is_paused(self) -> bool:
        """Whether received items are ignored: all stages are paused, and no process follows."""
        return not self.chain.is_followed and all(map(self.live.is_paused, self.pipeline.stages))

    def _count_paused(self, stream: str) -> None:
        for node in self._takers.get(stream, ()):
            if self.live.is_paused(node.SECTION):
                node.diagnostics.counts['paused'] += 1

    def follow(self) -> None:
        """Subscribe to the stream that is followed, if one is."""
        if self._stream is not None:
            self._stream.subscribe_again()
        elif self.chain.follows:
            node, topic = self.nodes[0], stream_topic(self.chain.follows)
            self._sender = SingleSender(node, topic)
            receive = decoded(PassedItem, self._on_passed, node.diagnostics.refuse, 'stream')
            self._stream = Input(node, 'stream', {topic: String}, receive, HISTORY_INPUT)
            node.inputs.append(self._stream)

    def _on_passed(self, passed: PassedItem) -> None:
        with self.ready() as live:
            self._sender.check(passed.run)
            self._count_paused(passed.stream)
            live.follow(passed)

    def passed(self, item: PassedItem) -> None:
        """Pass an item on to the process that follows."""
        self._passed.publish(item)

    def noted(self, text: str) -> None:
        """Report a loss."""
        self.nodes[0].diagnostics.counts['lost_spans'] += 1
        self.nodes[0].diagnostics.note(text)

    def heard(self, stream: str, message: Any) -> None:
        """Pass a message that was received, or that a node of this process has sent."""
        for node in self.nodes:
            node.heard(stream, message)

    def taken(self, stream: str, stamp_ns: int, unanswered: int) -> None:
        """Report what was dropped, and let the nodes publish what has changed."""
        node = self._receiver(stream)
        self._count_dropped(node, stream, stamp_ns)
        node.diagnostics.drop(
            'missed', 'experience_map does not answer: its relocations may be adopted later '
            'than in a replay', unanswered,
        )
        for one in self.nodes:
            one.processed(stream)

    def _before(self, stamp_ns: int, item: Any) -> None:
        """Prepare for the next item of the stream: save if due."""
        cut = self.map.grid.before(stamp_ns)
        if cut is not None and not self.chain.follows:
            self.cut(cut)
        self.map.has_changed = True

    def cut(self, cut: Cut) -> None:
        """Save the state, and let the process that follows do so after the same item."""
        self._reach(index_of(cut))
        self.live.pass_cut(cut)
        self.map.write(cut)

    def starts_over(self, stream: str) -> bool:
        """Report a jump back of the stamps; return whether the memory is emptied."""
        node = self._receiver(stream)
        node.diagnostics.counts['jumps_back'] += 1
        # A recording that is played again must not delete a map on disk.
        starts_over = node.config.inputs.on_jump_back == 'start_over' and self.map.store is None
        action = 'starting with an empty' if starts_over else 'keeping the'
        node.diagnostics.warn(
            f'the stamps of {stream} have jumped back: {action} memory (on_jump_back)'
        )
        return starts_over

    def start_run(self) -> None:
        """Expect stamps that are earlier than the last ones."""
        self.map.grid.start_run()

    def _count_dropped(self, node: HostedNode, stream: str, stamp_ns: int) -> None:
        """Count and report the messages that the stamp order has dropped since the last call."""
        counts, before = self.pipeline.order.counts, self._counted
        if counts == before:
            return
        self._counted = counts
        message = f'a message of {stream} with stamp {stamp_ns * 1e-9:.3f} s'
        node.diagnostics.drop(
            'late', f'{message} came too late: later ones have been processed already '
            '(max_lateness_s)', counts.late - before.late,
        )
        node.diagnostics.drop(
            'gaps', f'{stream} has a gap before {stamp_ns * 1e-9:.3f} s: it paused, or messages '
            'were lost', counts.gaps - before.gaps,
        )
        for name, number in self.pipeline.order.refused.items():
            more, self._refused[name] = number - self._refused[name], number
            diagnostics = self._receiver(name).diagnostics
            diagnostics.drop(
                'refused', f'a message of {name} with stamp {stamp_ns * 1e-9:.3f} s or earlier '
                'was refused: stamps must be 0 or more, and increase without jumps', more,
            )
            if more < 0:  # accepted later, as the beginning of a jump back
                diagnostics.counts['refused'] += more

    def flush(self) -> None:
        """Process the held messages if all inputs have been silent for flush_after_s.

        After the machine has stopped this process for so long, the timer runs before the messages
        that have arrived meanwhile are taken. So only silence that is seen twice counts.
        """
        if any(node.is_busy for node in self.nodes):
            return
        silent_s = [one.silent_s() for node in self.nodes for one in node.inputs]
        if self.map.recovery.is_catching_up:
            return
        if self._is_paused:
            self._reach(None)  # no cut follows from inputs that are ignored
        after_s = min(node.config.inputs.flush_after_s for node in self.nodes)
        was_silent, self._was_silent = (
            self._was_silent, all(one >= after_s for one in silent_s)
        )
        if not (self._was_silent and was_silent):
            return
        with self.lock:
            order, waiting_ns = self.pipeline.order, self.pipeline.waiting_ns
            if waiting_ns is not None and self.chain.is_followed and self._must_wait(waiting_ns):
                return
            if order.held or waiting_ns is not None:
                self.map.replay()
                self.live.finish()
                self._count_dropped(self.nodes[0], 'its inputs', order.newest_ns or 0)
            self._reach(None)
            self.map.pause()

    def _reach(self, number: int | None) -> None:
        """Report the number of a cut that is due, or None as no further messages arrive."""
        with self.lock:
            for reach in self.on_cut:
                reach(number)

    def _must_wait(self, stamp_ns: int) -> bool:
        """Return whether the answer for which an item waits may still come."""
        now_s = time.monotonic()
        if self._awaited[0] != stamp_ns:
            self._awaited = stamp_ns, now_s
        return now_s - self._awaited[1] < ANSWER_TIMEOUT_S

    # Commands

    def command(self, command: Command, stamp_ns: int = NOW) -> None:
        """Let a command take effect at its stamp, in all stages.

        Args:
            command: the command.
            stamp_ns: see commands.py. A request has none, as its arrival has no stamp: it acts
                after the inputs that were released, at a stamp by which that can be repeated.
        """
        with self.ready() as live:
            live.command(command, stamp_ns)

    # What follows from it

    def _obeyed(self, stamp_ns: int, command: Command) -> None:
        """Publish a command, and save what it has changed."""
        if isinstance(command, ReportBehaviour):
            return
        if not self.map.is_replaying:
            self._commands.publish(CommandPayload.of(stamp_ns, command_state(command)))
        self.map.obeyed(stamp_ns, command)
        if isinstance(command, Reset):
            for node in self.nodes:
                if concerns(command, node.SECTION):
                    node.started_over()

    def log(self, stream: str, stamp_ns: int, data: Callable[[], bytes]) -> None:
        """Log what is received, before it is used."""
        self.map.log(stream, stamp_ns, data)

    def configured(self, part: str, values: Mapping[str, Value]) -> None:
        """Log and save changes of parameters, which are those of the node too."""
        node = self._by_part[part]
        for change in self.live.changes[part][-len(values) :]:
            node.get_logger().info(str(change))
        node.set_values(values)
        self.map.configure()

    def restored(self, part: str) -> None:
        """Let a node continue with another memory of its stage."""
        self._by_part[part].restored()

    def replaced(self, part: str, state: State) -> None:
        """Log another memory."""
        self.map.replaced(part, state)
