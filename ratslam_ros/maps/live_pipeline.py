# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pipeline of a live process, with a write-ahead log: what it receives can be repeated.

A process that was killed receives its log again (ros/host_map.py), and a replay repeats a whole
run from a log that was kept (offline/replay_log.py). Both give the same states, byte for byte.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from ratslam_ros.chain import ALONE, Chain
from ratslam_ros.core.common.scan import scan_stream
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config, Value
from ratslam_ros.core.config.experience_map import MAX_LASERS
from ratslam_ros.core.pose_cells.map_relocation import ADOPTION_DELAY
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.maps.input_log import Entry
from ratslam_ros.maps.kept_log import PASSED, Beginning, loaded_state
from ratslam_ros.maps.saved_map import Cut
from ratslam_ros.messages.commands import PassedItem
from ratslam_ros.messages.json_schema import Stamp, decode, encode
from ratslam_ros.messages.mapping import RelocationPayload
from ratslam_ros.pipeline.codec import command_from_state, command_state, decode_item, encode_item
from ratslam_ros.pipeline.commands import (
    NOW,
    Command,
    Configure,
    Hint,
    NewSession,
    Relocated,
    Reset,
    SetMapping,
    SetPaused,
    UseOdometry,
    concerns,
)
from ratslam_ros.pipeline.continuity import LATE_NS, begins_session
from ratslam_ros.pipeline.experience_map import ExperienceMapStage
from ratslam_ros.pipeline.items import Answer, NumberedAction, Template
from ratslam_ros.pipeline.pipeline import (
    COMMAND,
    Follower,
    Passing,
    Pipeline,
    Stopwatch,
    lateness_ns,
)
from ratslam_ros.pipeline.stage import Stage
from ratslam_ros.pipeline.streams import STREAMS, Stream

FINISH, PARAMETERS, REPLACED, RUN = 'finish', '_parameters', 'replaced', 'run'
"""Entries of the log that are no items: held inputs were processed; with the name of a part before
it, parameters were set; the memory of a part was replaced (kept_log.py); a run of numbers has
begun."""

CUT, MAX_CUT = 'cut', 2**62
"""Name by which a cut is passed on, and limit of its number."""

MAX_CHANGES = 1000
"""Number of latest changes of parameters that are kept in the record of a part."""

ITEMS: dict[str, Any] = {
    **{one.name: one.item for one in STREAMS}, 'template': Template, COMMAND: Reset | Relocated,
}
"""Classes of the items of a followed stream."""

Setting = SetMapping | SetPaused | UseOdometry
"""Commands that are in effect until the next one for the same stage."""


class ParameterChange(NamedTuple):
    """A value that holds from a stamp on, see pipeline/commands.py; ``key``: section.name."""

    stamp_ns: int
    key: str
    value: Value

    def __str__(self) -> str:
        return f'{self.key} {self.value} from {self.stamp_ns * 1e-9:.3f} s'


class Process:
    """What surrounds a live pipeline. By default nothing, as in a replay of a log."""

    def log(self, stream: str, stamp_ns: int, data: Callable[[], bytes]) -> None:
        """Log what is received, before it is used."""

    def taken(self, stream: str, stamp_ns: int, unanswered: int) -> None:
        """React to an input, after which this many items were processed without their answers."""

    def passed(self, item: PassedItem) -> None:
        """Pass an item on to a follower."""

    def cut(self, cut: Cut) -> None:
        """Save the state, as the process that is followed has done after the same item."""

    def noted(self, text: str) -> None:
        """Report a past event."""

    def starts_over(self, stream: str) -> bool:
        """Return whether the memory is emptied, as the stamps of an input have jumped back."""
        return False

    def start_run(self) -> None:
        """Expect stamps that are earlier than the last ones."""

    def configured(self, part: str, values: Mapping[str, Value]) -> None:
        """React to parameters of a part that were set."""

    def restored(self, part: str) -> None:
        """React to another memory of a part."""

    def replaced(self, part: str, state: State) -> None:
        """React to a state by which the memory of a part was replaced."""


class LivePipeline:
    """A pipeline, the settings and parameters in effect, and the session that it continues."""

    def __init__(
        self, stages: Sequence[Stage], config: Config, process: Process, chain: Chain = ALONE,
        run: int = 0, stopwatch: Stopwatch | None = None, streams: Sequence[Stream] = STREAMS,
    ) -> None:
        """Start with an empty memory.

        In a process that is followed, all is passed on that another one may need behind the last
        stage.

        Args:
            stages: those of the process, which are the parts of the map.
            config: the parameters of the stages.
            process: what surrounds the pipeline.
            chain: the place of the process in a split.
            run: a new number for the run of the stream that is passed on, see ``PassedItem``.
            stopwatch: see ``Pipeline``.
            streams: those that may occur.
        """
        passing = None
        if chain.is_followed:
            lasers = range(MAX_LASERS if chain.follows else len(chain.scans))
            passed = 'odometry', *map(scan_stream, lasers), *stages[-1].WRITES
            passing = Passing(passed, self._pass_on)
        kind = Follower if chain.follows else Pipeline
        self.pipeline = pipeline = kind(stages, lateness_ns(config), stopwatch, streams, passing)
        self.config, self._process = config, process
        self.run, self._is_new_run, self._number = run if chain.is_followed else 0, True, 0
        """Run of the stream that is passed on, 0: none is; whether it is new; and last number."""
        self.followed = 0, 0
        """Run and number of the last item of the followed stream."""
        self.is_first = False
        """Whether the first input may belong to another session than the restored state."""
        self._beginning: Beginning | None = None
        self._kept = Path()
        self.settings: dict[tuple[type, str], Setting] = {}
        """The last command of each kind for each stage."""
        self.changes: dict[str, list[ParameterChange]] = {part: [] for part in pipeline.stages}
        """Parameters that were set while the present memory of a part was learned."""
        self.answers: deque[str] = deque(maxlen=ADOPTION_DELAY)
        """Answers that pose_cells may not have received if both are interrupted, as JSON."""
        for stream in pipeline.inputs:
            pipeline.observe(stream, self._before)
        pipeline.observe(COMMAND, self._obeyed)
        graph = pipeline.stages.get('experience_map')
        self.answers_all = isinstance(graph, ExperienceMapStage) and (
            isinstance(pipeline, Follower) or graph.relocator is not None
        )
        """Whether each action is answered: the pose cells then do not run ahead of the map."""
        if self.answers_all:
            pipeline.observe('relocation', self._answered)

    # What the process receives

    def feed(self, stream: str, stamp_ns: int, item: object) -> None:
        """Take an input, and process all that need not wait any longer."""
        self._process.log(stream, stamp_ns, lambda: encode_item(item))
        self.pipeline.feed(stream, stamp_ns, item)
        if self.pipeline.order.jumped_back:
            self._jump_back(self._process.starts_over(stream))
        self._process.taken(stream, stamp_ns, self.pipeline.limit_waiting())

    def _jump_back(self, starts_over: bool) -> None:
        """Continue from an earlier time, with an empty memory or not."""
        if starts_over:
            self.pipeline.obey(Reset())
        else:
            self.pipeline.finish()
            self.pipeline.command(Relocated())
        self._process.start_run()
        self.pipeline.restart()

    def follow(self, passed: PassedItem) -> None:
        """Take an item of the followed stream, unless it is a repetition.

        Raises:
            UnusableInput: its content is damaged, or of another stream.
        """
        run, number = self.followed
        if passed.stream == CUT:
            cut = _cut_of(passed)
            if passed.number == (number if passed.run == run else 0):  # nothing is missing
                self._process.cut(cut)
            return
        if passed.run == run and passed.number <= number:
            return
        stream, stamp_ns, item = passed.stream, passed.stamp.ns, decode_item(passed.item)
        if not isinstance(item, ITEMS.get(stream, object)):
            raise UnusableInput(f'an item of {stream} is {item!r:.100}')
        self._process.log(PASSED, stamp_ns, lambda: encode(passed).encode())
        self.followed = passed.run, passed.number
        order = self.pipeline.order
        newest_ns = order.newest_ns
        if passed.number > (number if passed.run == run else 0) + 1 and newest_ns is not None:
            self._process.noted(
                f'stream from {newest_ns * 1e-9:.3f} s to {stamp_ns * 1e-9:.3f} s is lost: this '
                'node was away for longer than it is kept'
            )
        if run not in (0, passed.run) and newest_ns is not None and (
            stamp_ns < newest_ns - LATE_NS
        ):
            self._jump_back(self._process.starts_over(stream))
        if stream == COMMAND:
            self._jump_back(isinstance(item, Reset))
        elif stream in self.pipeline.inputs:
            before_ns = order.newest_of(stream)
            if before_ns is None or stamp_ns > before_ns:  # another run may repeat items
                self.pipeline.feed(stream, stamp_ns, item)
            elif self.answers_all and isinstance(item, NumberedAction):
                # Pose cells that have lost their state wait for it.
                answer = Answer(item.number, None, item.memory_ns)
                self.pipeline.notify('relocation', stamp_ns, answer)
            self._process.taken(stream, stamp_ns, self.pipeline.limit_waiting())

    def _pass_on(self, stream: str, stamp_ns: int, item: object) -> None:
        """Number an item that the stages have processed, for a follower.

        Of commands, a follower obeys those that follow from the order of the inputs.
        """
        if stream != COMMAND or (isinstance(item, Reset | Relocated) and not item.stage):
            self._number += 1
            self._process.passed(PassedItem(
                self.run, self._number, stream, Stamp.of(stamp_ns), encode_item(item)
            ))

    def pass_cut(self, cut: Cut) -> None:
        """Let a follower save its state after the items that were passed on, and no others."""
        if self.run:
            self._process.passed(PassedItem(
                self.run, self._number, CUT, Stamp.of(cut.stamp_ns), b'%d' % cut.number
            ))

    def begin_run(self) -> None:
        """Log the run of the stream, unless it goes on with that of the restored state."""
        if self.run and self._is_new_run:
            self._is_new_run = False
            self._process.log(RUN, self.run, bytes)

    def answer(self, stream: str, item: object) -> None:
        """Take an item of a stream of answers."""
        self._process.log(stream, NOW, lambda: encode_item(item))
        self.pipeline.feed(stream, NOW, item)

    def command(self, command: Command, stamp_ns: int = NOW) -> None:
        """Let a command take effect at its stamp, in all stages; see commands.py."""
        if isinstance(command, Hint) and self.is_first:
            # The pose is one of the session that begins, although it has no input yet.
            self.command(NewSession())
        self._process.log(COMMAND, stamp_ns, lambda: encode_item(command))
        self.carry_out(command, stamp_ns)

    def carry_out(self, command: Command, stamp_ns: int = NOW) -> None:
        """Let a command take effect that is not logged: each start of the process repeats it."""
        if isinstance(command, NewSession):
            self.is_first = False
        if isinstance(command, Setting):
            self.settings[type(command), command.stage] = command
        self.pipeline.command(command, stamp_ns)

    def set_paused(self, part: str, is_paused: bool) -> None:
        """Let a stage skip its inputs, or process them again; the robot may be elsewhere then."""
        if is_paused == self.is_paused(part):
            return
        if is_paused and all(self.is_paused(one) for one in self.pipeline.stages if one != part):
            self.finish()  # nothing will be received that it could wait for
        self.command(SetPaused(is_paused, part))
        if not is_paused:
            self.command(Relocated(part))

    def is_paused(self, part: str) -> bool:
        """Return whether a stage skips its inputs now."""
        return self.settings.get((SetPaused, part)) == SetPaused(True, part)

    def is_mapping(self, part: str) -> bool:
        """Return whether a stage learns."""
        return self.settings.get((SetMapping, part)) != SetMapping(False, part)

    def finish(self) -> None:
        """Process the inputs that wait for others: none is expected before them."""
        self._process.log(FINISH, NOW, bytes)
        self.pipeline.finish()

    def set_values(self, part: str, values: Mapping[str, Value]) -> None:
        """Set parameters of a part, by ``section.name``; record those that change, and since when.

        Raises:
            UnusableParameter: a value cannot be set; none is.
        """
        present = self.config.flat()
        values = {
            key: value for key, value in values.items() if present.get(key, value) != value
        }
        if not values:
            return
        config = self.config.with_values(values)
        self._process.log(f'{part}{PARAMETERS}', NOW, lambda: json.dumps(values).encode())
        self.config = config
        stamp_ns = self.pipeline.command(Configure(config))
        changes = [ParameterChange(stamp_ns, key, value) for key, value in values.items()]
        self.changes[part] = [*self.changes[part], *changes][-MAX_CHANGES:]
        self._process.configured(part, values)

    def replace(self, part: str, state: State) -> None:
        """Continue with another memory of a part; raise and keep the present one if unfit."""
        before = self.state_of(part)
        try:
            self._restore(part, state)
        except BaseException:
            self._restore(part, before)
            raise
        self._process.replaced(part, state)

    def receive(self, entry: Entry) -> None:
        """Receive an entry of the log.

        Raises:
            UnusableInput: its item is damaged.
        """
        stream, stamp_ns, data = entry
        if stream in self.pipeline.inputs:
            self.feed(stream, stamp_ns, decode_item(data))
        elif stream in self.pipeline.answers:
            self.answer(stream, decode_item(data))
        elif stream == COMMAND:
            self.command(decode_item(data), stamp_ns)
        elif stream == FINISH:
            self.finish()
        elif stream == PASSED:
            self.follow(decode(PassedItem, data.decode()))
        elif stream == RUN:
            self.run, self._is_new_run, self._number = stamp_ns, False, 0
        elif stream == REPLACED:
            self.replace(*loaded_state(self._kept, data))
        elif stream.endswith(PARAMETERS):
            self.set_values(stream.removesuffix(PARAMETERS), json.loads(data))

    # The stream

    def _before(self, stamp_ns: int, item: object) -> None:
        """Begin a session if the first input does not follow the restored state."""
        is_first, self.is_first = self.is_first, False
        begun = self._beginning
        if not is_first or begun is None or begun.cut_ns is None:
            return
        max_gap_ns = round(1e9 * self.config.inputs.max_odom_gap_s)
        if begins_session(stamp_ns, begun.cut_ns, max_gap_ns, begun.was_interrupted):
            self.pipeline.obey(NewSession())

    def _obeyed(self, stamp_ns: int, command: Command) -> None:
        if isinstance(command, Reset):
            for part in self.changes:
                if concerns(command, part):
                    self.changes[part] = []

    def _answered(self, stamp_ns: int, answer: Answer) -> None:
        self.answers.append(encode(RelocationPayload.of(stamp_ns, *answer)))

    # States

    def state_of(self, part: str) -> State:
        """Return the memory of a part, and the parameters that were set while it was learned."""
        changes = self.changes[part]
        return {
            **self.pipeline.state_of(part),
            **({'answers': [*self.answers]} if part == 'experience_map' else {}),
            **({'parameters_set': [list(one) for one in changes]} if changes else {}),
        }

    def states(self) -> dict[str, State]:
        """Return the memories, and what a process that was interrupted needs besides."""
        states = {part: self.state_of(part) for part in self.pipeline.stages}
        for part, state in states.items():
            own = [command_state(one) for one in self.settings.values() if one.stage == part]
            if own:
                state['settings'] = own
        inputs = self.pipeline.inputs_state()
        if self.run:
            inputs['passed'] = [self.run, self._number]
        if isinstance(self.pipeline, Follower):
            inputs['followed'] = [*self.followed]
        next(iter(states.values()))['inputs'] = inputs
        return states

    def begin(self, beginning: Beginning, states: Mapping[str, State], kept: Path) -> None:
        """Continue from a state.

        Call ``Pipeline.go_on`` before the next input: what need not wait still does.

        Args:
            beginning: describes the state.
            states: of the parts, {} for an empty map.
            kept: the folder of the log if it is kept.

        Raises:
            UnusableInput: the states do not fit the parameters.
        """
        self._beginning, self._kept = beginning, kept
        self.is_first = beginning.is_first
        for part, stage in self.pipeline.stages.items():
            if part not in states:
                continue
            self.replace(part, states[part])
            if beginning.is_resumed:
                self._resume(part, states[part])
            if beginning.is_first and isinstance(stage, ExperienceMapStage):
                stage.lose_place()
        inputs = states.get(next(iter(self.pipeline.stages)), {}).get('inputs', {})
        is_follower = isinstance(self.pipeline, Follower) and not beginning.is_first
        if (beginning.is_resumed or is_follower) and (
            inputs.get('streams') == list(self.pipeline.inputs)
        ):
            self.pipeline.restore_inputs(inputs)
            run, number = inputs.get('followed', (0, 0))
            self.followed = run, number
            if beginning.is_resumed and self.run and 'passed' in inputs:
                self._is_new_run = False
                self.run, self._number = inputs['passed']

    def _resume(self, part: str, state: State) -> None:
        """Continue with the parameters and settings in effect when a state was saved."""
        changes = self.changes[part]
        values = {change.key: change.value for change in changes}
        with suppress(UnusableParameter):  # the process was started with others that exclude them
            self.config.check_change(self.config.with_values(values))
            self.set_values(part, values)
        self.changes[part] = changes
        for setting in state.get('settings', ()):
            self.command(command_from_state(setting))

    def _restore(self, part: str, state: State) -> None:
        changes = state.get('parameters_set', ())
        learned = {key: value for key, value in state.items() if key != 'parameters_set'}
        self.pipeline.restore_stage(part, learned)
        self.changes[part] = [
            ParameterChange(int(stamp_ns), str(key), value) for stamp_ns, key, value in changes
        ]
        if part == 'experience_map':
            self.answers.clear()
            if self.answers_all:
                self.answers.extend(state.get('answers', ()))
        self._process.restored(part)


def _cut_of(passed: PassedItem) -> Cut:
    """Return the cut that was passed on.

    Raises:
        UnusableInput: its number is damaged.
    """
    digits = passed.item
    if not (digits.isdigit() and len(digits) < 20 and int(digits) < MAX_CUT):
        raise UnusableInput(f'the number of a cut is {digits!r:.40}; expected less than 2**62')
    return Cut(int(digits), passed.stamp.ns)
