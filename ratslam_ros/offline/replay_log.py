# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replay of a kept log: repeats a live run from what its process has received (kept_log.py)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from ratslam_ros.core.vision.local_view import UNDECODABLE
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import stored_config, to_yaml
from ratslam_ros.maps import Cut, live_meta, read_map, save_map
from ratslam_ros.maps.input_log import END, VERSION
from ratslam_ros.maps.kept_log import Beginning, KeptRun, kept_runs
from ratslam_ros.maps.live_pipeline import LivePipeline, Process
from ratslam_ros.pipeline.codec import command_from_state
from ratslam_ros.pipeline.items import OdometryStep
from ratslam_ros.pipeline.live_stages import LIVE_STAGES, Reporter
from ratslam_ros.pipeline.ratslam import STAGES, Steps
from ratslam_ros.results.plots import draw_all
from ratslam_ros.results.trajectory import tum_line
from ratslam_ros.results.writer import Results

NEW_RUN = 1
"""Run of a stream that is passed on, before the log names the one that it had."""

MAP_NAME = 'replayed.map'
"""File in the results folder with the map at the end of the log."""

LIVE_NAME = 'trajectory_live.tum'
"""File in it with the poses that were published when odometry arrived."""


class LogReplay(Process):
    """Repeats what a process has done, from the entries of its log."""

    def __init__(self, run: KeptRun) -> None:
        """Restore what the process began from.

        Raises:
            UnusableInput: it cannot be repeated.
        """
        self.run, beginning = run, run.beginning
        _check(run, beginning)
        config, _ = stored_config(beginning.configuration, str(run.folder))
        stages = [LIVE_STAGES[part](config, Reporter()) for part in beginning.parts]
        self.live = LivePipeline(stages, config, self, beginning.chain, NEW_RUN)
        self.pipeline, self.has_ended = self.live.pipeline, False
        for setting in beginning.settings:
            self.live.command(command_from_state(setting))
        self.live.begin(beginning, run.states, run.folder)
        self.pipeline.go_on()

    def repeat(self) -> Iterator[None]:
        """Repeat what the log contains, up to its end if it has one; yield after each entry."""
        for entry in self.run.entries():
            self.has_ended = entry.stream == END
            if self.has_ended:
                break
            self.live.receive(entry)
            yield
        if not self.live.run:  # what is held is not passed on at the end
            self.pipeline.finish()
        yield


class MapReplay(LogReplay):
    """Repeats what the process of the experience map has done, and locates the robot."""

    def __init__(self, run: KeptRun, matches: Mapping[int, Any] | None) -> None:
        """Restore what the process began from.

        Args:
            run: its run.
            matches: views by stamp, of processes before it; None if there are none.
        """
        super().__init__(run)
        self.graph: Any = self.pipeline.stages['experience_map']
        self.live_poses: list[str] = []
        """The lines of ``LIVE_NAME``."""
        self.steps = Steps(self.pipeline)
        self.pipeline.observe('pose', self._moved)
        if matches is not None:
            self.pipeline.observe('action', lambda stamp_ns, _: self.steps.note_match(
                stamp_ns, matches.get(stamp_ns, UNDECODABLE)
            ))

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

    In a split, the processes are repeated one after the other: the log of each has all that it
    received from the others.

    Args:
        map_file: the map file.
        folder: the folder for the results; it is created.

    Raises:
        UnusableInput: there is no such log, or it cannot be repeated exactly.
    """
    *before, last = mapping_runs(map_file)
    matches: dict[int, Any] = {}
    replays = [LogReplay(run) for run in before]
    replay = MapReplay(last, matches if before else None)
    for one in replays:
        one.pipeline.observe('template', matches.__setitem__)
        for _ in one.repeat():
            pass
    replays.append(replay)
    config = replace(replay.live.config, **{
        part: getattr(one.live.config, part) for one in replays for part in one.run.beginning.parts
    })
    results = Results(folder, config)
    try:
        for _ in replay.repeat():
            for step in replay.steps.taken():
                results.add(step)
        _check_chain(replays)
        states = {part: state for one in replays for part, state in one.live.states().items()}
        graph, order = replay.graph.core, replays[0].pipeline.order
        if not last.beginning.chain.follows:  # those of a split are ahead of the logged stream
            results.write(LIVE_NAME, ''.join(replay.live_poses))
        summary = {
            **results.summary(graph), 'late': order.counts.late, 'refused': order.counts.refused,
            'log': {'map': str(map_file), **replays[0].run.described()},
        }
        results.last_view_ns = replay.graph.action_ns
        results.finish(graph, summary)
    except BaseException:
        results.discard()
        raise
    saved = read_map(map_file)
    goals = saved.states.get('experience_map', {}).get('goals', {})
    states['experience_map']['goals']['queue'] = goals.get('queue', [])  # it is not repeated
    path = folder / MAP_NAME
    configuration = last.beginning.configuration if len(replays) == 1 else to_yaml(config)
    save_map(path, states, live_meta(configuration), Cut(0, order.newest_ns or 0))
    digests = read_map(path).digests
    differing = [part for part, one in digests.items() if saved.digests.get(part) != one]
    has_ended = all(one.has_ended for one in replays)
    is_last = has_ended and saved.sessions[-1].ended
    return LogOutcome(draw_all(folder), summary, has_ended, differing if is_last else None)


def mapping_runs(map_file: Path) -> list[KeptRun]:
    """Return the last runs of the processes that mapped, in the direction of flow.

    Raises:
        UnusableInput: a log is missing.
    """
    runs = kept_runs(map_file)
    if not runs:
        raise UnusableInput(
            f'{map_file} has no log; expected one that live nodes have kept beside a map '
            'file (ratslam launch --map FILE --keep-log, or keep_log:=true)'
        )
    newest = {run.folder: run for run in sorted(runs, key=lambda run: run.number)}.values()
    by_end = {run.beginning.parts[-1]: run for run in sorted(newest, key=lambda run: run.time_s)}
    stages = [stage.NAME for stage in STAGES]
    found: list[KeptRun] = []
    end = stages[-1]
    while end in by_end and not (found and by_end[end].time_s[1] < found[0].time_s[0]):
        found.insert(0, by_end[end])  # the process before the others, unless it had ended
        at = stages.index(found[0].beginning.parts[0])
        end = stages[at - 1] if at else ''
    parts = [part for run in found for part in run.beginning.parts]
    missing = [part for part in stages[stages.index('pose_cells') :] if part not in parts]
    if missing or found[0].beginning.chain.follows:
        missing = missing or [found[0].beginning.chain.follows]
        raise UnusableInput(
            f'{map_file} has no log of {" and ".join(missing)}; expected logs of all processes of '
            'the run: set keep_log for all of them'
        )
    return found


def _check_chain(replays: list[LogReplay]) -> None:
    """Raise if a process followed another run than that of the log before it."""
    for before, after in pairwise(replays):
        run = after.live.followed[0]
        if after.run.beginning.chain.follows and run not in (0, before.live.run):
            raise UnusableInput(
                f'the logs in {before.run.folder} and {after.run.folder} are of different runs: '
                'one of the processes was restarted without its log, or was left out'
            )


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
