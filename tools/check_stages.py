#!/usr/bin/env python3
# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check that the stages give the same bytes in one pipeline and split into two, wherever.

Each split is fed with late messages, and saved and restored after every --save-every messages.
Among the messages are stamped commands of every kind, as of an operator. Each stage must also
write something, obey resets and the end of mapping, and return states that do not change later.

    tools/check_stages.py RECORDING...                       whole recordings: 20 s to minutes each
    tools/check_stages.py --duration 10 --save-every 1 RECORDING
    tools/check_stages.py --stage examples/custom_stage.py:HashView RECORDING
"""

from __future__ import annotations

import argparse
import random
import sys
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from state_digest import digest_of

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.saved import session_keys
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.pose_hint import PoseHint
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.event_inputs import recorded_inputs
from ratslam_ros.maps.chunks import OUTLINE, pack, unpack
from ratslam_ros.own_stages import add_stage, own_stages
from ratslam_ros.pipeline.commands import (
    Command,
    Configure,
    Hint,
    NamePlace,
    NewSession,
    Relocated,
    Reset,
    SearchPlace,
    SetBehaviour,
    SetFieldOfView,
    SetMapping,
    SetPaused,
)
from ratslam_ros.pipeline.landmark_map import LandmarkMapStage
from ratslam_ros.pipeline.pipeline import COMMAND, Follower, Passing, Pipeline
from ratslam_ros.pipeline.ratslam import RatSLAM, stages_from
from ratslam_ros.pipeline.stage import Stage
from ratslam_ros.recordings import open_recording

LATENESS_NS = 2_000_000_000
ALWAYS = {'template', 'action', 'pose', 'update'}
"""Streams that every recording with images has."""

Message = tuple[str, int, Any]
"""Stream, stamp and item of an input or command."""


class Split:
    """A head with the first stages and a follower with the others, connected in memory."""

    def __init__(
        self, stages: Sequence[Stage], at: int, delays: random.Random | None = None
    ) -> None:
        """Connect the stages.

        Args:
            stages: all stages, with an empty memory.
            at: number of stages in the head; all of them: there is no follower.
            delays: chooses how many messages are on the way to the follower and back; None: none.
        """
        self.forward: deque[Message] = deque()
        self.back: deque[Message] = deque()
        self._delays = delays
        self._follower = Follower(stages[at:], LATENESS_NS) if at < len(stages) else None
        passing = None
        if self._follower is not None:
            passing = Passing(self._follower.inputs, lambda *one: self.forward.append(one))
        self._head = Pipeline(stages[:at], LATENESS_NS, passing=passing)
        self.written: dict[str, list[str]] = defaultdict(list)
        """Texts of the items that the stages have written, by stream."""
        for pipeline in self._pipelines:
            for stage in pipeline.stages.values():
                for stream in stage.WRITES:
                    pipeline.observe(stream, partial(self._note, stream))
        if self._follower is not None:
            for stream in self._head.answers:
                self._follower.observe(stream, partial(self._answer, stream))

    @property
    def _pipelines(self) -> list[Pipeline]:
        return [self._head] + ([] if self._follower is None else [self._follower])

    def _note(self, stream: str, stamp_ns: int, item: Any) -> None:
        self.written[stream].append(f'{stamp_ns} {item}')

    def _answer(self, stream: str, stamp_ns: int, item: Any) -> None:
        self.back.append((stream, stamp_ns, item))

    def feed(self, stream: str, stamp_ns: int, item: Any) -> None:
        """Feed an input or a command, and deliver some of the messages between the pipelines."""
        self._head.feed(stream, stamp_ns, item)
        self._deliver(self._delays)

    def _deliver(self, delays: random.Random | None = None) -> None:
        while self.forward or self.back:
            if delays is not None and delays.random() < 0.3:
                return
            if self.back and (not self.forward or (delays is not None and delays.random() < 0.5)):
                self._head.feed(*self.back.popleft())
            else:
                assert self._follower is not None
                self._follower.feed(*self.forward.popleft())

    def finish(self) -> None:
        """Process all messages."""
        self._deliver()
        self._head.finish()
        self._deliver()

    def states(self) -> dict[str, State]:
        """Return the states of the stages."""
        return {
            name: pipeline.state_of(name)
            for pipeline in self._pipelines for name in pipeline.stages
        }

    def continued_by(self, other: Split) -> Split:
        """Return another split that continues from the state of this one, as from a file."""
        for old, new in zip(self._pipelines, other._pipelines, strict=True):
            saved = {part: as_from_file(state) for part, state in old.state().items()}
            assert new.restore(saved), 'the inputs were not restored'
            for part, state in new.state().items():
                assert digest_of(state) == digest_of(saved[part]), f'{part} was not restored'
        other.forward, other.back, other.written = self.forward, self.back, self.written
        return other


def as_from_file(state: State) -> State:
    """Return a state as it is read from a map file."""
    arrays = pack(state)
    return unpack(arrays[OUTLINE].tobytes(), lambda path, kind, shape: arrays[path])


def shuffled(messages: Sequence[Message], chance: random.Random) -> list[Message]:
    """Return messages in an order in which they may arrive: each stream keeps its own order."""
    arrivals: list[tuple[int, int]] = []
    latest_ns: dict[str, int] = defaultdict(int)
    for number, (stream, stamp_ns, _) in enumerate(messages):
        delay_ns = 0 if stream == COMMAND else chance.randrange(LATENESS_NS * 9 // 10)
        latest_ns[stream] = max(latest_ns[stream], stamp_ns + delay_ns)
        arrivals.append((latest_ns[stream], number))
    return [messages[number] for _, number in sorted(arrivals)]


def run(
    new_stages: Callable[[], Sequence[Stage]], messages: Sequence[Message], at: int,
    delays: random.Random | None = None, save_every: int | None = None,
) -> Split:
    """Run the stages on messages.

    Args:
        new_stages: returns the stages with an empty memory.
        messages: inputs and commands in the order of their arrival.
        at, delays: see ``Split``.
        save_every: number of messages after which all is saved, and continued by new stages; None:
            never.
    """
    split = Split(new_stages(), at, delays)
    for number, message in enumerate(messages, 1):
        split.feed(*message)
        if save_every is not None and number % save_every == 0:
            split = split.continued_by(Split(new_stages(), at, delays))
    split.finish()
    return split


def differences(
    new_stages: Callable[[], Sequence[Stage]], messages: Sequence[Message], save_every: int
) -> Iterator[str]:
    """Yield what differs between one pipeline and each split with late messages and restarts.

    Args:
        new_stages: returns the stages with an empty memory.
        messages: inputs and commands in the order of their stamps; commands before inputs.
        save_every: number of messages after which all is saved and restored.
    """
    count = len(new_stages())
    expected = run(new_stages, messages, count)
    states = {name: digest_of(state) for name, state in expected.states().items()}
    for at in range(1, count + 1):
        chance = random.Random(at)
        found = run(new_stages, shuffled(messages, chance), at, chance, save_every)
        split = ' '.join('| ' * (n == at) + stage.NAME for n, stage in enumerate(new_stages()))
        for stream in sorted(expected.written.keys() | found.written.keys()):
            if found.written[stream] != expected.written[stream]:
                yield f'{split}: items of {stream}'
        for name, state in found.states().items():
            if digest_of(state) != states[name]:
                yield f'{split}: state of {name}'


def broken_rules(
    new_stages: Callable[[], Sequence[Stage]], messages: Sequence[Message]
) -> Iterator[str]:
    """Yield which rules of ``Stage`` are broken, in one pipeline.

    Args:
        new_stages: returns the stages with an empty memory.
        messages: inputs and commands in the order of their stamps.
    """
    stages = new_stages()
    split = Split(stages, len(stages))
    half = len(messages) // 2
    for message in messages[:half]:
        split.feed(*message)
    kept = split.states()
    digests = {name: digest_of(state) for name, state in kept.items()}
    for message in messages[half:]:
        split.feed(*message)
    split.finish()
    for name, digest in digests.items():
        if digest_of(kept[name]) != digest:
            yield f'{name}: a state that it had returned has changed later'
    for stage in stages:
        if COMMAND not in stage.readers():
            yield f'{stage.NAME}: it reads no command'
        for stream in ALWAYS & {*stage.WRITES}:
            if not split.written[stream]:
                yield f'{stage.NAME}: it has written nothing to {stream}'
    end_ns = max(stamp_ns for _, stamp_ns, _ in messages)
    split.feed(COMMAND, end_ns + 1, SetMapping(False))
    count = len(split.written['template'])
    for stream, stamp_ns, item in messages:
        if stream == 'image' and item is not None:
            unknown = PreparedImage(np.ascontiguousarray(255 - item.pixels[::-1]))
            split.feed(stream, end_ns + stamp_ns, unknown)
    split.finish()
    if any('is_new=True' in text for text in split.written['template'][count:]):
        yield 'local_view: it learns templates although mapping is off'
    split.feed(COMMAND, 0, Reset())
    fresh = Split(new_stages(), len(stages))
    for stream, stamp_ns, item in messages:
        if stream == COMMAND and isinstance(item, Configure | SetBehaviour):
            fresh.feed(COMMAND, stamp_ns, item)
    fresh.feed(COMMAND, 0, SetMapping(False))
    fresh.finish()
    of_session = {stage.NAME: session_keys(stage) for stage in stages}
    for name, state in fresh.states().items():
        memory, expected = (
            {key: value for key, value in one.items() if key not in of_session[name]}
            for one in (split.states()[name], state)
        )
        if digest_of(memory) != digest_of(expected):
            yield f'{name}: a reset does not empty its memory'


def stages_of(
    config: Config, head: str = 'local_view', own: Sequence[type[Stage]] = ()
) -> Callable[[], Sequence[Stage]]:
    """Return what creates all stages from the one that takes the inputs on."""
    kinds = (*stages_from(head, own), LandmarkMapStage)
    return lambda: [kind(config) for kind in kinds]


def messages_of(path: Path, duration_s: float | None) -> tuple[str, list[Message]]:
    """Return the first stage that a recording needs, and its messages in the order of stamps.

    Commands are among them.
    """
    with open_recording(path) as recording:
        messages = [*recorded_inputs(recording, RatSLAM(), duration_s=duration_s)]
    has_odometry = any(stream == 'odometry' for stream, _, _ in messages)
    return 'local_view' if has_odometry else 'visual_odometry', with_commands(
        sorted(messages, key=lambda message: message[1])
    )


def with_commands(messages: Sequence[Message]) -> list[Message]:
    """Return messages with commands among them, at stamps that are spread evenly."""
    config = Config()
    orders: list[Command] = [
        SetMapping(False), SetBehaviour('wall'), SetMapping(True), NamePlace('dock'),
        Configure(config.with_values({'pose_cells.pc_vt_inject_energy': 0.3})), Reset(),
        SetPaused(True, 'pose_cells'), SetPaused(False, 'pose_cells'), Relocated('pose_cells'),
        Hint(PoseHint(Pose(1.0, 2.0, 0.5), 1.0, 0.0, 1.0, 0.1)), SearchPlace(), NewSession(),
        SetFieldOfView(70.0),
    ]
    found = list(messages)
    for number, command in reversed([*enumerate(orders, 1)]):
        stamp_ns = messages[number * len(messages) // (len(orders) + 1)][1]
        before = next(n for n, one in enumerate(found) if one[1] >= stamp_ns)
        found.insert(before, (COMMAND, stamp_ns, command))
    return found


def main() -> int:
    """Check all given recordings; return 1 if results differ."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').partition('\n')[0])
    parser.add_argument('recordings', nargs='+', type=Path, metavar='RECORDING')
    parser.add_argument('--duration', type=float, help='seconds of each recording')
    parser.add_argument('--save-every', type=int, default=100, metavar='N')
    add_stage(parser)
    options = parser.parse_args()
    failed = 0
    for path in options.recordings:
        head, messages = messages_of(path, options.duration)
        stages = stages_of(Config(), head, own_stages(options.own_stages))
        found = 0
        texts = chain(
            broken_rules(stages, messages), differences(stages, messages, options.save_every)
        )
        for text in texts:
            found = failed = 1
            print(f'{path}: {text}', flush=True)
        print(f'{path}: {len(messages)} messages, {"differences" if found else "no difference"}')
    return failed


if __name__ == '__main__':
    sys.exit(main())
