# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The map file of a host: its nodes are restored from it, saved in it, and catch up."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.files.config import to_yaml
from ratslam_ros.maps import MapStore, live_meta, read_map
from ratslam_ros.maps.input_log import Entry
from ratslam_ros.maps.live_states import Setting, live_states
from ratslam_ros.maps.log_entries import PATIENT
from ratslam_ros.maps.logged_items import decode_item
from ratslam_ros.pipeline.commands import (
    NOW,
    Command,
    NewSession,
    UseOdometry,
)
from ratslam_ros.pipeline.item_states import command_from_state, command_state
from ratslam_ros.pipeline.pipeline import Pipeline
from ratslam_ros.pipeline.stage import own_class
from ratslam_ros.ros.hosted_node import HostedNode
from ratslam_ros.ros.restart.catch_up import Missed
from ratslam_ros.ros.restart.history import History
from ratslam_ros.ros.restart.map_keeper import MapKeeper
from ratslam_ros.ros.restart.recovery import Recovery


class HostMap:
    """What a host does with the map file of its nodes; nothing if they are given none."""

    pipeline: Pipeline
    _config: Config

    def __init__(self) -> None:
        self.lock = threading.RLock()
        """Serialises the thread that processes images with services and timers."""
        self.nodes: list[HostedNode] = []
        self.keeper: MapKeeper | None = None
        """What the nodes save in the map file, if there is one."""
        self.recovery: Recovery | None = None
        """What the nodes do about interruptions, if there is a map file."""
        self._history: History | None = None
        self._missed: dict[str, tuple[Mapping[str, type], Callable[[Any], None]]] = {}
        """By stream, the topics of an input, and what receives messages of the past."""
        self._settings: dict[tuple[type, str], Setting] = {}
        """The last command of each kind for each stage."""
        self._has_caught_up = False
        self._known_ns: dict[str, list[int]] | None = None
        """Stamps of the messages before an interruption, once they were received again."""

    def command(self, command: Command, stamp_ns: int = NOW) -> None:
        """Let a command take effect at its stamp, in all stages."""
        raise NotImplementedError

    def _again(self, entry: Entry, known_ns: dict[str, list[int]]) -> None:
        """Receive an entry of the log; add the stamp of an input to those that are known."""
        raise NotImplementedError

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
        parts = [node.SECTION for node in self.nodes]
        meta = live_meta(self._own_sections())
        first = self.nodes[0]
        store = MapStore.open(path, parts, meta, first.get_logger().warning)
        try:
            keeper = MapKeeper(
                first, first.diagnostics, store, tuple(parts), self._kept_states, memory.keep_log
            )
        except BaseException:
            store.abandon()
            raise
        self._history = self._history or History(first)
        try:
            with self.lock:
                if keeper.restored is not None:
                    self._restore(keeper, keeper.restored)
            keeper.keep(meta.configuration, [
                command_state(one) for one in self._settings.values()
                if isinstance(one, UseOdometry)
            ], tuple(filter(None, map(own_class, self.pipeline.stages.values()))))
        except BaseException:
            keeper.abandon()
            raise
        self.keeper = keeper
        self.recovery = Recovery(
            first, [node.get_name() for node in self.nodes], first.diagnostics, self._newest_ns
        )
        self._has_caught_up, self._known_ns = False, None

    def _restore(self, keeper: MapKeeper, restored: Mapping[str, State]) -> None:
        for node in self.nodes:
            state = restored.get(node.SECTION)
            if state is None:
                continue
            node.restore_saved(state)
            if keeper.is_resumed:
                node.resume_parameters()
                for setting in state.get('settings', ()):
                    self.command(command_from_state(setting))
            if keeper.misses:
                node.send_again()
            if keeper.is_first:
                node.lose_place()
            if not keeper.joins:
                node.drop_tasks()
        inputs = restored.get(self.nodes[0].SECTION, {}).get('inputs', {})
        if keeper.is_resumed and inputs.get('streams') == list(self.pipeline.inputs):
            self.pipeline.restore_inputs(inputs, lambda item: decode_item(item.tobytes()))

    def _kept_states(self) -> dict[str, State]:
        """Return the memories, and what a process that was interrupted needs besides."""
        parts = {node.SECTION: node.saved_state() for node in self.nodes}
        return live_states(self.pipeline, parts, [*self._settings.values()])

    def catch_up(self) -> None:
        """Receive what came after the restored state, and what was sent since, once."""
        keeper, recovery = self.keeper, self.recovery
        if keeper is None or recovery is None or self._has_caught_up:
            return
        self._has_caught_up = True
        for note in keeper.notes:
            self.nodes[0].diagnostics.note(note)
        missed = {
            stream: Missed(topics, resume) for stream, (topics, resume) in self._missed.items()
        }
        recovery.begin(
            missed, keeper.misses, self.lock, self._replay, self._history_floor_ns
        )

    def _history_floor_ns(self, stream: str) -> int | None:
        """Return the stamp up to which the history of a stream is known; None: not wanted."""
        keeper = self.keeper
        if keeper is None or not keeper.misses:
            return None
        newest_ns = self._newest_ns(stream) if stream in self.pipeline.inputs else None
        return max(newest_ns or -1, -1 if keeper.has_log else keeper.since_ns)

    def _replay(self) -> Mapping[str, list[int]]:
        """Receive what came after the restored state, once; return its stamps by stream."""
        keeper = self.keeper
        if keeper is None or self._known_ns is not None:
            return self._known_ns or {}
        self._known_ns = known_ns = {
            stream: [stamp_ns] for stream in self.pipeline.inputs
            if (stamp_ns := self._newest_ns(stream)) is not None
        }
        if keeper.has_log:
            count = keeper.replay(
                self.pipeline.go_on, lambda entry: self._again(entry, known_ns)
            )
            self.nodes[0].get_logger().info(
                f'continued from the map at {keeper.since_ns * 1e-9:.3f} s with {count} messages '
                'since then'
            )
            keeper.configure(self._own_sections())
        return known_ns

    def ready(self) -> None:
        """Receive what came after the restored state, before something else changes it."""
        with self.lock:
            self._replay()

    @property
    def is_replaying(self) -> bool:
        """Whether messages from before an interruption are being received again."""
        return self.keeper is not None and self.keeper.is_replaying

    def _newest_ns(self, stream: str) -> int | None:
        """Return the newest accepted stamp of an input, None if there is none."""
        return self.pipeline.order.newest_of(stream)

    def _settle(self) -> None:
        """Let inputs wait longer while a node is restarted."""
        if self.recovery is not None:
            is_patient = self.recovery.is_settling()
            if is_patient != self.pipeline.order.is_patient:
                self.set_patient(is_patient)

    def set_patient(self, is_patient: bool) -> None:
        """Let inputs wait longer for others, or not."""
        self.log(PATIENT, NOW, lambda: b'1' if is_patient else b'')
        self.pipeline.set_patient(is_patient)

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
            if self.recovery is not None:
                self.recovery.close()
                self.recovery = None
            self._replay()
            self.pipeline.finish()
            if self.keeper is not None:
                self.keeper.close()
                self.keeper = None

    def save(self) -> None:
        """Save the present state."""
        with self.lock:
            self._replay()
            if self.keeper is not None:
                self.keeper.pause()

    def log(self, stream: str, stamp_ns: int, data: Callable[[], bytes]) -> None:
        """Log what is received before it is used."""
        if self.keeper is not None:
            self.keeper.log(stream, stamp_ns, data)

    def _given(self) -> Config:
        """Return a configuration with the sections of all nodes."""
        return replace(self.nodes[0].config, **{
            section: getattr(node.config, section)
            for node in self.nodes for section in node.sections
        })  # fmt: skip

    def _own_sections(self) -> str:
        sections = [section for node in self.nodes for section in node.sections]
        return to_yaml(self._given(), sections)
