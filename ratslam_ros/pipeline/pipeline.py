# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pipeline: feeds the stages with one stream of inputs, in the order of their stamps."""

from __future__ import annotations

from bisect import insort
from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.saved import session_keys
from ratslam_ros.core.common.state import STAGE, State
from ratslam_ros.core.config import Config
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.pipeline.codec import (
    command_from_state,
    command_state,
    item_from_state,
    item_state,
)
from ratslam_ros.pipeline.commands import (
    NOW,
    Command,
    Configure,
    ReportBehaviour,
    Reset,
    SetBehaviour,
    SetMapping,
    SetPaused,
    concerns,
)
from ratslam_ros.pipeline.order import GivenOrder, Released, StampOrder
from ratslam_ros.pipeline.stage import (
    NAME,
    Awaiting,
    Output,
    Preparing,
    Reader,
    Stage,
    own_class,
    saved_state,
)
from ratslam_ros.pipeline.streams import STREAMS, Stream

COMMAND = 'command'
"""Name of the stream of commands, which every stage may read."""

ALL = 2**62
"""Number of items that need not wait for an answer if none is waited for."""

ANSWERED_NS = 30_000_000_000
"""Longest time, in stamps, to wait for an answer of a follower, which may be restarted."""

Observer = Callable[[int, Any], None]
"""Takes the stamp and the item of a stream."""
Stopwatch = Callable[[str], AbstractContextManager[object]]


class Passing(NamedTuple):
    """What passes items on to a follower, after all stages and what they have made of them.

    streams: those that the follower may read; commands are passed on, too. send: takes stream,
    stamp and item, and lets the follower feed them in this order.
    """

    streams: Sequence[str]
    send: Callable[[str, int, Any], None]


class Pipeline:
    """The head of a chain of stages: sorts the inputs by stamp, and runs the stages on them.

    The order is decided once, here. Whatever follows - a stage, an observer, a follower in another
    process - sees one stream in one order, in which nothing is late.
    """

    def __init__(
        self, stages: Sequence[Stage], max_lateness_ns: int, stopwatch: Stopwatch | None = None,
        streams: Sequence[Stream] = STREAMS, passing: Passing | None = None,
    ) -> None:
        """Connect stages that have an empty memory.

        Args:
            stages: the stages, in the direction of flow.
            max_lateness_ns: longest time for which an input waits for others, in stamps.
            stopwatch: takes the name of a stage and stream, such as `pose_cells.template`, and
                returns a context manager that is entered around each step.
            streams: the streams that may occur, in their order at equal stamps.
            passing: passes items on to a follower; None if there is none.
        """
        self.stages: dict[str, Stage] = {stage.NAME: stage for stage in stages}
        """The stages by name."""
        names = dict.fromkeys(one.name for one in (*streams, *STREAMS))
        for stage in stages:
            _check(stage, names)
        self._observers: dict[str, list[Observer]] = {}
        self._readers = _readers(stages)
        self._passing, passed = passing, () if passing is None else passing.streams
        self._stopwatch = stopwatch
        self._preparing = [stage for stage in stages if isinstance(stage, Preparing)]
        self._all_prepare = all(
            isinstance(stage, Preparing) for stage, *_ in self._readers.get('image', ())
        )
        written = {stream for stage in stages for stream in stage.WRITES}
        used = {*self._readers, *passed} - written
        outside = [one for one in streams if one.name in used]
        self.inputs = tuple(one.name for one in outside if not one.answers)
        """Names of the streams that come from outside, in their order at equal stamps."""
        self.answers = tuple(one.name for one in outside if one.answers)
        """Names of the streams of answers that come from outside."""
        self._awaits = {
            one.answers: stage.awaits_answer for one in outside if one.answers
            for stage, _, _ in self._readers[one.name]
            if isinstance(stage, Awaiting)
        }
        for stage in stages:
            if passing is not None and isinstance(stage, Awaiting):
                stage.expect_answers()
        regular = [one.name for one in outside if one.is_regular and one.name != self.inputs[-1]]
        self._regular = regular[0] if regular else None
        self.max_lateness_ns = max_lateness_ns
        self._longest_wait_ns = max(max_lateness_ns, 0 if passing is None else ANSWERED_NS)
        self.order = self._new_order()
        self._released: deque[tuple[int, str, Any]] = deque()
        self._current: tuple[int, str, Any] | None = None
        """The item that is processed."""
        self._commands: list[tuple[int, Command]] = []
        self._paused: set[str] = set()
        self._passes = 0
        """Number of items that need not wait for an answer."""
        self._settings: dict[tuple[type[Command], str], Command] = {}
        """Commands that are in effect until another one with the same key, in their order."""
        self._unused: dict[str, State] = {}
        """Items of the restored states that only other programs use."""
        self._is_running = False
        self._stamp_ns = NOW
        """Stamp of the input or command that is processed."""

    def observe(self, stream: str, observer: Observer) -> None:
        """Call a function with each item of a stream before, or each command after, it is read."""
        self._observers.setdefault(stream, []).append(observer)

    @property
    def wants_colour(self) -> bool:
        """Whether a stage uses the colour of images."""
        return any(getattr(stage, 'wants_colour', False) for stage in self.stages.values())

    def prepare(
        self, pixels: NDArray[np.uint8], colour: NDArray[np.uint8] | None = None
    ) -> PreparedImage:
        """Compute what depends on one image alone; another thread may do so for later images.

        Args:
            pixels: (H, W) grey levels, 0 to 255.
            colour: (H, W, 3) uint8 in BGR order, used if ``wants_colour``.
        """
        image, has_all = PreparedImage(pixels, colour=colour), self._all_prepare
        for stage in self._preparing:
            before = image
            # If a window does not fit, the stage reports it when it gets the image.
            with suppress(UnusableParameter):
                image = stage.prepare(image)
            has_all = has_all and image is not before
        return replace(image, has_all=True) if has_all else image

    def feed(self, stream: str, stamp_ns: int, item: Any) -> None:
        """Take one input; process it, and all others that need not wait any longer.

        An observer may feed commands: they take effect after the step that it observes.

        Args:
            stream: one of ``inputs``, the name of a stream of answers, or `command`.
            stamp_ns: stamp of the input; for a command, see commands.py.
            item: the item, of the class that the table of streams names.
        """
        if stream == COMMAND:
            self._place(item, stamp_ns)
        elif stream in self.answers:
            self._released.appendleft((stamp_ns, stream, item))
        else:
            self._extend(self.order.push(stream, stamp_ns, item))
        self.go_on()

    def command(self, command: Command, stamp_ns: int = NOW) -> int:
        """Take a command; return the stamp at which it takes effect (commands.py)."""
        stamp_ns = self._place(command, stamp_ns)
        self.go_on()
        return stamp_ns

    def finish(self) -> None:
        """Process all inputs and commands that wait: none is expected before them."""
        self._passes = ALL
        self._extend(self.order.flush())
        waiting, self._commands = self._commands, []
        for _, command in waiting:
            self._place(command, NOW)
        self.go_on()

    def obey(self, command: Command) -> None:
        """Carry out a command at this point of the stream: before the item that is observed."""
        self._run(COMMAND, self._stamp_ns, command)

    def restart(self) -> None:
        """Continue from the earlier time to which the stamps have jumped back.

        Held inputs are dropped; call ``finish`` first to process them.
        """
        self._drop_waiting()
        self._extend(self.order.restart())
        self.go_on()

    def limit_waiting(self) -> int:
        """Wait for answers for a limited time; return how many were not waited for."""
        number, waiting = 0, self._released
        while waiting and waiting[-1][0] - waiting[0][0] > self._longest_wait_ns:
            self.go_on_unanswered()
            number += 1
        return number

    def begin_inputs(self) -> None:
        """Drop all inputs, and commands of later stamps; stamps may begin anywhere."""
        self._drop_waiting()
        self.order = self._new_order()
        self.go_on()

    def _drop_waiting(self) -> None:
        """Drop what waits, but the commands whose stamps have been reached."""
        reached = [one for one in self._released if one[1] == COMMAND]
        self._released.clear()
        self._released.extend(reached)
        self._commands.clear()

    def waiting(self, stream: str) -> list[Any]:
        """Return the items of an input that wait for others, in order."""
        held = self.order.held_of(stream) if stream in self.inputs else []
        return [item for _, item in held]

    def move_to(self, other: Pipeline) -> None:
        """Let another pipeline continue that has the inputs of this one, and further stages.

        It gets the inputs that wait here, and the commands that are in effect.
        """
        for command in self._settings.values():
            other.obey(command)
        for stream in self.inputs:
            for stamp_ns, item in self.order.held_of(stream):
                if stream in other.inputs:
                    other.feed(stream, stamp_ns, item)
        for stamp_ns, command in self._commands:
            other.command(command, stamp_ns)

    @property
    def waiting_ns(self) -> int | None:
        """Stamp of the item that waits for an answer, None if none waits."""
        return self._released[0][0] if self._released else None

    def go_on_unanswered(self) -> None:
        """Process the item that waits for its answer, and all up to the next that waits."""
        self._passes = 1
        self.go_on()

    def _place(self, command: Command, stamp_ns: int) -> int:
        if stamp_ns <= self.order.next_ns:
            stamp_ns = self.order.end_stamp()
            self._released.append((stamp_ns, COMMAND, command))
        else:
            insort(self._commands, (stamp_ns, command), key=lambda waiting: waiting[0])
        return stamp_ns

    def _extend(self, released: Iterable[Released[Any]]) -> None:
        for one in released:
            while self._commands and self._commands[0][0] <= one.at_ns:
                at_ns, command = self._commands.pop(0)
                self._released.append((at_ns, COMMAND, command))
            self._released.append((one.stamp_ns, one.stream, one.item))

    def _new_order(self) -> StampOrder[Any]:
        return StampOrder(self.inputs, self.max_lateness_ns, self._regular)

    def go_on(self) -> None:
        """Process what need not wait any longer."""
        if self._is_running:
            return
        self._is_running = True
        try:
            released, awaits = self._released, self._awaits
            while released:
                stamp_ns, stream, item = released[0]
                passes = stream in awaits and awaits[stream]()
                if passes and not self._passes:
                    return
                self._current = released.popleft()
                self._stamp_ns = stamp_ns
                self._run(stream, stamp_ns, item)
                self._current = None
                self._passes -= passes
            self._passes = 0
        finally:
            self._is_running, self._current = False, None

    def _run(self, stream: str, stamp_ns: int, item: Any) -> None:
        if stream != COMMAND:
            self.notify(stream, stamp_ns, item)
        for stage, step, reader in self._readers.get(stream, ()):
            if stream == COMMAND:
                if not concerns(item, stage.NAME):
                    continue
            elif stage.NAME in self._paused and stream not in self.answers:
                continue
            if self._stopwatch is None:
                outputs = reader(stamp_ns, item)
            else:
                with self._stopwatch(step):
                    outputs = reader(stamp_ns, item)
            for output in outputs or ():
                if not isinstance(output, Output) or output.stream not in stage.WRITES:
                    raise UnusableParameter(
                        f'stage {stage.NAME} has written {output!r} on reading {stream}; expected '
                        f'a list of Output with streams of its WRITES, {stage.WRITES}'
                    )
                self._run(*output)
        if self._passing is not None and stream in (COMMAND, *self._passing.streams):
            self._passing.send(stream, stamp_ns, item)
        if stream == COMMAND:
            self._obey(item)
            self.notify(stream, stamp_ns, item)

    def notify(self, stream: str, stamp_ns: int, item: Any) -> None:
        """Show an item to the observers of its stream, but to no stage."""
        for observer in self._observers.get(stream, ()):
            observer(stamp_ns, item)

    def _obey(self, command: Command) -> None:
        """Carry out what a command asks of the pipeline itself."""
        if isinstance(command, Configure | SetMapping | SetPaused | SetBehaviour):
            key = type(command), getattr(command, 'stage', '')
            self._settings.pop(key, None)
            self._settings[key] = command
        if isinstance(command, ReportBehaviour):
            self._settings.pop((SetBehaviour, ''), None)  # A report replaces it, and expires.
        elif isinstance(command, SetPaused):
            (self._paused.add if command.paused else self._paused.discard)(command.stage)
        elif isinstance(command, Reset):
            for name in [name for name in self._unused if concerns(command, name)]:
                del self._unused[name]

    def state(self) -> dict[str, State]:
        """Return everything, for ``restore``: a state for each stage, and one for the inputs."""
        settings = [command_state(command) for command in self._settings.values()]
        return {
            **{name: self.state_of(name) for name in self.stages},
            'inputs': {
                **self.inputs_state(), **({'settings': settings} if settings else {}),
            },
        }

    def inputs_state(self) -> State:
        """Return the inputs and commands that wait, for ``restore_inputs``.

        An observer of an input may call it: this input is among them, as no stage has read it.
        """
        released = [*([] if self._current is None else [self._current]), *self._released]
        return {
            'streams': list(self.inputs), 'order': self.order.state(),
            'released': [
                [stamp_ns, stream, item_state(item)] for stamp_ns, stream, item in released
            ],
            'commands': [
                [stamp_ns, command_state(command)] for stamp_ns, command in self._commands
            ],
            **({'passes': self._passes} if self._passes else {}),
        }

    def restore(self, states: dict[str, State]) -> bool:
        """Restore what ``state`` returned; the stages must have an empty memory.

        Returns:
            Whether the inputs were restored, too. Otherwise they were saved with other streams, or
            by another program: feed the command ``NewSession``.
        """
        inputs = states.get('inputs', {})
        has_inputs = inputs.get('streams') == list(self.inputs)
        if has_inputs:
            for command in inputs.get('settings', ()):
                self.obey(command_from_state(command))
        for name, state in states.items():
            if name in self.stages or STAGE in state:
                self.restore_stage(name, state)
        if has_inputs:
            self.restore_inputs(inputs)
        return bool(has_inputs)

    def restore_inputs(self, inputs: State) -> None:
        """Restore what ``inputs_state`` returned; the inputs must be the same.

        Call ``go_on`` before the next input: what was to be processed at once still waits.
        """
        self.order.restore(inputs['order'])
        self._released = deque(
            (stamp_ns, stream, item_from_state(item))
            for stamp_ns, stream, item in inputs['released']
        )
        self._commands = [
            (stamp_ns, command_from_state(command)) for stamp_ns, command in inputs['commands']
        ]
        self._passes = int(inputs.get('passes', 0))

    def restore_stage(self, name: str, state: State) -> None:
        """Empty and restore a stage; the rest of the state is kept for ``state_of``.

        Raises:
            UnusableInput: the state is that of another stage of the user, or of none.
        """
        stage, saved_by = self.stages.get(name), state.get(STAGE, '')
        own = '' if stage is None else own_class(stage)
        if stage is None or saved_by != own:
            raise UnusableInput(
                f'{name} was saved by a stage {saved_by} of a user, which is not given: give '
                f'--stage FILE:{saved_by}, or the class as one of stages='
                if saved_by else f'{name} was saved by the stage of this package, not by {own}: '
                'leave this stage out, or choose another map'
            )
        for owner, _, reader in self._readers.get(COMMAND, ()):
            if owner is stage:
                reader(self._stamp_ns, Reset(name))
        stage.restore(state['state'] if saved_by else state)
        known = saved_state(stage).keys() | session_keys(stage)
        self._unused[name] = {key: value for key, value in state.items() if key not in known}

    def state_of(self, name: str) -> State:
        """Return the state of one stage, and what other programs have saved with it."""
        state = saved_state(self.stages[name])
        # After it, so that interruptions do not change the order, and with it the digest.
        others = self._unused.get(name, {})
        return {**state, **{key: others[key] for key in others if key not in state}}


class Follower(Pipeline):
    """Stages behind the head: their inputs are in order already, and nothing can be late.

    The pipeline before it has ``Passing``. Answers flow back: the follower is observed for the
    ``answers`` of that pipeline, which are fed to it.
    """

    def _new_order(self) -> StampOrder[Any]:
        return GivenOrder(self.inputs, self.max_lateness_ns)


def lateness_ns(config: Config) -> int:
    """Return how long inputs wait for others."""
    return round(1e9 * config.inputs.max_lateness_s)


def _check(stage: Stage, streams: Collection[str]) -> None:
    """Check the name of a stage, and those of the streams that it writes."""
    if not NAME.fullmatch(stage.NAME):
        raise UnusableParameter(
            f'the NAME is {stage.NAME!r} of the stage {type(stage).__name__}; expected '
            'lower-case letters, digits and underscores, up to 40, and not "inputs"'
        )
    for stream in stage.WRITES:
        if stream not in streams:
            raise UnusableParameter(
                f'stage {stage.NAME} writes {stream!r}, which is no stream (WRITES); '
                f'expected some of {", ".join(streams)}: add it to pipeline/streams.py'
            )


def _readers(stages: Iterable[Stage]) -> dict[str, tuple[tuple[Any, str, Reader], ...]]:
    """Return stage, step and reader of each reader of a stream, in flow direction."""
    readers: dict[str, tuple[tuple[Any, str, Reader], ...]] = {}
    for stage in stages:
        for stream, reader in stage.readers().items():
            one = stage, f'{stage.NAME}.{stream}', reader
            readers[stream] = (*readers.get(stream, ()), one)
    return readers
