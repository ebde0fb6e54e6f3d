# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replay of a kept log: repeats a live run from what its process has received (kept_log.py)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from ratslam_ros.core.config import AUTOMATIC
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import stored_config
from ratslam_ros.maps import Cut, live_meta, read_map, save_map
from ratslam_ros.maps.input_log import END, VERSION
from ratslam_ros.maps.kept_log import Beginning, KeptRun, kept_runs
from ratslam_ros.maps.live_pipeline import LivePipeline, Process
from ratslam_ros.pipeline.codec import command_from_state
from ratslam_ros.pipeline.items import OdometryStep
from ratslam_ros.pipeline.live_stages import LIVE_STAGES, Reporter
from ratslam_ros.pipeline.pipeline import Pipeline, lateness_ns
from ratslam_ros.pipeline.ratslam import Steps
from ratslam_ros.results.plots import draw_all
from ratslam_ros.results.trajectory import tum_line
from ratslam_ros.results.writer import Results

MAP_NAME = 'replayed.map'
"""File in the results folder with the map at the end of the log."""

LIVE_NAME = 'trajectory_live.tum'
"""File in it with the poses that were published when odometry arrived."""


class LogReplay(Process):
    """Repeats a run from the entries of its log."""

    def __init__(self, run: KeptRun) -> None:
        """Restore what the run began from.

        Raises:
            UnusableInput: it cannot be repeated.
        """
        self._run, beginning = run, run.beginning
        _check(run, beginning)
        config, _ = stored_config(beginning.configuration, str(run.folder))
        stages = [LIVE_STAGES[part](config, Reporter()) for part in beginning.parts]
        self.pipeline = Pipeline(stages, lateness_ns(config))
        self.live = LivePipeline(self.pipeline, config, self)
        self.graph: Any = self.pipeline.stages['experience_map']
        self.live_poses: list[str] = []
        """The lines of ``LIVE_NAME``."""
        self._steps = Steps(self.pipeline)
        self.pipeline.observe('pose', self._moved)
        for setting in beginning.settings:
            self.live.command(command_from_state(setting))
        self.live.begin(beginning, run.states, run.folder)
        self.pipeline.go_on()

    def run(self, results: Results) -> bool:
        """Repeat the run, and write its steps; return whether the log has its end."""
        has_ended = False
        for entry in self._run.entries():
            has_ended = entry.stream == END
            if has_ended:
                break
            self.live.receive(entry)
            self._write(results)
        self.pipeline.finish()
        self._write(results)
        return has_ended

    def _write(self, results: Results) -> None:
        for step in self._steps.taken():
            results.add(step)

    def taken(self, stream: str, stamp_ns: int, unanswered: int) -> None:
        """Locate the robot at odometry that is received."""
        if stream == 'odometry' and stamp_ns == self.pipeline.order.newest_of(stream):
            self._locate(stamp_ns)

    def _moved(self, stamp_ns: int, step: OdometryStep) -> None:
        if 'odometry' not in self.pipeline.inputs:
            self._locate(stamp_ns)

    def _locate(self, stamp_ns: int) -> None:
        if not self.live.is_paused('experience_map'):
            pose = self.graph.pose_after(self.pipeline.waiting('odometry'))
            self.live_poses.append(tum_line(stamp_ns, pose))


class LogOutcome(NamedTuple):
    """Result of a replay of a log.

    plots: the plots. summary: content of summary.json. has_ended: whether the log has its end.
    differing: parts of which the state differs from the map file; None: the map file is older
    than the end of the log, or of a later session.
    """

    plots: list[Path]
    summary: dict[str, Any]
    has_ended: bool
    differing: list[str] | None


def replay_log(map_file: Path, folder: Path) -> LogOutcome:
    """Repeat the last run beside a map whose log was kept, and compare the maps.

    Args:
        map_file: the map file.
        folder: the folder for the results; it is created.

    Raises:
        UnusableInput: there is no such log, or it cannot be repeated exactly.
    """
    replay = LogReplay(run := mapping_run(map_file))
    threshold = replay.live.config.local_view.vt_match_threshold
    results = Results(folder, with_thresholds=threshold == AUTOMATIC)
    try:
        has_ended = replay.run(results)
        states, graph = replay.live.states(), replay.graph.core
        counts = replay.pipeline.order.counts
        results.write(LIVE_NAME, ''.join(replay.live_poses))
        summary = {
            **results.summary(graph), 'late': counts.late, 'refused': counts.refused,
            'log': {'map': str(map_file), **run.described()},
        }
        results.last_view_ns = replay.graph.action_ns
        results.finish(graph, replay.live.config, summary)
    except BaseException:
        results.discard()
        raise
    saved = read_map(map_file)
    goals = saved.states.get('experience_map', {}).get('goals', {})
    states['experience_map']['goals']['queue'] = goals.get('queue', [])  # it is not repeated
    path = folder / MAP_NAME
    meta, newest_ns = live_meta(run.beginning.configuration), replay.pipeline.order.newest_ns or 0
    save_map(path, states, meta, Cut(0, newest_ns))
    digests = read_map(path).digests
    differing = [part for part, one in digests.items() if saved.digests.get(part) != one]
    is_last = has_ended and saved.sessions[-1].ended
    plots = draw_all(folder, None, replay.live.config.local_view.vt_match_threshold)
    return LogOutcome(plots, summary, has_ended, differing if is_last else None)


def mapping_run(map_file: Path) -> KeptRun:
    """Return the last run of the process that mapped, of those whose logs are kept.

    Raises:
        UnusableInput: there is none, or the nodes ran in processes of their own.
    """
    runs = kept_runs(map_file)
    if not runs:
        raise UnusableInput(
            f'{map_file} has no log; expected one that live nodes have kept beside a map '
            'file (ratslam launch --map FILE --keep-log, or keep_log:=true)'
        )
    mapping = [run for run in runs if {'pose_cells', 'experience_map'} <= {*run.beginning.parts}]
    if not mapping:
        raise UnusableInput(
            f'the logs of {map_file} are of nodes in processes of their own, with the requests to '
            'each in its log: such a run cannot be repeated; map in one process (without --split)'
        )
    return mapping[-1]


def _check(run: KeptRun, beginning: Beginning) -> None:
    if beginning.own_stages:
        raise UnusableInput(
            f'the run in {run.folder} used {", ".join(beginning.own_stages)}; expected stages of '
            'this package only'
        )
    if beginning.version != VERSION:
        raise UnusableInput(
            f'the run in {run.folder} is of ratslam_ros {beginning.version}; expected {VERSION}: '
            'repeat it with the version that recorded it, or remove it with ratslam map drop-log '
            f'{run.map_file}'
        )
