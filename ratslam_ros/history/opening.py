# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Opening of a run by its path: its history, or the final state of results without one."""

from __future__ import annotations

from pathlib import Path

from ratslam_ros.core.mapping.map_changes import MapChange, MapChangeTracker
from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.file import HISTORY_NAME, part_path
from ratslam_ros.history.history_run import HistoryRun
from ratslam_ros.history.records import PoseRecord, ViewRecord
from ratslam_ros.history.run_state import TRAIL_LENGTH, RunState
from ratslam_ros.history.truth import Truth
from ratslam_ros.maps.locks import is_written
from ratslam_ros.results.map_json import read_map_json
from ratslam_ros.results.trajectory import Trajectory, read_tum

TRUTH_NAME = 'truth.tum'

NOTICE = (
    'these results have no history: only the final state can be shown; replay the recording '
    'without --no-history to see the whole run'
)


class EmptyRun:
    """A ``RunSource`` without records."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.begin_ns = self.end_ns = 0
        self.is_growing = False
        self.notices: list[str] = []
        self.required_views: float | None = None

    def seek(self, stamp_ns: int) -> RunState:
        """Return a new state."""
        return RunState()

    def advance(self, state: RunState, stamp_ns: int) -> None:
        """Do nothing: there is at most one moment."""

    def image_at(self, stamp_ns: int) -> bytes | None:
        """Return None: there are no images."""
        return None

    def step(self, stamp_ns: int, views: int) -> int:
        """Return the stamp of the only moment."""
        return self.end_ns

    def visits(self, experience_id: int, until_ns: int) -> list[ViewRecord]:
        """Return no views."""
        return []

    def close(self) -> None:
        """Do nothing: no file is open."""


class FinalRun(EmptyRun):
    """A run of one moment: its end, from map.json and the trajectories."""

    def __init__(self, folder: Path) -> None:
        """Read the results in a folder; raises UnusableInput if they cannot be read."""
        super().__init__(folder.resolve().name)
        self.notices.append(NOTICE)
        self._map = _final_map(folder / 'map.json')
        """Changes from an empty map to that of map.json."""
        self._final, self._dead_reckoning = (
            read_tum(path, TRAIL_LENGTH) if path.is_file() else None
            for path in (folder / 'trajectory_final.tum', folder / 'dead_reckoning.tum')
        )
        self._truth: Truth | None = None
        self.end_ns = self._map[-1].stamp_ns
        if self._final is not None:
            self.end_ns = max(self.end_ns, int(self._final.stamp_ns[-1]))
        self.begin_ns = self.end_ns

    def set_truth(self, trajectory: Trajectory) -> None:
        """Show a true trajectory; it is aligned by the first pose."""
        if self._final is not None:
            self._truth = Truth(trajectory, int(self._final.stamp_ns[0]), self._final.pose(0))

    def seek(self, stamp_ns: int) -> RunState:
        """Return a new state: the final one."""
        state = RunState()
        for change in self._map:
            state.apply(change)
        if self._final is not None:
            dead_reckoning = None
            if self._dead_reckoning is not None:
                dead_reckoning = self._dead_reckoning.pose(-1)
                state.dead_reckoning.replace(self._dead_reckoning.position_m)
            pose = self._final.pose(-1)
            state.apply(PoseRecord(int(self._final.stamp_ns[-1]), pose, dead_reckoning))
            state.trail.replace(self._final.position_m)
            if self._truth is not None:
                self._truth.apply(state)
        return state


def open_run(path: str | Path, truth: str | Path | None = None) -> HistoryRun | FinalRun:
    """Open a run to show it.

    Of a results folder, this is the run that is being written there; else the finished one; else
    one that was interrupted; else, or if its history is damaged, the final state.

    Args:
        path: a results folder, or a history file.
        truth: TUM file of the true trajectory; None for truth.tum in the results folder or in the
            folder of the recording, if there is one.

    Raises:
        UnusableInput: there is no run, or it cannot be read.
    """
    path = Path(path)
    if path.is_file():
        run: HistoryRun | FinalRun = HistoryRun(path)
    elif path.is_dir():
        final = path / HISTORY_NAME
        part = part_path(final)
        if part.exists() and (is_written(final) or not final.exists()):
            run = HistoryRun(part)
        elif final.exists():
            run = _finished(path, final)
        else:
            run = FinalRun(path)
    else:
        raise UnusableInput(
            f'{path} does not exist: expected a results folder, such as results/latest'
        )
    file = Path(truth) if truth is not None else _truth_of(path, run)
    if file is not None:
        run.set_truth(read_tum(file))
    return run


def _finished(folder: Path, history: Path) -> HistoryRun | FinalRun:
    """Open the history of a finished run; if it is damaged, the final state."""
    try:
        return HistoryRun(history)
    except UnusableInput as error:
        try:
            run = FinalRun(folder)
        except UnusableInput:
            raise error from None
        run.notices = [f'only the final state can be shown: {error}']
        return run


def _truth_of(path: Path, run: HistoryRun | FinalRun) -> Path | None:
    """Return the true trajectory beside the results or the recording, None if there is none."""
    folders = [path if path.is_dir() else path.parent]
    if isinstance(run, HistoryRun) and run.meta.recording:
        recording = Path(run.meta.recording)
        folders += [recording, recording.parent]
    for folder in folders:
        if (folder / TRUTH_NAME).is_file():
            return folder / TRUTH_NAME
    return None


def _final_map(path: Path) -> list[MapChange]:
    if not path.exists():
        raise UnusableInput(
            f'{path.parent} has neither a history nor map.json; give a results folder'
        )
    content, graph = read_map_json(path)
    return [*MapChangeTracker().changes(graph, content.stamp.ns)]
