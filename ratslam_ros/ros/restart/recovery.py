# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a process with a map file does about interruptions, its own and those of its neighbours.

After its own, it gets what was sent meanwhile (catch_up.py), and reports what is lost. While a
neighbour is restarted, other inputs wait longer than usual, so that what comes again is not late.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import String

from ratslam_ros.core.common.scan import scan_stream
from ratslam_ros.core.config.experience_map import MAX_LASERS
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.restarts import Restart
from ratslam_ros.pipeline.continuity import Continuity
from ratslam_ros.ros.decoded import decoded
from ratslam_ros.ros.diagnostics import Diagnostics
from ratslam_ros.ros.qos import GOAL
from ratslam_ros.ros.restart.catch_up import MOST_S, CatchUp, Missed
from ratslam_ros.ros.restart.restarting import Restarting
from ratslam_ros.starting import starting

REGULAR = frozenset({'odometry', 'image', *map(scan_stream, range(MAX_LASERS))})
"""Streams of which lost messages are recognised by their stamps; see ``Continuity``."""

UPDATE_PERIOD_S = 0.05
"""Period of the checks whether a restarted process has received what it missed."""

ANNOUNCEMENT_PERIOD_S = 0.25
"""Period at which a restart is announced."""

NEIGHBOURS = frozenset(
    {'visual_odometry', 'local_view', 'pose_cells', 'experience_map', 'landmark_map'}
)
"""Nodes with a part of the map file."""

STARTING_PERIOD_S = 0.02
"""Shortest time between two checks whether a process is starting on this machine."""

SETTLING_S = 1.0
"""Time after the end of a restart in which the messages that were missing arrive."""


class Recovery:
    """Catching up after an interruption, and patience with neighbours that do."""

    def __init__(
        self, node: Node, names: Collection[str], diagnostics: Diagnostics,
        newest_ns: Callable[[str], int | None],
    ) -> None:  # fmt: skip
        """Listen to neighbours.

        Args:
            node: the first node of the process.
            names: names of all its nodes.
            diagnostics: where lost messages are reported.
            newest_ns: returns the newest accepted stamp of an input, None if there is none.
        """
        self._node, self._names, self._diagnostics = node, tuple(names), diagnostics
        self._newest_ns = newest_ns
        self._refuse = diagnostics.refuse
        self._catch_up: CatchUp | None = None
        self._continuity: dict[str, Continuity] = {}
        self._neighbours = Restarting()
        self._heard: set[str] = set()
        """Neighbours that have heard of the own restart."""
        self._busy_s = time.monotonic()
        self._repeated_s = -SETTLING_S
        self._check_s = 0.0
        self._end: Callable[[], None] | None = None
        """Ends the present catch-up at once."""
        self._announcements = node.create_publisher(String, Restart.TOPIC, GOAL)
        self._subscription = node.create_subscription(
            String, Restart.TOPIC, self._on_restart, GOAL
        )

    def close(self) -> None:
        """End; what was collected is received."""
        if self._end is not None:
            self._end()
        self._node.destroy_subscription(self._subscription)
        self._node.destroy_publisher(self._announcements)

    # Own interruption

    @property
    def is_catching_up(self) -> bool:
        """Whether messages that were sent during an interruption are being received."""
        return self._catch_up is not None

    def begin(
        self, missed: Mapping[str, Missed], is_interrupted: bool, lock: threading.RLock,
        replay: Callable[[], Mapping[str, list[int]]],
        floor_ns: Callable[[str], int | None],
    ) -> None:  # fmt: skip
        """Get what was sent during an interruption.

        Args:
            missed: the inputs.
            is_interrupted: whether there was one, as far as the process knows.
            lock: held while messages are received.
            replay: is called before that, to receive what was received before the interruption;
                returns the stamps of these messages by stream.
            floor_ns: returns, after that, the stamp of a stream up to which its history is known;
                None if it is not wanted.
        """
        self._catch_up = catch_up = CatchUp(self._node, missed, is_interrupted, self._lost)
        start_s = next_s = time.monotonic()

        def update() -> None:
            nonlocal next_s
            now_s = time.monotonic()
            if now_s >= next_s:  # a neighbour may not be connected yet
                next_s = now_s + ANNOUNCEMENT_PERIOD_S
                self._announce()
            is_heard = self._unheard() <= self._heard or now_s - start_s >= MOST_S
            if is_heard and catch_up.is_done():
                end()

        def end() -> None:
            timer.cancel()
            with lock:
                known_ns = replay()
                self._finish(catch_up, known_ns, missed if is_interrupted else (), floor_ns)

        self._end = end
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        timer = self._node.create_timer(UPDATE_PERIOD_S, update, clock=steady)

    def _finish(
        self, catch_up: CatchUp, known_ns: Mapping[str, list[int]], missed: Iterable[str],
        floor_ns: Callable[[str], int | None],
    ) -> None:  # fmt: skip
        self._catch_up = self._end = None
        self._busy_s = self._repeated_s = time.monotonic()
        catch_up.close()
        self._continuity = {
            stream: Continuity(list(stamps)) for stream, stamps in known_ns.items()
            if stream in REGULAR and stamps and not catch_up.is_complete(stream, stamps[-1])
        }  # fmt: skip
        for stream in missed:
            if stream in REGULAR and stream not in known_ns and not catch_up.has_history(stream):
                self._diagnostics.note(
                    f'the first messages of {stream} may be lost: this node was restarted before '
                    'it had received any'
                )
        catch_up.deliver(floor_ns)
        self._announce(done=True)

    def _announce(self, done: bool = False, heard: bool = False) -> None:
        restart = Restart(self._names, done, heard)
        self._announcements.publish(String(data=encode(restart)))

    def _unheard(self) -> set[str]:
        """Return the visible nodes with a map file that other processes have."""
        names = {
            name for name, space in self._node.get_node_names_and_namespaces()
            if space == self._node.get_namespace()
        }
        return (names & NEIGHBOURS) - set(self._names)

    def _lost(self, event: Any) -> None:
        self._diagnostics.drop(
            'lost', f'{event.total_count_change} messages of a history were lost in transport',
            event.total_count_change,
        )  # fmt: skip

    def takes(self, stream: str, message: object) -> bool:
        """Return whether a message can be processed now; keep it for later otherwise."""
        if self._catch_up is None:
            return True
        if not self._catch_up.keep(stream, message):
            self._diagnostics.drop(
                'lost', f'a message of {stream} is lost: more arrived than can be kept while this '
                'node is restarted',
            )  # fmt: skip
        return False

    def accepts(self, stream: str, stamp_ns: int) -> bool:
        """Return whether a message is new, and not repeated by a restarted neighbour."""
        newest_ns = self._newest_ns(stream)
        if newest_ns is not None and stamp_ns <= newest_ns and self._is_repeating():
            self._diagnostics.counts['repeated'] += 1
            return False
        if stream in self._continuity and self._continuity[stream].add(stamp_ns):
            self._judge(stream)
        return True

    def pause(self) -> None:
        """Report what is lost, as no further messages arrive at present."""
        for stream, continuity in [*self._continuity.items()]:
            if continuity.lost() or not continuity.has_new:  # otherwise too few have arrived
                self._judge(stream)

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
        elif not continuity.has_new:
            self._diagnostics.note(
                f'{stream} after {continuity.last_ns * 1e-9:.3f} s may be lost: this node was '
                'restarted, and its source does not send it again'
            )

    # Neighbours

    @decoded(Restart)
    def _on_restart(self, restart: Restart) -> None:
        if set(restart.nodes) & set(self._names):
            return
        self._neighbours.note(restart)
        if restart.heard:
            self._heard.update(restart.nodes)
            return
        self._busy_s = self._repeated_s = time.monotonic()
        if not restart.done:
            self._announce(heard=True)

    def _is_repeating(self) -> bool:
        """Return whether a neighbour may send again what it sent before an interruption."""
        now_s = time.monotonic()
        if self._neighbours:
            self._repeated_s = now_s
        return now_s - self._repeated_s < SETTLING_S

    def is_settling(self) -> bool:
        """Return whether inputs have to wait longer: a node is restarting, or has just done so."""
        now_s = time.monotonic()
        if now_s >= self._check_s:
            self._check_s = now_s + STARTING_PERIOD_S
            if self._neighbours or starting():
                self._busy_s = now_s
        return now_s - self._busy_s < SETTLING_S

    @property
    def settled_s(self) -> float:
        """Time for which no node has been restarting, in s of a steady clock.

        While one is, silent inputs do not mean that nothing will come any more.
        """
        return time.monotonic() - self._busy_s
