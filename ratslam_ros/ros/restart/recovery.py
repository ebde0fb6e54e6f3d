# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a process with a map file does after an interruption.

It gets what its sources have sent meanwhile (catch_up.py), and reports what is lost.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ratslam_ros.core.common.scan import scan_stream
from ratslam_ros.core.config.experience_map import MAX_LASERS
from ratslam_ros.pipeline.continuity import Continuity
from ratslam_ros.ros.diagnostics import Diagnostics
from ratslam_ros.ros.restart.catch_up import CatchUp, Missed

REGULAR = frozenset({'odometry', 'image', *map(scan_stream, range(MAX_LASERS))})
"""Streams of which lost messages are recognised by their stamps; see ``Continuity``."""

UPDATE_PERIOD_S = 0.05
"""Period of the checks whether a restarted process has received what it missed."""


class Recovery:
    """Catching up after an interruption."""

    def __init__(self, node: Node, diagnostics: Diagnostics) -> None:
        """Do nothing yet.

        Args:
            node: the first node of the process.
            diagnostics: where lost messages are reported.
        """
        self._node, self._diagnostics = node, diagnostics
        self._catch_up: CatchUp | None = None
        self._continuity: dict[str, Continuity] = {}
        self._end: Callable[[], None] | None = None
        """Ends the present catch-up at once."""

    def close(self) -> None:
        """End; what was collected is received."""
        if self._end is not None:
            self._end()

    @property
    def is_catching_up(self) -> bool:
        """Whether messages that were sent during an interruption are being received."""
        return self._catch_up is not None

    def begin(
        self, missed: Mapping[str, Missed], lock: threading.RLock,
        replay: Callable[[], Mapping[str, list[int]]], floor_ns: Callable[[str], int],
        follow: Callable[[], None],
    ) -> None:  # fmt: skip
        """Get what was sent during an interruption.

        Args:
            missed: the inputs.
            lock: held while messages are received.
            replay: is called before that, to receive what was received before the interruption;
                returns the stamps of these messages by stream.
            floor_ns: returns, after that, the stamp of a stream up to which its history is known.
            follow: is called at last, to follow another process.
        """
        self._catch_up = catch_up = CatchUp(self._node, missed, self._lost)

        def update() -> None:
            if catch_up.is_done():
                end()

        def end() -> None:
            timer.cancel()
            self._catch_up = self._end = None
            catch_up.close()
            with lock:
                self._finish(catch_up, replay(), missed)
                catch_up.deliver(floor_ns)
                follow()

        self._end = end
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        timer = self._node.create_timer(UPDATE_PERIOD_S, update, clock=steady)

    def _finish(
        self, catch_up: CatchUp, known_ns: Mapping[str, list[int]], missed: Iterable[str]
    ) -> None:
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

    def note(self, stream: str, stamp_ns: int) -> None:
        """Note a message that is received."""
        if stream in self._continuity and self._continuity[stream].add(stamp_ns):
            self._judge(stream)

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
