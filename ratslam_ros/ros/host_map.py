# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The map file of a host: its pipeline is restored from it, saved in it, and catches up."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.files.config import to_yaml
from ratslam_ros.maps import MapStore, live_meta, read_map
from ratslam_ros.maps.input_log import Entry, kept_folder
from ratslam_ros.maps.kept_log import Beginning
from ratslam_ros.pipeline.commands import NewSession, SetMapping
from ratslam_ros.ros.restart.map_keeper import MapKeeper
from ratslam_ros.ros.restart.recovery import Missed, Recovery

Node = Any
"""A RatslamNode; its module imports this one."""

Receive = Callable[[Any], None]


class HostMap:
    """What a host does with the map file of its nodes; nothing if they are given none."""

    def __init__(self, host: Any) -> None:
        """Open nothing yet, for a Host."""
        self._host, self._nodes, self._lock = host, host.nodes, host.lock
        self.keeper: MapKeeper | None = None
        """What the nodes save in the map file, if there is one."""
        self.recovery: Recovery | None = None
        """What is done about missed inputs, if there are some and a map file."""
        self._unsent: dict[Any, Any] = {}
        """The last result by publisher, of those that follow from the log."""
        self._missed: dict[str, tuple[Mapping[str, type], Receive]] = {}
        """By stream, the topics of an input, and what receives messages of the past."""
        self._has_caught_up = False
        self._known_ns: dict[str, list[int]] | None = None
        """Stamps of the messages before an interruption, once they were received again."""

    # Start

    def open(self) -> None:
        """Restore the stages from the map file, if one is given, and save them there.

        Raises:
            UnusableInput: the file cannot be used, or its map does not fit the parameters.
        """
        self.restore()
        self.catch_up()

    def restore(self) -> None:
        """Do the first part of ``open``."""
        memory = self._nodes[0].config.memory
        if memory.keep_log and (memory.localize or not memory.map):
            raise UnusableParameter(
                'keep_log is true, but no map file is written, beside which a log is kept: set '
                'map, and leave out localize'
            )
        if not memory.map:
            return
        path = Path(memory.map).expanduser()
        if memory.localize:
            self._localise_in(path)
            return
        parts = tuple(self._host.live.pipeline.stages)
        meta = live_meta(self._own_sections())
        first = self._nodes[0]
        store = MapStore(path, parts, meta, first.get_logger().warning)
        try:
            keeper = MapKeeper(self._host, store)
        except BaseException:
            store.abandon()
            raise
        beginning = keeper.beginning(meta.configuration)
        try:
            with self._lock:
                self._restore(keeper, beginning, kept_folder(store.path, parts[0]))
            keeper.keep(beginning)
        except BaseException:
            keeper.abandon()
            raise
        self.keeper = keeper
        self.recovery = Recovery(first, first.diagnostics)
        self._has_caught_up, self._known_ns = False, None

    def _restore(self, keeper: MapKeeper, beginning: Beginning, kept: Path) -> None:
        states = keeper.restored or {}
        self._host.live.begin(beginning, states, kept)
        for node in self._nodes:
            if node.SECTION in states:
                if keeper.misses:
                    node.send_again()
                if not keeper.joins:
                    node.drop_tasks()

    def _localise_in(self, path: Path) -> None:
        """Restore the stages from a map file that stays unchanged, and stop learning."""
        saved = read_map(path)
        with self._lock:
            for node in self._nodes:
                if node.SECTION in saved.states:
                    self._host.live.replace(node.SECTION, saved.states[node.SECTION])
                    node.drop_tasks()
            self._host.live.command(NewSession())
            for node in self._nodes:
                self._host.live.command(SetMapping(False, node.SECTION))

    def _own_sections(self) -> str:
        sections = [section for node in self._nodes for section in node.sections]
        return to_yaml(given_config(self._nodes), sections)

    # Interruptions

    def receiver(
        self, stream: str, topics: Mapping[str, type], callback: Receive, resume: Receive
    ) -> Receive:
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

    def publish(self, publisher: Any, message: Any) -> None:
        """Publish a result; of those that were published before, only the last one again."""
        if self.is_replaying:
            self._unsent[publisher] = message
        else:
            publisher.publish(message)

    def catch_up(self) -> None:
        """Receive what came after the restored state, and what was sent since, once."""
        if self._has_caught_up:
            return
        self._has_caught_up = True
        keeper, recovery = self.keeper, self.recovery
        for note in [] if keeper is None else keeper.notes:
            self._nodes[0].diagnostics.note(note)
        if keeper is None or recovery is None or not keeper.misses:
            self.replay()
            self._host.follow()
            return
        missed = {
            stream: Missed(topics, resume) for stream, (topics, resume) in self._missed.items()
        }
        # It takes a second at least, in which subscribers of the results are connected.
        recovery.begin(missed, partial(self._deliver, recovery))

    def _deliver(self, recovery: Recovery) -> None:
        with self._lock:
            recovery.deliver(self.replay(), self._history_floor_ns)
            self._host.follow()

    def _history_floor_ns(self, stream: str) -> int:
        """Return the stamp up to which the history of a stream is known."""
        newest_ns, keeper = self._newest_ns(stream), self.keeper
        assert keeper is not None
        if newest_ns is not None and keeper.has_log:
            return newest_ns
        return max(newest_ns or -1, keeper.since_ns)

    def replay(self) -> Mapping[str, list[int]]:
        """Receive what came after the restored state, once; return its stamps by stream.

        Call it before anything else changes the state.
        """
        with self._lock:
            if self.keeper is not None and self._known_ns is None:
                self._known_ns = {
                    stream: [stamp_ns] for stream in self._missed
                    if (stamp_ns := self._newest_ns(stream)) is not None
                }
                if self.keeper.has_log:
                    self._receive_log(self.keeper, self._known_ns)
                self._host.live.begin_run()
            return self._known_ns or {}

    def _receive_log(self, keeper: MapKeeper, known_ns: dict[str, list[int]]) -> None:
        def receive(entry: Entry) -> None:
            if entry.stream in self._missed:
                known_ns.setdefault(entry.stream, []).append(entry.stamp_ns)
            self._host.live.receive(entry)

        count = keeper.replay(self._host.live.pipeline.go_on, receive)
        for publisher, message in self._unsent.items():
            publisher.publish(message)
        self._unsent.clear()
        self._nodes[0].get_logger().info(
            f'continued from the map at {keeper.since_ns * 1e-9:.3f} s with {count} messages '
            'since then'
        )
        self.configure()

    @property
    def is_replaying(self) -> bool:
        """Whether messages from before an interruption are being received again."""
        return self.keeper is not None and self.keeper.is_replaying

    def _newest_ns(self, stream: str) -> int | None:
        """Return the newest accepted stamp of an input, None if there is none."""
        pipeline = self._host.live.pipeline
        return pipeline.order.newest_of(stream) if stream in pipeline.inputs else None

    # Saving

    def configure(self) -> None:
        """Save the present parameters with the next state."""
        if self.keeper is not None:
            self.keeper.configure(self._own_sections())

    def save(self) -> None:
        """Save the present state."""
        with self._lock:
            self.replay()
            if self.keeper is not None:
                self.keeper.pause()

    def pause(self) -> None:
        """Save the state, and report what is lost, as no further messages arrive at present."""
        if self.recovery is not None:
            self.recovery.pause()
        if self.keeper is not None:
            self.keeper.pause()

    def close(self) -> None:
        """Process the messages that are still held, and save the last state.

        Messages are dropped that processes behind this one could not receive any more.
        """
        with self._lock:
            if self.recovery is not None:
                self.recovery.close()
                self.recovery = None
            self.replay()
            if not self._host.live.run:
                self._host.live.pipeline.finish()
            if self.keeper is not None:
                self.keeper.close()
                self.keeper = None

    def diagnostic_values(self) -> dict[str, Any]:
        """Return the values for the diagnostics."""
        values = {} if self.keeper is None else self.keeper.diagnostic_values()
        if self.recovery is not None:
            is_catching_up = self.recovery.is_catching_up
            values['map_state'] = 'catching up' if is_catching_up else 'saving'
        return values


def given_config(nodes: Sequence[Node]) -> Config:
    """Return a configuration with the sections of all nodes of a process."""
    config: Config = nodes[0].config
    return replace(config, **{
        section: getattr(node.config, section) for node in nodes for section in node.sections
    })
