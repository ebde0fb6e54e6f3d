# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replay of a kept log: repeats a live run from what its process has received (kept_log.py)."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import AUTOMATIC, Config, Value
from ratslam_ros.core.pose_cells.map_relocation import ADOPTION_DELAY
from ratslam_ros.core.vision.local_view import NO_TEMPLATE
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import stored_config
from ratslam_ros.files.version import package_version
from ratslam_ros.maps import Cut, live_meta, read_map, save_map
from ratslam_ros.maps.input_log import END
from ratslam_ros.maps.kept_log import Beginning, KeptRun, kept_runs, loaded_state
from ratslam_ros.maps.live_states import Setting, live_states
from ratslam_ros.maps.log_entries import receive
from ratslam_ros.maps.logged_items import decode_item
from ratslam_ros.maps.parameter_changes import MAX_CHANGES
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.mapping import RelocationPayload
from ratslam_ros.pipeline.commands import (
    NOW,
    Command,
    Configure,
    Hint,
    NewSession,
    Reset,
    SetPaused,
    concerns,
)
from ratslam_ros.pipeline.continuity import begins_session
from ratslam_ros.pipeline.item_states import command_from_state
from ratslam_ros.pipeline.items import Answer, MapStep, OdometryStep, Step
from ratslam_ros.pipeline.live_stages import (
    LiveExperienceMap,
    LiveLocalView,
    LivePoseCells,
    LiveTemplates,
    LiveVisualOdometry,
    Template,
)
from ratslam_ros.pipeline.pipeline import COMMAND
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.results.plots import draw_all
from ratslam_ros.results.trajectory import tum_line
from ratslam_ros.results.writer import Results

MAP_NAME = 'replayed.map'
"""File in the results folder with the map at the end of the log."""

LIVE_NAME = 'trajectory_live.tum'
"""File in it with the poses that were published when odometry arrived."""


class _Quiet:
    """Takes what stages report: the live process has reported it."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def note(self, text: str) -> None:
        """Ignore a note."""

    def drop(self, reason: str, text: str, number: int = 1) -> None:
        """Ignore a message that is not used."""


class _Eyes(LiveVisualOdometry):
    def __init__(self, config: Config) -> None:
        super().__init__(config, _Quiet())


class _Templates(LiveTemplates):
    def __init__(self, config: Config) -> None:
        super().__init__(LiveLocalView(config, _Quiet()))


class _Cells(LivePoseCells):
    def __init__(self, config: Config) -> None:
        super().__init__(config, _Quiet())


class _Map(LiveExperienceMap):
    def __init__(self, config: Config) -> None:
        super().__init__(config, _Quiet())


class _LiveSLAM(RatSLAM):
    """RatSLAM with the stages of live nodes."""

    def __init__(self, config: Config, head: str) -> None:
        super().__init__(config, head, stages=(_Eyes, _Templates, _Cells, _Map))

    def _note_match(self, stamp_ns: int, match: Any) -> None:
        template: Template = match
        super()._note_match(stamp_ns, template.match)

    def taken(self) -> list[Step]:
        """Return the steps since the last call."""
        return self._taken()


class LogReplay:
    """Repeats a run from the entries of its log."""

    def __init__(self, run: KeptRun) -> None:
        """Restore what the run began from.

        Raises:
            UnusableInput: it cannot be repeated.
        """
        self._run, self._beginning = run, run.beginning
        _check(run, self._beginning)
        self.config, _ = stored_config(self._beginning.configuration, str(run.folder))
        self.slam = _LiveSLAM(self.config, self._beginning.parts[0])
        self.pipeline = self.slam.pipeline
        self.action_ns = 0
        """Stamp of the last view with a template."""
        self.live_poses: list[str] = []
        """The lines of ``LIVE_NAME``."""
        self._answers: deque[str] = deque(maxlen=ADOPTION_DELAY)
        self._records: dict[str, list[list[Value]]] = {part: [] for part in self._beginning.parts}
        """Parameters that were set, by part."""
        self._settings: dict[tuple[type, str], Setting] = {}
        self._is_first = self._beginning.is_first
        for stream in self.pipeline.inputs:
            self.pipeline.observe(stream, self._before)
        self.pipeline.observe(COMMAND, self._obeyed)
        self.pipeline.observe('pose', self._moved)
        self.pipeline.observe('update', self._updated)
        self.pipeline.observe('relocation', self._answered)
        self._restore(run.states)
        if self._is_first:
            stage: Any = self.pipeline.stages['experience_map']
            stage.lose_place()

    def run(self, results: Results) -> bool:
        """Repeat the run, and write its steps; return whether the log has its end."""
        has_ended = False
        for entry in self._run.entries():
            has_ended = entry.stream == END
            if has_ended:
                break
            receive(entry, self)
            for step in self.slam.taken():
                results.add(step)
        self.pipeline.finish()
        for step in self.slam.taken():
            results.add(step)
        return has_ended

    def states(self) -> dict[str, State]:
        """Return what the live process saves at this moment."""
        states = {part: self.pipeline.state_of(part) for part in self._beginning.parts}
        graph = self.slam.experience_map
        stage: Any = self.pipeline.stages['experience_map']
        assert stage.core is graph
        states['experience_map'] |= {
            'goals': {**stage.goals.state(), 'queue': []}, 'action_ns': self.action_ns,
            'answers': list(self._answers),
        }  # fmt: skip
        for part, record in self._records.items():
            if record:
                states[part]['parameters_set'] = record
        return live_states(self.pipeline, states, [*self._settings.values()])

    # What the entries are received by

    def take(self, stream: str, stamp_ns: int, item: Any) -> None:
        """Take an input, as ``Host`` does."""
        pipeline = self.pipeline
        pipeline.feed(stream, stamp_ns, item)
        if pipeline.order.jumped_back:
            pipeline.end_run()
            pipeline.restart()
        pipeline.limit_waiting()
        if stream == 'odometry' and stamp_ns == pipeline.order.newest_of(stream):
            self._locate(stamp_ns)

    def answer(self, stream: str, item: Any) -> None:
        """Take an answer."""
        self.pipeline.feed(stream, NOW, item)

    def command(self, command: Command, stamp_ns: int = NOW) -> None:
        """Take a command."""
        if isinstance(command, Hint):
            self._is_first = False  # the log has the new session before it
        if isinstance(command, Setting):
            self._settings[type(command), command.stage] = command
        self.pipeline.command(command, stamp_ns)

    def finish(self) -> None:
        """Process the inputs that wait."""
        self.pipeline.finish()

    def set_patient(self, is_patient: bool) -> None:
        """Let inputs wait longer for others, or not."""
        self.pipeline.set_patient(is_patient)

    def set_values(self, section: str, values: Mapping[str, Value]) -> None:
        """Set parameters of a part."""
        self.config = self.config.with_values(values)
        stamp_ns = self.pipeline.command(Configure(self.config))
        record = self._records[section]
        record += [[stamp_ns, key, value] for key, value in values.items()]
        del record[:-MAX_CHANGES]

    def replaced(self, data: bytes) -> None:
        """Replace the memory of a part."""
        self._restore_part(*loaded_state(self._run.folder, data))

    # The stream

    def _before(self, stamp_ns: int, item: Any) -> None:
        is_first, self._is_first = self._is_first, False
        cut_ns = self._beginning.cut_ns
        max_gap_ns = round(1e9 * self.config.inputs.max_odom_gap_s)
        if is_first and cut_ns is not None and begins_session(
            stamp_ns, cut_ns, max_gap_ns, self._beginning.was_interrupted
        ):
            self.pipeline.obey(NewSession())

    def _obeyed(self, stamp_ns: int, command: Command) -> None:
        if isinstance(command, Reset):
            for part, record in self._records.items():
                if concerns(command, part):
                    record.clear()
            if concerns(command, 'experience_map'):
                self.action_ns = 0

    def _moved(self, stamp_ns: int, step: OdometryStep) -> None:
        if 'odometry' not in self.pipeline.inputs:
            self._locate(stamp_ns)

    def _locate(self, stamp_ns: int) -> None:
        paused = self._settings.get((SetPaused, 'experience_map'))
        if not (isinstance(paused, SetPaused) and paused.paused):
            self.live_poses.append(tum_line(stamp_ns, self.slam.pose))

    def _updated(self, stamp_ns: int, step: MapStep) -> None:
        if step.action.template_id != NO_TEMPLATE:
            self.action_ns = stamp_ns

    def _answered(self, stamp_ns: int, answer: Answer) -> None:
        if self.slam.relocator is not None:
            self._answers.append(encode(RelocationPayload.of(stamp_ns, *answer)))

    # The state that the run began from

    def _restore(self, states: Mapping[str, State]) -> None:
        beginning = self._beginning
        for part in beginning.parts:
            if part not in states:
                continue
            state = states[part]
            self._restore_part(part, state)
            if beginning.is_resumed:
                record = [*self._records[part]]
                if record:
                    self.set_values(part, {str(key): value for _, key, value in record})
                self._records[part] = record
                for setting in state.get('settings', ()):
                    self.command(command_from_state(setting))
        for setting in beginning.settings:
            self.command(command_from_state(setting))
        inputs = states.get(beginning.parts[0], {}).get('inputs', {})
        if beginning.is_resumed and inputs.get('streams') == list(self.pipeline.inputs):
            self.pipeline.restore_inputs(inputs, lambda item: decode_item(item.tobytes()))
            self.pipeline.go_on()

    def _restore_part(self, part: str, state: State) -> None:
        self.pipeline.restore_stage(part, state)
        self._records[part] = [list(change) for change in state.get('parameters_set', ())]
        if part == 'experience_map':
            self.action_ns = int(state.get('action_ns', 0))
            self._answers.clear()
            if self.slam.relocator is not None:
                self._answers.extend(state.get('answers', ()))


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
    automatic = replay.config.local_view.vt_match_threshold == AUTOMATIC
    results = Results(folder, with_thresholds=automatic)
    try:
        has_ended = replay.run(results)
        states = replay.states()
        results.write(LIVE_NAME, ''.join(replay.live_poses))
        counts = replay.slam.counts
        summary = {
            'frames': results.frames, 'odometry': results.odometry,
            'templates': results.templates, 'experiences': len(replay.slam.experience_map),
            'links': replay.slam.experience_map.link_count,
            'loop_closures': results.closures.count, 'late': counts.late,
            'refused': counts.refused,
            'log': {'map': str(map_file), **run.described()},
        }  # fmt: skip
        results.last_view_ns = replay.action_ns
        results.finish(replay.slam.experience_map, replay.config, summary)
    except BaseException:
        results.discard()
        raise
    saved = read_map(map_file)
    goals = saved.states.get('experience_map', {}).get('goals', {})
    if isinstance(goals, dict) and goals.get('queue'):  # navigation is not repeated
        states['experience_map']['goals']['queue'] = goals['queue']
    path = folder / MAP_NAME
    stamp_ns = replay.slam.newest_ns
    save_map(path, states, live_meta(run.beginning.configuration), Cut(0, stamp_ns))
    digests = read_map(path).digests
    differing = [part for part, one in digests.items() if saved.digests.get(part) != one]
    is_last = has_ended and saved.sessions[-1].ended
    plots = draw_all(folder, None, replay.config.local_view.vt_match_threshold)
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
            f'the logs of {map_file} are of nodes in processes of their own, each of which sorts '
            'its inputs by itself: such a run cannot be repeated exactly; map in one process '
            '(without --split)'
        )
    return mapping[-1]


def _check(run: KeptRun, beginning: Beginning) -> None:
    if beginning.own_stages:
        raise UnusableInput(
            f'the run in {run.folder} used {", ".join(beginning.own_stages)}; expected stages of '
            'this package only'
        )
    if beginning.version != package_version():
        raise UnusableInput(
            f'the run in {run.folder} is of ratslam_ros {beginning.version}; expected '
            f'{package_version()}, as other versions may give another map'
        )
