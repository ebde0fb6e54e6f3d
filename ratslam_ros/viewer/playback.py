# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cursor over a run: which moment is shown, and how it moves on."""

from __future__ import annotations

from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.viewer.run_source import RunSource

MAX_ELAPSED_S = 1.0
"""Longest time that one tick moves the cursor by, so that a stall is not made up for."""

MAX_ADVANCE_NS = 60 * NS_PER_S
"""Distance above which the source seeks, because reading every record would take longer."""


class Playback:
    """The moment of a run that is shown, and the state of the run at it.

    A growing run is followed: the cursor stays at its end. Every jump ends that, and the run is
    played on from there; a cursor that reaches the end of a growing run follows it again.
    """

    def __init__(self, source: RunSource) -> None:
        self.speed = 1.0
        """Speed relative to that of the recording, while the run is not followed."""
        self.use(source)

    def use(self, source: RunSource) -> None:
        """Show another run: follow it if it is growing, otherwise show its end."""
        self.source = source
        """The run that is shown."""
        self._look()
        self.cursor_ns = self.end_ns
        """Stamp of the moment that is shown."""
        self.following = self.playing = self.is_growing
        """Whether the cursor stays at the end of the run, and whether it moves."""
        self._state, self._state_ns = RunState(), -1

    def _look(self) -> None:
        """Read the extent of the run, which may cost a query, once for each tick."""
        # The order matters: a run that has ended before its end is read grows no more.
        self.is_growing = self.source.is_growing
        """Whether more records may follow, as of the last tick."""
        self.begin_ns, self.end_ns = self.source.begin_ns, self.source.end_ns
        """Stamps of the first and the last record, as of the last tick."""

    @property
    def at_end(self) -> bool:
        """Whether the end of the run is shown."""
        return self.cursor_ns >= self.end_ns

    def tick(self, elapsed_s: float) -> RunState:
        """Move the cursor by the time that has passed, and return the state at it.

        The state belongs to the playback and changes with the next tick.

        Args:
            elapsed_s: time since the last tick in s.
        """
        self._look()
        if self.playing and not self.following:
            moved_s = min(max(elapsed_s, 0.0), MAX_ELAPSED_S) * self.speed
            self.cursor_ns += round(moved_s * NS_PER_S)
            self.following = self.at_end
        self.cursor_ns = self.end_ns if self.following else self._within(self.cursor_ns)
        if self.following and not self.is_growing:
            self.following = self.playing = False
        self._show()
        return self._state

    def seek(self, stamp_ns: int) -> None:
        """Move the cursor to a stamp within the run."""
        self.following = False
        self.cursor_ns = self._within(stamp_ns)

    def step(self, views: int) -> None:
        """Pause, and move the cursor by a number of views, back if it is negative."""
        self.pause()
        self.cursor_ns = self._within(self.source.step(self.cursor_ns, views))

    def follow(self) -> None:
        """Move the cursor to the end, and keep it there while the run grows."""
        self.cursor_ns = self.end_ns
        self.following = self.playing = self.is_growing

    def pause(self) -> None:
        """Keep the cursor where it is."""
        self.following = self.playing = False

    def play(self) -> None:
        """Move the cursor on, from the beginning if the end of a finished run is shown."""
        if self.at_end and not self.is_growing:
            self.cursor_ns = self.begin_ns
        self.playing = True

    def toggle(self) -> None:
        """Pause if the cursor moves, otherwise play."""
        if self.playing:
            self.pause()
        else:
            self.play()

    def _within(self, stamp_ns: int) -> int:
        return max(min(stamp_ns, self.end_ns), self.begin_ns)

    def _show(self) -> None:
        """Bring the state to the cursor."""
        ahead_ns = self.cursor_ns - self._state_ns
        if ahead_ns == 0:
            return
        if self._state_ns >= 0 and 0 < ahead_ns <= MAX_ADVANCE_NS:
            self.source.advance(self._state, self.cursor_ns)
        else:
            self._state = self.source.seek(self.cursor_ns)
        self._state_ns = self.cursor_ns
