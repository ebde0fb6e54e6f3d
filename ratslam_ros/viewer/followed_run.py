# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run whose history is being written by another process, from before its first record."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.file import part_path
from ratslam_ros.history.final_run import FinalRun
from ratslam_ros.history.history_run import HistoryRun
from ratslam_ros.history.opening import open_run
from ratslam_ros.history.records import ViewRecord
from ratslam_ros.history.run_state import RunState

WAITING = 'Waiting for the first image; the loops are compiled at the first start.'

RETRY_S = 0.2
"""Time between attempts to open the history, which the other process creates step by step."""


class FollowedRun:
    """The history at a path, as soon as there is one; empty before."""

    def __init__(self, path: Path, title: str, truth: Path | None = None) -> None:
        """Follow a history.

        Args:
            path: the history; a file that is there already belongs to an earlier run.
            title: name of the run.
            truth: TUM file of the true trajectory, None for one beside the recording.
        """
        self.title = title
        """Name of the run."""
        self._truth = truth
        self._earlier = {path: _version(path) for path in (part_path(path), path)}
        """Versions of the files: the history ends with its final name."""
        self._run: HistoryRun | FinalRun | None = None
        self._has_ended = False
        self._notices: list[str] = []
        self._tried_s = -RETRY_S

    def add_notice(self, text: str) -> None:
        """Add what the user must know."""
        self._notices.append(text)

    def end(self) -> None:
        """State that the other process has ended: no record will follow."""
        self._has_ended = True

    def close(self) -> None:
        """Close the history."""
        if self._run is not None:
            self._run.close()

    @property
    def has_begun(self) -> bool:
        """Whether there is a history."""
        return self._opened() is not None

    @property
    def begin_ns(self) -> int:
        """Stamp of the first record, 0 if there is none yet."""
        run = self._opened()
        return 0 if run is None else run.begin_ns

    @property
    def end_ns(self) -> int:
        """Stamp of the last record, 0 if there is none yet."""
        run = self._opened()
        return 0 if run is None else run.end_ns

    @property
    def is_growing(self) -> bool:
        """Whether more records may follow."""
        run = self._opened()
        return not self._has_ended and (run is None or run.is_growing)

    @property
    def notices(self) -> Sequence[str]:
        """What the user must know."""
        run = self._opened()
        waiting = [] if self._has_ended else [WAITING]
        return [*self._notices, *(waiting if run is None else run.notices)]

    @property
    def required_views(self) -> float | None:
        """Number of views that must agree on a place, None if unknown."""
        run = self._opened()
        return None if run is None else run.required_views

    def seek(self, stamp_ns: int) -> RunState:
        """Return a new state: that of the last record whose stamp is not later."""
        run = self._opened()
        return RunState() if run is None else run.seek(stamp_ns)

    def advance(self, state: RunState, stamp_ns: int) -> None:
        """Apply to a state all records between it and a later stamp."""
        run = self._opened()
        if run is not None:
            run.advance(state, stamp_ns)

    def image_at(self, stamp_ns: int) -> bytes | None:
        """Return the best image of a stamp as JPEG, None if there is none near it."""
        run = self._opened()
        return None if run is None else run.image_at(stamp_ns)

    def step(self, stamp_ns: int, views: int) -> int:
        """Return the stamp of the view that is a number of views later, or earlier."""
        run = self._opened()
        return stamp_ns if run is None else run.step(stamp_ns, views)

    def visits(self, experience_id: int, until_ns: int) -> list[ViewRecord]:
        """Return the first view of every visit of an experience up to a stamp."""
        run = self._opened()
        return [] if run is None else run.visits(experience_id, until_ns)

    def closures(self, until_ns: int) -> list[ViewRecord]:
        """Return the views that closed a loop, or would have but for a reason."""
        run = self._opened()
        return [] if run is None else run.closures(until_ns)

    def _opened(self) -> HistoryRun | FinalRun | None:
        if self._run is None and time.monotonic() - self._tried_s >= RETRY_S:
            self._tried_s = time.monotonic()
            for path, earlier in self._earlier.items():
                if self._run is None and _version(path) not in (None, earlier):
                    self._open(path)
        return self._run

    def _open(self, path: Path) -> None:
        try:
            self._run = open_run(path, self._truth)
        except UnusableInput as error:  # not complete yet, or never
            if self._has_ended and str(error) not in self._notices:
                self._notices.append(str(error))


def _version(path: Path) -> tuple[int, int] | None:
    """Return what differs after a file was replaced, None if there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_ctime_ns
