# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node's part of a map file: saved while mapping, restored when the node starts.

The node writes its state at points of a grid of stamps (cut_grid.py), so that the states of all
nodes belong together. It logs the messages that its neighbours need if they are restarted, and
continues from its last state when it is restarted itself (resuming.py).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Int64, String

from ratslam_ros.core.common.scan import scan_stream
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config.experience_map import MAX_LASERS
from ratslam_ros.maps import Cut, MapStore
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.resending import (
    RESEND,
    RESENT,
    ResendAnswer,
    ResendRequest,
)
from ratslam_ros.ros.decoded import decoded
from ratslam_ros.ros.diagnostics import Diagnostics
from ratslam_ros.ros.qos import GOAL
from ratslam_ros.ros.restart.continuity import Continuity
from ratslam_ros.ros.restart.cut_grid import CutGrid, GridCut, Repetitions
from ratslam_ros.ros.restart.resuming import Missed, Resuming, Wanted
from ratslam_ros.starting import starting

CUT = 'ratslam/cut'
"""Topic with the number of each cut that a node saves."""

MAX_CUT = 2**62
"""Limit of accepted numbers of cuts."""

UPDATE_PERIOD_S = 0.05
"""Period of the checks whether a restarted node has received what it missed."""

FLUSH_TIMEOUT_S = 1.0
"""Longest time for which a neighbour waits for its log to be written."""

CLOSE_TIMEOUT_S = 3.0
"""Longest time for the last write: SIGKILL may follow five seconds after SIGTERM."""

RESUME_TIMEOUT_S = 20.0
"""Longest time for which a node waits for a neighbour to catch up."""

MOST_UNSAVED_S = 5.0
"""Longest time of mapping for which the newest cut of all nodes may stay the same."""

RECENT_NS = 30_000_000_000
"""Messages this much older than the restored state may still be repeated by neighbours that were
restarted too; still older ones belong to a recording that has been started again."""


REGULAR = 'odometry', *map(scan_stream, range(MAX_LASERS))
"""Streams of which lost messages are recognised by their stamps; see ``Continuity``."""


@dataclass(frozen=True)
class KeptInput:
    """An input of the node.

    stream: its name. topics: message type by topic. receive: takes a message of the past. replay:
    takes a logged message, None if the stream is not logged.
    """

    stream: str
    topics: Mapping[str, type]
    receive: Callable[[Any], None]
    replay: Callable[[bytes], None] | None = None


class MapKeeper:
    """Saves the state of a node in a map file, and lets the node continue from it."""

    def __init__(
        self, node: Node, diagnostics: Diagnostics, store: MapStore, parts: tuple[str, ...],
        states: Callable[[], dict[str, State]], newest_ns: Callable[[str], int],
        restarted: Callable[[tuple[str, ...]], None] = lambda streams: None,
    ) -> None:  # fmt: skip
        """Restore nothing yet: ``restored`` is the state to restore.

        Args:
            node: the node.
            diagnostics: where lost messages are reported.
            store: the opened file.
            parts: names of its parts that this process writes.
            states: returns the state of each part.
            newest_ns: returns the newest received stamp of a stream.
            restarted: is called with the streams that a restarted neighbour will send again.
        """
        self._node, self._diagnostics, self._store = node, diagnostics, store
        self._refuse = diagnostics.refuse
        self._states, self._newest_ns, self._restarted = states, newest_ns, restarted
        self._grid = CutGrid()
        self._repetitions = Repetitions()
        self._requests: dict[str, ResendRequest] = {}
        self._resuming: Resuming | None = None
        self._neighbours_until_s: dict[str, float] = {}
        self._busy_s = time.monotonic()
        self._common: int | None = -1
        """Newest cut of all nodes when this one wrote its last cut; -1 before the first."""
        self._common_s = self._unsaved_s = 0.0
        """When it changed, and the time from then until the last cut."""
        self._lost_after_ns: int | None = None
        self._continuity: dict[str, Continuity] = {}
        self._reached: dict[str, int] = {}
        """Stamp of the last message of each stream that has left the stamp order."""
        self._restored: dict[str, int] = {}
        """The same at the restored state. Some streams may lag behind its stamp: a node processes
        what it holds if nothing comes any more. What comes later is late, also after a restart."""
        self._is_first = True
        """Whether the first message may belong to another session than the restored state."""
        self._has_changed = False
        self.restored: Mapping[str, State] | None = None
        """The states of the parts to restore; None for a new map."""
        self._cut: GridCut | None = None
        saved = store.restored
        if saved is not None and saved.cut is not None and set(parts) & set(saved.states):
            self.restored = {part: saved.states[part] for part in parts if part in saved.states}
            if store.joins:
                self._restored = _stamps(next(iter(self.restored.values())).get('reached'))
            self._reached = dict(self._restored)
            self._cut = GridCut(saved.cut.number, saved.cut.stamp_ns)
            self._grid.restore(self._cut)
            is_own = store.joins and saved.sessions[-1].base_ns != self._cut.stamp_ns
            self._is_first = not is_own
        self._saved, self._passed = -1 if store.number is None else store.number, 0
        self._cuts = node.create_publisher(Int64, CUT, GOAL)
        self._answers = node.create_publisher(String, RESENT, GOAL)
        self._subscriptions = [
            node.create_subscription(Int64, CUT, self._on_cut, GOAL),
            node.create_subscription(String, RESEND, self._on_request, GOAL),
        ]

    # Saving

    def before(self, stamp_ns: int) -> None:
        """Save the state if it is due before a message with this stamp."""
        cut = self._grid.before(stamp_ns)
        # A pause may have used the number of this point already, as messages came late: then the
        # next pause or point of the grid writes the state.
        if cut is not None and cut.number > self._saved:
            self._write(cut)
        self._has_changed = True

    def reach(self, stream: str, stamp_ns: int) -> None:
        """Note that a message is the next one in the order of stamps."""
        self._reached[stream] = stamp_ns

    def changed(self, stamp_ns: int) -> None:
        """Save the state soon: it was changed by a command at this stamp and not by a message."""
        self._grid.note(stamp_ns)
        self._has_changed = True

    def pause(self) -> None:
        """Save the state after all messages, as no further ones arrive at present."""
        if self._resuming is not None:
            return
        if self._lost_after_ns is not None:
            # The source may have ended meanwhile: then no image follows that ends the span.
            self._diagnostics.note(
                f'images after {self._lost_after_ns * 1e-9:.3f} s may be lost: this node was '
                'restarted, and their source does not send them again'
            )
        for stream in [*self._continuity]:
            self._judge(stream)
        least = self._saved + 1 if self._has_changed else 0
        cut = self._grid.now(max(least, self._passed))
        if cut is not None and cut.number > self._saved:
            self._write(cut)
            self._has_changed = False

    def start_run(self) -> None:
        """Expect stamps that are earlier than the last ones."""
        self._grid.start_run()

    def close(self) -> None:
        """Save the last state, and close the file."""
        self.pause()
        if not self._store.flush(CLOSE_TIMEOUT_S):
            self._node.get_logger().error(
                f'the last seconds of the map could not be saved: {self._store.problem}'
            )
        self._store.close()
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        for publisher in (self._cuts, self._answers):
            self._node.destroy_publisher(publisher)

    def _write(self, cut: GridCut) -> None:
        with self._diagnostics.times('map_file'):
            states = {
                part: {**state, 'reached': dict(self._reached)}
                for part, state in self._states().items()
            }
            self._store.cut(Cut(cut.number, cut.stamp_ns), states)
        self._saved = cut.number
        now_s = time.monotonic()
        if self._common != self._store.common:
            self._common, self._common_s = self._store.common, now_s
        self._unsaved_s = now_s - self._common_s
        self._cuts.publish(Int64(data=cut.number))

    def log(self, stream: str, stamp_ns: int, data: bytes) -> None:
        """Log a message that a restarted node may need."""
        self._store.log(stream, stamp_ns, data)

    def configure(self, configuration: str) -> None:
        """Record with the next cut that these sections of parameters have other values."""
        self._store.configure(configuration)
        self._has_changed = True

    def diagnostic_values(self) -> dict[str, Any]:
        """Return the values for the diagnostics."""
        saved = self._store.acknowledged
        self._diagnostics.error = self._store.problem
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
            'map_state': 'catching up' if self._resuming is not None else 'saving',
        }

    # Restart

    @property
    def joins(self) -> bool:
        """Whether the node continues the session of the file, as after a restart."""
        return self._store.joins and self._cut is not None

    @property
    def since_ns(self) -> int:
        """Stamp up to which the restored state has processed the messages, 0 if there is none."""
        return 0 if self._cut is None else self._cut.stamp_ns

    def is_other_session(self, stamp_ns: int, max_gap_ns: int) -> bool:
        """Return, for the first message, whether it does not follow the restored state."""
        is_first, self._is_first = self._is_first, False
        if not is_first or self._cut is None:
            return False
        if stamp_ns <= self._cut.stamp_ns:
            self._grid.start_run()
        return not 0 < stamp_ns - self._cut.stamp_ns <= max_gap_ns

    def is_repeated(self, stream: str, stamp_ns: int) -> bool:
        """Return whether a restarted neighbour sends this message for the second time."""
        if stream == 'image' and self._lost_after_ns is not None:
            self._report_lost(stamp_ns)
        if self._repetitions.contains(stream, stamp_ns):
            if self._restored.get(stream, stamp_ns) < stamp_ns <= self.since_ns:
                self._diagnostics.drop(
                    'late', f'a message of {stream} with stamp {stamp_ns * 1e-9:.3f} s came too '
                    'late: later ones had been processed before this node was restarted',
                )  # fmt: skip
            return True
        if stream in self._continuity and self._continuity[stream].add(stamp_ns):
            self._judge(stream)
        return False

    def settled_s(self) -> float:
        """Return the time for which no node has been restarting, in s of a steady clock.

        While one is, silent inputs do not mean that nothing will come any more.
        """
        now_s = time.monotonic()
        resuming = any(now_s < end_s for end_s in self._neighbours_until_s.values())
        if resuming or self._resuming is not None or starting():
            self._busy_s = now_s
        return now_s - self._busy_s

    def takes(self, stream: str, message: Any, receive: Callable[[Any], None]) -> bool:
        """Return whether a message can be processed now; keep it for later otherwise."""
        if self._resuming is None:
            return True
        self._resuming.keep(stream, message, receive)
        return False

    def resume(
        self, inputs: list[KeptInput], repeats: tuple[str, ...], lock: threading.RLock,
        caught_up: Callable[[bool], None],
    ) -> None:  # fmt: skip
        """Collect what the node missed, and deliver it when it has arrived.

        Args:
            inputs: inputs of the node.
            repeats: streams that the node will send again.
            lock: held while messages are delivered.
            caught_up: called before they are delivered, with whether images are lost.
        """
        since_ns = 0 if self._cut is None else self._cut.stamp_ns
        if self._cut is not None and self._store.joins:
            for one in inputs:
                self._repetitions.expect(one.stream, since_ns - RECENT_NS, since_ns)
        wanted = {
            topic: Wanted(one.stream, kind, self._after_ns(one), one.receive)
            for one in inputs for topic, kind in one.topics.items()
        }  # fmt: skip
        self._resuming = Resuming(
            self._node, wanted, repeats, since_ns, self._refuse
        )

        def update() -> None:
            assert self._resuming is not None
            if self._resuming.update():
                timer.cancel()
                with lock:
                    self._finish(inputs, since_ns, caught_up)

        steady = Clock(clock_type=ClockType.STEADY_TIME)
        timer = self._node.create_timer(UPDATE_PERIOD_S, update, clock=steady)

    def logged(self, stream: str, after_ns: int = -1) -> list[tuple[int, bytes]]:
        """Return the logged messages of a stream with later stamps."""
        return self._store.logged(stream, after_ns)

    def _finish(
        self, inputs: list[KeptInput], since_ns: int, caught_up: Callable[[bool], None]
    ) -> None:
        resuming, self._resuming = self._resuming, None
        assert resuming is not None
        has_images = any(one.stream == 'image' for one in inputs)
        are_lost = self._store.joins and has_images and not resuming.is_complete
        if are_lost:
            self._lost_after_ns = since_ns
        if not self._store.joins and has_images and not resuming.is_complete:
            # All nodes were killed, no source sends it again.
            for note in filter(None, (*self._store.notes, self._store.may_lack)):
                self._diagnostics.note(note)
        missed = [
            Missed(stamp_ns, one.stream, partial(one.replay, data))
            for one in inputs if one.replay is not None
            for stamp_ns, data in self.logged(one.stream, self._after_ns(one))
        ] + resuming.missed  # fmt: skip
        caught_up(are_lost)
        done: set[tuple[str, int]] = set()
        for one in sorted(missed, key=lambda item: item.stamp_ns):
            if one.stamp_ns == 0 or (one.stream, one.stamp_ns) not in done:
                done.add((one.stream, one.stamp_ns))
                one.deliver()
        if self._store.joins:
            self._continuity = self._continuities(done, resuming.is_complete)
        resuming.close()
        for request in self._requests.values():
            self._expect(request)
        if self.restored is not None:
            self._node.get_logger().info(
                f'continued from the map at {since_ns * 1e-9:.3f} s with {len(done)} messages '
                'since then'
            )

    def _continuities(
        self, recovered: Set[tuple[str, int]], is_complete: bool
    ) -> dict[str, Continuity]:
        """Return what is known of each regular stream: of a complete one, the last stamp."""
        known = {stream: [after_ns] for stream, after_ns in self._restored.items()}
        for stream, stamp_ns in recovered:
            known.setdefault(stream, []).append(stamp_ns)
        if is_complete:
            return {
                stream: Continuity([max(known[stream])], True)
                for stream in (*REGULAR, 'image') if stream in known
            }  # fmt: skip
        # Images are lost in any case.
        return {stream: Continuity(known[stream]) for stream in REGULAR if stream in known}

    def _judge(self, stream: str) -> None:
        """Report what is lost of a stream, as messages have arrived since, or none do."""
        continuity = self._continuity.pop(stream)
        lost = continuity.lost()
        if lost is not None:
            self._diagnostics.counts['lost_spans'] += 1
            self._diagnostics.note(
                f'{stream} from {lost[0] * 1e-9:.3f} s to {lost[1] * 1e-9:.3f} s is lost: this '
                'node was restarted, and its source does not send it again'
            )
        elif not continuity.has_new and not continuity.is_complete:
            self._diagnostics.note(
                f'{stream} after {continuity.last_ns * 1e-9:.3f} s may be lost: this node was '
                'restarted, and its source does not send it again'
            )

    def _after_ns(self, one: KeptInput) -> int:
        """Return the stamp of the last message of an input in the restored state."""
        return min(self._restored.get(one.stream, self.since_ns), self.since_ns)

    def _report_lost(self, stamp_ns: int) -> None:
        after_ns, self._lost_after_ns = self._lost_after_ns, None
        assert after_ns is not None
        self._diagnostics.counts['lost_spans'] += 1
        self._diagnostics.note(
            f'images from {after_ns * 1e-9:.3f} s to {stamp_ns * 1e-9:.3f} s are lost: this node '
            'was restarted, and their source does not send them again'
        )

    # Neighbours

    def _on_cut(self, message: Int64) -> None:
        """Note the newest cut of all nodes: one without inputs has the same state there."""
        if 0 <= message.data < MAX_CUT:
            self._passed = max(self._passed, message.data)

    @decoded(ResendRequest, RESEND)
    def _on_request(self, request: ResendRequest) -> None:
        if request.node == self._node.get_name():
            return
        if request.done:
            self._neighbours_until_s.pop(request.node, None)
            return
        self._neighbours_until_s[request.node] = time.monotonic() + RESUME_TIMEOUT_S
        is_new = self._requests.get(request.node) != request
        self._requests[request.node] = request
        if is_new:
            self._restarted(request.repeats)
            self._expect(request)
            self._store.flush(FLUSH_TIMEOUT_S)
        answer = ResendAnswer(request.number, self._node.get_name())
        self._answers.publish(String(data=encode(answer)))

    def _expect(self, request: ResendRequest) -> None:
        for stream in request.repeats:
            self._repetitions.expect(stream, request.since_ns, self._newest_ns(stream))


def _stamps(saved: Any) -> dict[str, int]:
    """Return the stamps of a state, which may be of another version."""
    if not isinstance(saved, dict):
        return {}
    return {stream: int(ns) for stream, ns in saved.items() if isinstance(ns, int)}
