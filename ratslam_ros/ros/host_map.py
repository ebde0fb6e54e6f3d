# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The map file of a host: its pipeline is restored from it, saved in it, and catches up.

The process writes its state at points of a grid of stamps (cut_grid.py), so that the states of all
processes belong together, and logs what it receives in between. After an interruption it restores
the newest cut that all processes have, and receives its log again. So its state is that of the
moment of the interruption, and it passes on again what others may have missed. What was sent
meanwhile comes from the process that it follows, or from histories of the sources (recovery.py).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from std_msgs.msg import Int64

from ratslam_ros.chain import Chain
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.files.config import to_yaml
from ratslam_ros.maps import Cut, MapStore, live_meta, read_map
from ratslam_ros.maps.cut_grid import CutGrid
from ratslam_ros.maps.input_log import (
    ATTEMPT,
    MOST_ATTEMPTS,
    VERSION,
    Entry,
    InputLog,
    kept_folder,
    used,
)
from ratslam_ros.maps.kept_log import Beginning, LogKeeper
from ratslam_ros.maps.live_pipeline import MAX_CUT, REPLACED, LivePipeline
from ratslam_ros.pipeline.codec import command_state
from ratslam_ros.pipeline.commands import (
    Command,
    NewSession,
    SetMapping,
    SetPaused,
    UseOdometry,
)
from ratslam_ros.pipeline.stage import own_class
from ratslam_ros.ros.hosted_node import HostedNode
from ratslam_ros.ros.qos import LATCHED
from ratslam_ros.ros.restart.history import CUT
from ratslam_ros.ros.restart.recovery import Recovery

CLOSE_TIMEOUT_S = 3.0
"""Longest time for the last write: SIGKILL may follow five seconds after SIGTERM."""

MOST_UNSAVED_S = 5.0
"""Longest time of mapping for which the newest cut of all nodes may stay the same."""


class HostMap:
    """What a host does with the map file of its nodes; nothing if they are given none."""

    live: LivePipeline
    """The pipeline of the host, once that has started."""
    _log: InputLog
    _misses = False
    """Whether messages were sent while this process, or all of them, did not run."""

    def __init__(
        self, nodes: Sequence[HostedNode], lock: threading.RLock, chain: Chain,
        follow: Callable[[], None], cut: Callable[[Cut], None],
    ) -> None:
        """Open nothing yet.

        Args:
            nodes: those of the process, added before the file is opened.
            lock: that of its pipeline.
            chain: its place in a split.
            follow: subscribes to the stream that is followed, if one is.
            cut: saves the state, and lets the process that follows do so.
        """
        self._nodes, self._lock, self._chain = nodes, lock, chain
        self._follow, self._cut = follow, cut
        self.grid = CutGrid()
        """Cuts of the process; with a map file they continue those of the file."""
        self.store: MapStore | None = None
        """The map file, while it is open."""
        self.recovery = Recovery(nodes)
        """What is done about missed inputs, if there is a map file."""
        self.is_replaying = False
        """Whether messages from before an interruption are being received again."""
        self._kept: LogKeeper | None = None
        self._unsent: dict[Any, Any] = {}
        """The last result by publisher, of those that follow from the log."""
        self._has_caught_up = False
        self._known_ns: dict[str, list[int]] | None = None
        """Stamps of the messages before an interruption, once they were received again."""

    # Start

    def open(self) -> None:
        """Restore the stages from the map file, if one is given, and save them there.

        Raises:
            UnusableInput: the file cannot be used, its map does not fit the parameters, or the log
                is to be kept, and cannot be.
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
            if memory.localize:
                raise UnusableParameter(
                    'localize is true, but there is no map in which to localise: set map'
                )
            return
        path = Path(memory.map).expanduser()
        if memory.localize:
            self._localise_in(path)
            return
        configuration, node = own_yaml(*self._nodes), self._nodes[0]
        parts = tuple(self.live.pipeline.stages)
        store = MapStore(path, parts, live_meta(configuration), node.get_logger().warning)
        self._misses = store.file.is_interrupted or store.file.joins
        with ExitStack() as undo:
            # Another attempt finds the map as it was, and the log of an interrupted process.
            undo.callback(store.abandon if self._misses else store.close)
            self._kept = LogKeeper(store.path, parts) if memory.keep_log else None
            folder = None if self._kept is None else self._kept.folder
            self._log = InputLog(store.path, parts, store.file.base, self._misses, folder)
            undo.callback(self._log.close, remove=not self._misses)
            with self._lock:
                self._restore(store, parts, configuration)
            undo.pop_all()
        self._cuts = node.create_publisher(Int64, CUT, LATCHED)
        self._subscription = node.create_subscription(Int64, CUT, self._on_cut, LATCHED)
        self.store, self._has_caught_up, self._known_ns = store, False, None

    def _restore(self, store: MapStore, parts: tuple[str, ...], configuration: str) -> None:
        file, saved = store.file, store.file.restored
        self.is_resumed = self._log.is_known and not self._log.is_fresh
        """Whether the restored state contains the inputs and settings of the same session."""
        self._saved, self._passed = -1 if file.number is None else file.number, 0
        self._asked = -1
        """Number by which the first process of a split was asked for a later cut."""
        self._common: int | None = -1
        """Newest cut of all nodes when this one wrote its last cut; -1 before the first."""
        self._common_s = self._unsaved_s = self._written_s = 0.0
        """When it changed, the time from then until the last cut, and when that was written."""
        self.has_changed = False
        """Whether the state has changed since it was saved."""
        self.grid, self._since_ns = CutGrid(), 0
        cut: Cut | None = None
        states: dict[str, State] = {}
        if saved is not None and saved.cut is not None and set(parts) & set(saved.states):
            states = {part: saved.states[part] for part in parts if part in saved.states}
            cut, self._since_ns = saved.cut, saved.cut.stamp_ns
            self.grid.restore(cut)
        beginning = Beginning(
            parts, configuration, VERSION, None if cut is None else cut.stamp_ns,
            not (self.is_resumed or (file.joins and file.number is not None)),
            self.is_resumed, self._log.was_interrupted,
            [command_state(one) for one in map(_in_effect, self.live.settings.values())
             if isinstance(one, UseOdometry | SetPaused)],
            tuple(filter(None, map(own_class, self.live.pipeline.stages.values()))),
            self._chain,
        )
        self.live.begin(beginning, states, kept_folder(store.path, parts[0]))
        for node in self._nodes:
            if node.SECTION in states:
                if self._misses:
                    node.send_again()
                if not file.joins:
                    node.drop_tasks()
        if self._kept is not None:
            begins = self._kept.begin(self._log.first, beginning, states)
            verb = 'begins' if begins else 'goes on'
            self._nodes[0].get_logger().info(
                f'the log that is kept {verb} in {self._kept.folder}'
            )

    def _localise_in(self, path: Path) -> None:
        """Restore the stages from a map file that stays unchanged, and stop learning."""
        saved = read_map(path)
        with self._lock:
            for node in self._nodes:
                if node.SECTION in saved.states:
                    self.live.replace(node.SECTION, saved.states[node.SECTION])
                    node.drop_tasks()
            self.live.command(NewSession())
            for node in self._nodes:
                self.live.command(SetMapping(False, node.SECTION))

    # Interruptions

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
        store = self.store
        if store is not None and not self._log.is_known:
            notes = store.file.notes
            if store.file.is_interrupted and not notes:
                notes = [
                    'this node was interrupted, and has no log of what it had received: messages '
                    f'after {self._since_ns * 1e-9:.3f} s may be lost'
                ]
            for note in notes:
                self._nodes[0].diagnostics.note(note)
        if store is None or not self._misses:
            self.replay()
            self._follow()
        else:
            # It takes a second at least, in which subscribers of the results are connected.
            self.recovery.begin(self._deliver)

    def _deliver(self) -> None:
        with self._lock:
            self.recovery.deliver(self.replay(), self._history_floor_ns)
            self._follow()

    def _history_floor_ns(self, stream: str) -> int:
        """Return the stamp up to which the history of a stream is known."""
        newest_ns = self._newest_ns(stream)
        if newest_ns is not None and self._log.is_known:
            return newest_ns
        return max(newest_ns or -1, self._since_ns)

    def replay(self) -> Mapping[str, list[int]]:
        """Receive what came after the restored state, once; return its stamps by stream.

        Call it before anything else changes the state.
        """
        with self._lock:
            if self.store is not None and self._known_ns is None:
                self._known_ns = {
                    stream: [stamp_ns] for stream in self.recovery.inputs
                    if (stamp_ns := self._newest_ns(stream)) is not None
                }
                if self._log.is_known:
                    self._receive_log(self._known_ns)
                self.live.begin_run()
            return self._known_ns or {}

    def _receive_log(self, known_ns: dict[str, list[int]]) -> None:
        entries, self._log.entries = self._log.entries, []
        self._log.append(ATTEMPT, 0, b'')
        received = [entry for entry in entries if entry.stream != ATTEMPT]
        entries = [*used([*entries, Entry(ATTEMPT, 0, b'')])]
        if received and entries[-1:] != received[-1:]:
            last = received[-1]
            self._nodes[0].diagnostics.note(
                f'a message of {last.stream} with stamp {last.stamp_ns * 1e-9:.3f} s is lost: it '
                f'is left out, as this process has ended {MOST_ATTEMPTS} times when it was '
                'received'
            )
        self.is_replaying = True
        try:
            self.live.pipeline.go_on()
            for entry in entries:
                if entry.stream in self.recovery.inputs:
                    known_ns.setdefault(entry.stream, []).append(entry.stamp_ns)
                self.live.receive(entry)
        finally:
            self.is_replaying = False
        for publisher, message in self._unsent.items():
            publisher.publish(message)
        self._unsent.clear()
        self._nodes[0].get_logger().info(
            f'continued from the map at {self._since_ns * 1e-9:.3f} s with {len(entries)} '
            'messages since then'
        )
        self.configure()

    def _newest_ns(self, stream: str) -> int | None:
        """Return the newest accepted stamp of an input, None if there is none."""
        pipeline = self.live.pipeline
        return pipeline.order.newest_of(stream) if stream in pipeline.inputs else None

    # What is received

    def log(self, stream: str, stamp_ns: int, data: Callable[[], bytes]) -> None:
        """Log what the process receives, before it uses it."""
        if self.store is not None:
            self.has_changed = True
            if not self.is_replaying:
                self._log.append(stream, stamp_ns, data())

    def replaced(self, part: str, state: State) -> None:
        """Note that the memory of a part was replaced, which does not follow from the log."""
        if self.store is None:
            return
        self.has_changed = True
        if self._kept is None:
            self._log.forget()
        elif not self.is_replaying:
            self._log.append(REPLACED, 0, self._kept.loaded(self._log.number, part, state))

    def obeyed(self, stamp_ns: int, command: Command) -> None:
        """Save soon what a command has changed, which is no message."""
        if self.store is None:
            return
        if not isinstance(command, NewSession):
            self.grid.note(stamp_ns)
            self.has_changed = True
        elif stamp_ns <= self._since_ns:
            self.grid.start_run()  # the session may precede the restored state

    def configure(self) -> None:
        """Save the present parameters with the next state."""
        if self.store is not None:
            self.store.file.configure(own_yaml(*self._nodes))
            self.has_changed = True

    # Saving

    def pause(self) -> None:
        """Save the state, and report what is lost, as no further messages arrive at present.

        In a split, the first process alone begins a cut, which is later than all others, and the
        others save their states where they meet it in the stream: so they have got what was passed
        on before it. For what a service has changed in one of them, it asks for such a cut.
        """
        self.recovery.pause()
        if self.store is None:
            return
        self._log.begin_again()
        chain, newest = self._chain, max(self._saved, self._passed)
        if not (chain.follows or chain.is_followed):
            self._save()
        elif not chain.follows:
            if self.has_changed or newest > self._saved:
                self._cut_now(newest + 1)
        elif self.has_changed and self._asked <= self._saved:
            self._asked = newest + 1
            self._cuts.publish(Int64(data=self._asked))

    def save(self) -> None:
        """Save the present state."""
        with self._lock:
            self.replay()
            self._save()

    def _save(self) -> None:
        """Save the state; if nothing has changed, it is that of the newest cut of others, too."""
        if self.store is not None:
            self._cut_now(max(self._saved + 1 if self.has_changed else 0, self._passed))

    def _cut_now(self, least: int) -> None:
        cut = self.grid.now(least)
        if cut is not None and cut.number > self._saved:
            self._cut(cut)

    def write(self, cut: Cut) -> None:
        """Save the state, unless a later cut was saved before messages that came late."""
        if self.store is None or self.is_replaying or cut.number <= self._saved:
            return
        file = self.store.file
        common = file.common
        with self._nodes[0].diagnostics.times('map_file'):
            self.store.cut(cut, self.live.states())
        self._log.cut(file.base_of(cut.number))
        if common is not None:
            self._log.forget_before(file.base_of(common))
        self._saved, self.has_changed = cut.number, False
        now_s = time.monotonic()
        # During a pause nothing is saved, and nothing is unsaved.
        if self._common != common or now_s - self._written_s > MOST_UNSAVED_S:
            self._common, self._common_s = common, now_s
        self._written_s = now_s
        self._unsaved_s = now_s - self._common_s
        self._cuts.publish(Int64(data=cut.number))

    def _on_cut(self, message: Int64) -> None:
        """Note the newest cut of all nodes; outside a split, one without inputs saves it too."""
        if 0 <= message.data < MAX_CUT:
            self._passed = max(self._passed, message.data)
            self.grid.join_run(message.data)

    def close(self) -> None:
        """Process the messages that are still held, save the last state, and close the file.

        Messages are dropped that processes behind this one could not receive any more.
        """
        with self._lock:
            self.recovery.close()
            self.replay()
            if not self.live.run:
                self.live.pipeline.finish()
            if self.store is None:
                return
            self._save()
            store, self.store = self.store, None
            is_saved = store.flush(CLOSE_TIMEOUT_S)
            node = self._nodes[0]
            if not is_saved:
                node.get_logger().error(
                    f'the last seconds of the map could not be saved: {store.problem}'
                )
            self._log.close(remove=is_saved)
            store.close()
            node.destroy_subscription(self._subscription)
            node.destroy_publisher(self._cuts)

    def diagnostic_values(self) -> dict[str, Any]:
        """Return the values for the diagnostics."""
        store, diagnostics = self.store, self._nodes[0].diagnostics
        if store is None:
            return {}
        diagnostics.error = store.problem
        if self._kept is not None and self._log.failed and not store.problem:
            diagnostics.error = (
                'the log that is to be kept is incomplete: the disk refused a part of it, and it '
                'ends there; free some space, and restart all nodes to begin another'
            )
        if not store.problem and self._unsaved_s > MOST_UNSAVED_S:
            diagnostics.error = (
                f'the map has not been saved for {self._unsaved_s:.0f} s: a node that maps too '
                'does not save, or its states do not fit; restart all nodes if this persists'
            )
            diagnostics.warn(diagnostics.error)
        saved, last_ns = store.acknowledged, self.grid.last_ns
        age_s = None if saved is None or last_ns is None else (last_ns - saved.stamp_ns) * 1e-9
        return {
            'map_saved_ns': -1 if saved is None else saved.stamp_ns,
            'map_unsaved_s': 'nothing saved' if age_s is None else round(max(age_s, 0.0), 2),
            'map_state': 'catching up' if self.recovery.is_catching_up else 'saving',
        }


def own_yaml(*nodes: HostedNode) -> str:
    """Return the parameters of some nodes of a process as YAML."""
    sections = [section for node in nodes for section in node.sections]
    return to_yaml(given_config(nodes), sections)


def given_config(nodes: Sequence[HostedNode]) -> Config:
    """Return a configuration with the sections of all nodes of a process."""
    return replace(nodes[0].config, **{
        section: getattr(node.config, section) for node in nodes for section in node.sections
    })


def _in_effect(setting: Command) -> Command:
    """Return the setting with which the first input is processed.

    Managed nodes are paused when the file is opened. Their activation is not logged, because each
    start of the process repeats it.
    """
    return SetPaused(False, setting.stage) if isinstance(setting, SetPaused) else setting
