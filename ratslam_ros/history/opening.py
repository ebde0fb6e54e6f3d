# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Opening of a run by its path."""

from __future__ import annotations

from pathlib import Path

from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.file import HISTORY_NAME, part_path
from ratslam_ros.history.final_run import FinalRun
from ratslam_ros.history.history_run import HistoryRun
from ratslam_ros.maps.locks import is_written
from ratslam_ros.results.trajectory import read_tum

TRUTH_NAME = 'truth.tum'


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
