# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A live pipeline gives the same states again from its log, from any saved state on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from helpers import PERIOD_NS, START_NS, extended, picture, twist

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.state import State
from ratslam_ros.core.mapping.pose_hint import PoseHint
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.maps.chunks import digest_of
from ratslam_ros.maps.input_log import Entry
from ratslam_ros.maps.kept_log import Beginning
from ratslam_ros.maps.live_pipeline import LivePipeline, Process
from ratslam_ros.pipeline.commands import Hint, NamePlace, Reset, SetMapping
from ratslam_ros.pipeline.live_stages import LIVE_STAGES, Reporter
from ratslam_ros.pipeline.pipeline import Pipeline

PARTS = 'local_view', 'pose_cells', 'experience_map'
DECAY = 'pose_cells.vt_active_decay'
CONFIG = extended().with_values({
    'local_view.template_x_size': 16, 'local_view.template_y_size': 8,
    'local_view.vt_shift_match': 2, 'pose_cells.pc_cell_x_size': 0.5,
})  # fmt: skip


class Logging(Process):
    """Keeps what is logged, and the states before an entry."""

    def __init__(self, at: int = -1) -> None:
        self.entries: list[Entry] = []
        self.states: dict[str, State] = {}
        self.live: LivePipeline
        self._at = at

    def log(self, stream: str, stamp_ns: int, data: Callable[[], bytes]) -> None:
        if len(self.entries) == self._at:
            self.states = self.live.states()
        self.entries.append(Entry(stream, stamp_ns, data()))


def live(process: Process) -> LivePipeline:
    stages = [LIVE_STAGES[part](CONFIG, Reporter()) for part in PARTS]
    return LivePipeline(Pipeline(stages, 3 * PERIOD_NS), CONFIG, process)


def drive(to: LivePipeline, first: int, last: int, begin_ns: int = START_NS) -> None:
    """Drive on a circle of 15 images; some come late, and others do not come."""
    for n in range(first, last):
        stamp_ns = begin_ns + n * PERIOD_NS
        if n % 11 != 7:
            to.feed('odometry', stamp_ns, twist(stamp_ns, 4.0, 2.0))
        delayed_ns = stamp_ns - (n % 4) * PERIOD_NS
        to.feed('image', delayed_ns, PreparedImage(picture((n - n % 4) % 15)))


def run(to: LivePipeline) -> None:
    drive(to, 0, 20)
    to.set_values('pose_cells', {DECAY: 2.5})
    to.command(NamePlace('kitchen'))
    to.set_paused('local_view', True)
    drive(to, 20, 24)
    to.set_paused('local_view', False)
    to.command(SetMapping(False, 'experience_map'))
    to.set_patient(True)
    drive(to, 24, 40)
    to.set_patient(False)
    drive(to, 0, 30, START_NS - 10**10)  # the stamps jump back
    to.command(Reset('local_view'))
    to.finish()
    to.command(SetMapping(True, 'experience_map'))
    drive(to, 30, 50, START_NS - 10**10)


def digests(states: Mapping[str, State]) -> dict[str, bytes]:
    return {part: digest_of(state) for part, state in states.items()}


def logged(at: int = -1) -> tuple[LivePipeline, Logging]:
    process = Logging(at)
    process.live = live(process)
    run(process.live)
    return process.live, process


def test_log_repeats_all_states() -> None:
    first, process = logged()
    again = live(Process())
    for entry in process.entries:
        again.receive(entry)
    assert digests(again.states()) == digests(first.states())
    saved = first.states()
    assert [key for _, key, _ in saved['pose_cells']['parameters_set']] == [DECAY]
    assert saved['experience_map']['goals']['named'][0][0] == 'kitchen'
    assert saved['experience_map']['action_ns'] > 0
    assert first.pipeline.counts.refused > 0


@pytest.mark.parametrize('at', range(3, 180, 9))
def test_state_at_any_entry_and_rest_of_log_give_same_states(at: int) -> None:
    first, process = logged(at)
    assert process.states, f'only {len(process.entries)} entries'
    again = live(Process())
    again.begin(
        Beginning(PARTS, '', '', START_NS, is_first=False, is_resumed=True), process.states, Path()
    )
    again.pipeline.go_on()
    assert digests(again.states()) == digests(process.states)
    for entry in process.entries[at:]:
        again.receive(entry)
    assert digests(again.states()) == digests(first.states())


def test_hint_before_the_first_input_begins_one_session() -> None:
    first, _ = logged()
    states, hint = first.states(), Hint(PoseHint(Pose(1.0, 2.0, 0.0), 0.1, 0.0, 0.1, 0.1))
    found, entries = [], []
    for is_repeated in (False, True):
        process = Logging()
        continued = live(process)
        continued.begin(Beginning(PARTS, '', '', START_NS), states, Path())
        if is_repeated:
            for entry in entries:
                continued.receive(entry)
        else:
            continued.command(hint)
            drive(continued, 200, 230)
            entries = process.entries
        found.append(digests(continued.states()))
        kinds = [entry.data for entry in process.entries if entry.stream == 'command']
        assert [b'NewSession' in kind for kind in kinds] == [True, False]
    assert found[0] == found[1]


@pytest.mark.parametrize('part', PARTS)
def test_unfit_state_and_value_change_nothing(part: str) -> None:
    first, _ = logged()
    before = digests(first.states())
    with pytest.raises((LookupError, TypeError)):
        first.replace(part, {'parameters_set': [[1, DECAY, 3.0]]})
    with pytest.raises(UnusableParameter):
        first.set_values('pose_cells', {DECAY: -1.0})
    assert digests(first.states()) == before
