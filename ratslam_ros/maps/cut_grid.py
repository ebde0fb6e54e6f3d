# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Moments, in stamps, at which every node writes its part of the map file.

All nodes use the same grid of stamps and process their messages in stamp order. Cut k therefore
holds the effects of exactly the messages with stamps up to k * CUT_PERIOD_NS in the file of every
node, although the nodes do not communicate about it. The processes of a split follow the cuts of
the first one (``LivePipeline.pass_cut``).
"""

from __future__ import annotations

from ratslam_ros.maps.saved_map import Cut

CUT_PERIOD_NS = 2_000_000_000
"""Distance of the cuts. A saved map is at most five seconds old: this, plus the time by which the
streams wait for each other (max_lateness_s, 2 s) and the time of writing."""

NUMBERS_PER_POINT = 64
"""Numbers of cuts for each point of the grid: its own, and those of pauses until the next one.

A pause must not have the number of a point: messages may come late, and another node, which did
not pause, then has another state at this point.
"""

NUMBERS_PER_RUN = 2**40
"""Numbers of cuts for each run of increasing stamps: more than 1,000 years of them."""


def index_of(cut: Cut | None) -> int:
    """Return the first point of the grid that is not before a cut, within its run; or 0.

    Processes without a map file share it.
    """
    return 0 if cut is None else -(-(cut.number % NUMBERS_PER_RUN) // NUMBERS_PER_POINT)


class CutGrid:
    """Detects at which messages a cut is due, and numbers the cuts."""

    def __init__(self) -> None:
        self._run = 0
        self._index: int | None = None
        self.last_ns: int | None = None
        """Stamp of the last message that was processed, None before the first."""

    def restore(self, cut: Cut) -> None:
        """Continue after a cut."""
        self._run, number = divmod(cut.number, NUMBERS_PER_RUN)
        self._index = number // NUMBERS_PER_POINT
        self.last_ns = cut.stamp_ns

    def start_run(self) -> None:
        """Start a run of stamps, which may be earlier than those of the last one."""
        self._run += 1
        self._index = self.last_ns = None

    def join_run(self, number: int) -> None:
        """Continue in the run of another node's cut, if it is later than the own one.

        Stamps may jump back for one node only, such as if its neighbour was restarted without a
        log. The numbers of the others would remain smaller.
        """
        self._run = max(self._run, number // NUMBERS_PER_RUN)

    def note(self, stamp_ns: int) -> None:
        """Note that a command has taken effect at a stamp, after the last message."""
        self.last_ns = max(self.last_ns or 0, stamp_ns) or None

    def before(self, stamp_ns: int) -> Cut | None:
        """Return the cut that is due before a message with a stamp is processed, if any.

        The number is that of the newest point of the grid before the stamp. The state is that of
        all points since the last message, because no message lies between.
        """
        index = (stamp_ns - 1) // CUT_PERIOD_NS
        previous, self.last_ns = self._index, stamp_ns
        if previous is not None and index <= previous:
            return None
        self._index = index
        if previous is None:  # nothing has been processed yet
            return None
        return Cut(self._number(index), index * CUT_PERIOD_NS)

    def _number(self, index: int) -> int:
        return self._run * NUMBERS_PER_RUN + index * NUMBERS_PER_POINT

    def now(self, least: int = 0) -> Cut | None:
        """Return a cut after the last processed message, for pauses and for the end.

        Its number is between those of the last point of the grid and the next one.

        Args:
            least: smallest number, such as that of the newest cut of another node: a node without
                messages has the same state there.
        """
        own = self._run * NUMBERS_PER_RUN
        if self.last_ns is not None:
            own = self._number((self.last_ns - 1) // CUT_PERIOD_NS) + 1
        number = max(own, least)
        if number == 0:
            return None  # nothing has been processed anywhere
        return Cut(number, self.last_ns or 0)
