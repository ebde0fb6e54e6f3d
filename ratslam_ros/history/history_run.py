# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run that is read from its history file, finished or growing."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import yaml

from ratslam_ros.history.file import HistoryMeta
from ratslam_ros.history.reader import HistoryFile
from ratslam_ros.history.recorded_images import RecordedImages
from ratslam_ros.history.records import ImageRecord, ViewRecord
from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.history.truth import Truth
from ratslam_ros.results.trajectory import Trajectory

SECTION, VIEWS = '/**/pose_cells', 'pc_vt_agree_views'
"""Number of views that must agree on a place, in the configuration of the run."""

MAX_IMAGE_AGE_NS = 10 * NS_PER_S
"""Age up to which the last image is shown for a stamp."""


class HistoryRun:
    """A ``RunSource`` over a history file; it may be used from several threads.

    Stamps are compared with the time of records, see ``HistoryFile``. The state at a stamp is the
    sum of all records up to it; advancing in steps of any size gives the same state as seeking.
    """

    def __init__(self, path: Path) -> None:
        """Open a history file.

        Raises:
            UnusableInput: the file is no history, or of another version.
        """
        self._file = HistoryFile(path)
        self._trajectory: Trajectory | None = None
        self._truth: Truth | None = None
        self._images = RecordedImages(self._file.meta)
        self._progress = self._file.progress()

    def set_truth(self, trajectory: Trajectory) -> None:
        """Show a true trajectory from now on; it is aligned by the first pose of the run."""
        self._trajectory, self._truth = trajectory, None

    @property
    def meta(self) -> HistoryMeta:
        """What is known of the run besides its records."""
        return self._file.meta

    @property
    def title(self) -> str:
        """Name of the run, such as that of the recording."""
        return self.meta.title

    @property
    def begin_ns(self) -> int:
        """Stamp of the first record, 0 if there is none yet."""
        self._poll()
        return self._progress.begin_ns

    @property
    def end_ns(self) -> int:
        """Stamp of the last record, 0 if there is none yet."""
        self._poll()
        return self._progress.end_ns

    @property
    def is_growing(self) -> bool:
        """Whether more records may follow."""
        self._poll()
        return self._progress.is_growing

    @property
    def notices(self) -> Sequence[str]:
        """What the user must know."""
        self._poll()
        notices = []
        if not self._progress.is_growing and not self._progress.has_ended:
            notices.append('the run was interrupted: the history ends with its last moments')
        if self._images.problem:
            notices.append(self._images.problem)
        return notices

    @cached_property
    def required_views(self) -> float | None:
        """Number of views that must agree on a place, None if unknown."""
        try:
            sections = yaml.safe_load(self.meta.configuration)
            return float(sections[SECTION]['ros__parameters'][VIEWS])
        except (yaml.YAMLError, LookupError, TypeError, ValueError):
            return None

    def seek(self, stamp_ns: int) -> RunState:
        """Return a new state: that of the last record whose stamp is not later."""
        state = self._file.state_at(stamp_ns)
        self.advance(state, stamp_ns)
        return state

    def advance(self, state: RunState, stamp_ns: int) -> None:
        """Apply to a state all records between it and a later stamp."""
        self._file.apply(state, stamp_ns)
        if self._trajectory is None or state.pose is None:
            return
        if self._truth is None:
            first = self._file.first_pose()
            assert first is not None  # the state has one
            self._truth = Truth(self._trajectory, first.stamp_ns, first.pose)
        self._truth.apply(state)

    def image_at(self, stamp_ns: int) -> bytes | None:
        """Return the best image of a stamp as JPEG, None if there is none near it.

        That of the recording if it is there, else the small one of the history.
        """
        view = self.view_at(stamp_ns)
        if view is not None and stamp_ns - view.stamp_ns <= MAX_IMAGE_AGE_NS:
            image = self._images.at(view.stamp_ns)
            if image is not None:
                return image
        record = self._file.last(ImageRecord, stamp_ns, stamp_ns - MAX_IMAGE_AGE_NS)
        return record.jpeg if isinstance(record, ImageRecord) else None

    def view_at(self, stamp_ns: int) -> ViewRecord | None:
        """Return the last view whose stamp is not later."""
        found = self._file.view(self._file.view_count(stamp_ns) - 1)
        return None if found is None else found[1]

    def step(self, stamp_ns: int, views: int) -> int:
        """Return the stamp of the view that is a number of views later, or earlier if negative.

        It is that of the first or last view if there are not as many, and the given one if there
        are none.
        """
        last = self._file.view_count(self.end_ns) - 1
        number = self._file.view_count(stamp_ns) - 1 + views
        found = self._file.view(min(max(number, 0), last))
        return stamp_ns if found is None else found[0]

    def visits(self, experience_id: int, until_ns: int) -> list[ViewRecord]:
        """Return the first view of every visit of an experience up to a stamp, oldest first.

        The id may have been that of another experience before, whose visits are left out.
        """
        views = self._file.visits(experience_id, until_ns)
        created = [n for n, view in enumerate(views) if view.action == 'create']
        return views[created[-1] :] if created else views

    def closures(self, until_ns: int) -> list[ViewRecord]:
        """Return the views that closed a loop, or would have but for a reason, oldest first."""
        return self._file.closures(until_ns)

    def close(self) -> None:
        """Close the file and the recording."""
        self._file.close()
        self._images.close()

    def _poll(self) -> None:
        """Read how far the run is, until it has ended."""
        if not self._progress.is_growing:
            return
        self._progress = self._file.progress()
