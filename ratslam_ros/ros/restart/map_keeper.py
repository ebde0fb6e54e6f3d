# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process's part of a map file: saved while mapping, restored when the process starts.

The process writes its state at points of a grid of stamps (cut_grid.py), so that the states of all
processes belong together, and logs what it receives in between. After an interruption it restores
the newest cut that all processes have, and receives its log again. So its state is that of the
moment of the interruption, and it passes on again what others may have missed. What was sent
meanwhile comes from the process that it follows, or from histories of the sources (recovery.py).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from std_msgs.msg import Int64

from ratslam_ros.core.common.state import State
from ratslam_ros.maps import Cut, MapStore
from ratslam_ros.maps.cut_grid import CutGrid
from ratslam_ros.maps.input_log import ATTEMPT, MOST_ATTEMPTS, VERSION, Entry, InputLog, used
from ratslam_ros.maps.kept_log import Beginning, LogKeeper
from ratslam_ros.maps.live_pipeline import REPLACED
from ratslam_ros.pipeline.commands import UseOdometry
from ratslam_ros.pipeline.item_states import command_state
from ratslam_ros.pipeline.stage import own_class
from ratslam_ros.ros.diagnostics import Diagnostics
from ratslam_ros.ros.qos import LATCHED
from ratslam_ros.ros.restart.history import CUT

MAX_CUT = 2**62
"""Limit of accepted numbers of cuts."""

CLOSE_TIMEOUT_S = 3.0
"""Longest time for the last write: SIGKILL may follow five seconds after SIGTERM."""

MOST_UNSAVED_S = 5.0
"""Longest time of mapping for which the newest cut of all nodes may stay the same."""


class MapKeeper:
    """Saves the state of a process in a map file, and logs what it receives."""

    def __init__(self, host: Any, store: MapStore) -> None:
        """Restore nothing yet: ``restored`` is the state to restore.

        Args:
            host: the Host of the process.
            store: the opened file.

        Raises:
            UnusableInput: the log is to be kept, and cannot be.
        """
        self._host, self._store = host, store
        self._node = node = host.nodes[0]
        self._diagnostics: Diagnostics = node.diagnostics
        self._parts = parts = tuple(host.pipeline.stages)
        keep_log = node.config.memory.keep_log
        self._kept = LogKeeper(store.path, parts) if keep_log else None
        self._log = InputLog(
            store.path, parts, store.file.base, self.misses,
            None if self._kept is None else self._kept.take,
        )
        self.has_log = self._log.is_known
        """Whether the process knows what it had received after the restored state."""
        self.is_resumed = self.has_log and not self._log.is_fresh
        """Whether the restored state contains the inputs and settings of the same session."""
        self._grid = host.grid = CutGrid()
        self._common: int | None = -1
        """Newest cut of all nodes when this one wrote its last cut; -1 before the first."""
        self._common_s = self._unsaved_s = 0.0
        """When it changed, and the time from then until the last cut."""
        self._has_changed = False
        self.is_replaying = False
        """Whether the log is being received again."""
        self.restored: Mapping[str, State] | None = None
        """The states of the parts to restore; None for a new map."""
        self._cut: Cut | None = None
        saved = store.file.restored
        if saved is not None and saved.cut is not None and set(parts) & set(saved.states):
            self.restored = {part: saved.states[part] for part in parts if part in saved.states}
            self._cut = saved.cut
            self._grid.restore(saved.cut)
        self._saved, self._passed = -1 if store.file.number is None else store.file.number, 0
        self._cuts = node.create_publisher(Int64, CUT, LATCHED)
        self._subscription = node.create_subscription(Int64, CUT, self._on_cut, LATCHED)

    # Saving

    def before(self, cut: Cut | None) -> None:
        """Save the state if a cut is due before the next message."""
        # A pause may have used the number of this point already, as messages came late: then the
        # next pause or point of the grid writes the state.
        if cut is not None and cut.number > self._saved and not self.is_replaying:
            self._write(cut)
        self._has_changed = True

    def changed(self, stamp_ns: int) -> None:
        """Save the state soon: it was changed by a command at this stamp and not by a message."""
        self._grid.note(stamp_ns)
        self._has_changed = True

    def pause(self) -> None:
        """Save the state after all messages, as no further ones arrive at present."""
        least = self._saved + 1 if self._has_changed else 0
        cut = self._grid.now(max(least, self._passed))
        if cut is not None and cut.number > self._saved:
            self._write(cut)
            self._has_changed = False

    def begin_session(self, stamp_ns: int) -> None:
        """Begin a session with the message with a stamp, which may precede the restored state."""
        if stamp_ns <= self.since_ns:
            self._grid.start_run()

    def close(self) -> None:
        """Save the last state, and close the file."""
        self.pause()
        is_saved = self._store.flush(CLOSE_TIMEOUT_S)
        if not is_saved:
            self._node.get_logger().error(
                f'the last seconds of the map could not be saved: {self._store.problem}'
            )
        self._log.close(remove=is_saved)
        self._store.close()
        self._destroy()

    def abandon(self) -> None:
        """Leave the file as it is, after its map could not be used."""
        self._log.close(remove=False)
        self._store.abandon()
        self._destroy()

    def _destroy(self) -> None:
        self._node.destroy_subscription(self._subscription)
        self._node.destroy_publisher(self._cuts)

    def _write(self, cut: Cut) -> None:
        common = self._store.file.common
        with self._diagnostics.times('map_file'):
            self._store.cut(cut, self._host.live.states())
        self._log.cut(self._store.file.base_of(cut.number))
        if common is not None:
            self._log.forget_before(self._store.file.base_of(common))
        self._saved = cut.number
        now_s = time.monotonic()
        if self._common != common:
            self._common, self._common_s = common, now_s
        self._unsaved_s = now_s - self._common_s
        self._cuts.publish(Int64(data=cut.number))

    def _on_cut(self, message: Int64) -> None:
        """Note the newest cut of all nodes: one without inputs has the same state there."""
        if 0 <= message.data < MAX_CUT:
            self._passed = max(self._passed, message.data)
            self._grid.join_run(message.data)

    def log(self, stream: str, stamp_ns: int, data: Callable[[], bytes]) -> None:
        """Log what the process receives, before it uses it."""
        self._has_changed = True
        if not self.is_replaying:
            self._log.append(stream, stamp_ns, data())

    def beginning(self, configuration: str) -> Beginning:
        """Return what the process begins from; ``configuration``: its parameters, as YAML."""
        settings = self._host.live.settings.values()
        return Beginning(
            self._parts, configuration, VERSION,
            None if self._cut is None else self._cut.stamp_ns,
            not (self.is_resumed or (self.joins and self._store.file.number is not None)),
            self.is_resumed, self._log.was_interrupted,
            [command_state(one) for one in settings if isinstance(one, UseOdometry)],
            tuple(filter(None, map(own_class, self._host.pipeline.stages.values()))),
        )

    def keep(self, beginning: Beginning) -> None:
        """Keep the log from here on, or go on with it, if it is to be kept.

        Raises:
            UnusableInput: it cannot be kept.
        """
        if self._kept is None:
            return
        begins = self._kept.begin(self._log.first, beginning, self.restored or {})
        verb = 'begins' if begins else 'goes on'
        self._node.get_logger().info(f'the log that is kept {verb} in {self._kept.folder}')

    def replaced(self, part: str, state: State) -> None:
        """Note that the memory of a part was replaced, which does not follow from the log."""
        self._has_changed = True
        if self._kept is None:
            self._log.forget()
        elif not self.is_replaying:
            self._log.append(REPLACED, 0, self._kept.loaded(self._log.number, part, state))

    def configure(self, configuration: str) -> None:
        """Record with the next cut that these sections of parameters have other values."""
        self._store.file.configure(configuration)
        self._has_changed = True

    def diagnostic_values(self) -> dict[str, Any]:
        """Return the values for the diagnostics."""
        saved = self._store.acknowledged
        self._diagnostics.error = self._store.problem
        if self._kept is not None and self._log.failed and not self._store.problem:
            self._diagnostics.error = (
                'the log that is to be kept is incomplete: the disk refused a part of it, and it '
                'ends there; free some space, and restart all nodes to begin another'
            )
        if not self._store.problem and self._unsaved_s > MOST_UNSAVED_S:
            self._diagnostics.error = (
                f'the map has not been saved for {self._unsaved_s:.0f} s: a node that maps too '
                'does not save, or its states do not fit; restart all nodes if this persists'
            )
            self._diagnostics.warn(self._diagnostics.error)
        last_ns = self._grid.last_ns
        age_s = None if saved is None or last_ns is None else (last_ns - saved.stamp_ns) * 1e-9
        return {
            'map_saved_ns': -1 if saved is None else saved.stamp_ns,
            'map_unsaved_s': 'nothing saved' if age_s is None else round(max(age_s, 0.0), 2),
        }

    # Restart

    @property
    def joins(self) -> bool:
        """Whether others have gone on while this process was interrupted."""
        return self._store.file.joins

    @property
    def misses(self) -> bool:
        """Whether messages were sent while this process, or all of them, did not run."""
        return self._store.file.is_interrupted or self._store.file.joins

    @property
    def since_ns(self) -> int:
        """Stamp of the last message in the restored state, 0 if there is none."""
        return 0 if self._cut is None else self._cut.stamp_ns

    @property
    def notes(self) -> list[str]:
        """What is missing of the map, as the process was interrupted and had no log."""
        if self.has_log:
            return []
        file = self._store.file
        if file.notes or not file.is_interrupted:
            return file.notes
        return [
            'this node was interrupted, and has no log of what it had received: messages '
            f'after {self.since_ns * 1e-9:.3f} s may be lost'
        ]

    def replay(self, go_on: Callable[[], None], take: Callable[[Entry], None]) -> int:
        """Receive again what the process had received after the restored state.

        Args:
            go_on: lets the restored state process what need not wait.
            take: receives each entry.

        Returns:
            The number of entries.
        """
        entries, self._log.entries = self._log.entries, []
        self._log.append(ATTEMPT, 0, b'')
        received = [entry for entry in entries if entry.stream != ATTEMPT]
        entries = [*used([*entries, Entry(ATTEMPT, 0, b'')])]
        if received and entries[-1:] != received[-1:]:
            last = received[-1]
            self._diagnostics.note(
                f'a message of {last.stream} with stamp {last.stamp_ns * 1e-9:.3f} s is lost: it '
                f'is left out, as this process has ended {MOST_ATTEMPTS} times when it was '
                'received'
            )
        self.is_replaying = True
        try:
            go_on()
            for entry in entries:
                take(entry)
        finally:
            self.is_replaying = False
        return len(entries)
