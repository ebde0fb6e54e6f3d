# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run whose history is being written by another process, from before its first record."""

from __future__ import annotations

from pathlib import Path

from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.file import part_path
from ratslam_ros.history.history_run import HistoryRun
from ratslam_ros.history.opening import EmptyRun, open_run
from ratslam_ros.maps.schema import identity

WAITING = 'Waiting for the first image; the loops are compiled at the first start.'


class FollowedRun:
    """The run at a path: that of its history as soon as there is one, an empty one before."""

    def __init__(self, path: Path, title: str, truth: Path | None = None) -> None:
        """Follow a history.

        Args:
            path: the history; a file that is there already belongs to an earlier run.
            title: name of the run.
            truth: TUM file of the true trajectory, None for one beside the recording.
        """
        self._title, self._truth = title, truth
        self._earlier = {path: identity(path) for path in (part_path(path), path)}
        """Versions of the files: the history ends with its final name."""
        self._empty = EmptyRun(title)
        self._empty.is_growing = True
        self._empty.notices = [WAITING]
        self.run: HistoryRun | EmptyRun = self._empty
        """The run to show."""
        self._notices: list[str] = []

    def open(self) -> bool:
        """Open the history if there is one now; return whether ``run`` has changed."""
        for path, earlier in self._earlier.items():
            if self.run is self._empty and identity(path) not in (None, earlier):
                try:
                    run = open_run(path, self._truth)
                except UnusableInput as error:  # not complete yet, or never
                    if not self._empty.is_growing and str(error) not in self._notices:
                        self._notices.append(str(error))
                else:
                    assert isinstance(run, HistoryRun)  # as the path is that of a file
                    run.title, run.added_notices = self._title, self._notices
                    self.run = run
                    return True
        return False

    def end(self, *notices: str) -> None:
        """State that the other process has ended, and what the user must know of it."""
        self._notices += notices
        self._empty.is_growing, self._empty.notices = False, self._notices
