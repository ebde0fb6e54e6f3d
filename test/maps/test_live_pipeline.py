# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A live pipeline gives the same states again from its log, from any saved state on."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from graphs import NONE
from helpers import PERIOD_NS, START_NS, extended, picture, twist
from msgspec import structs
from state_digest import digest_of

from ratslam_ros.chain import Chain
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.state import State
from ratslam_ros.core.mapping.pose_hint import PoseHint
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.maps.input_log import Entry
from ratslam_ros.maps.kept_log import Beginning
from ratslam_ros.maps.live_pipeline import LivePipeline, Process
from ratslam_ros.maps.saved_map import Cut
from ratslam_ros.messages.commands import PassedItem
from ratslam_ros.messages.json_schema import Stamp, decode, encode
from ratslam_ros.pipeline.codec import encode_item
from ratslam_ros.pipeline.commands import Hint, NamePlace, Reset, SetMapping
from ratslam_ros.pipeline.items import NumberedAction
from ratslam_ros.pipeline.live_stages import LIVE_STAGES, Reporter
from ratslam_ros.pipeline.streams import STREAMS

PARTS = 'local_view', 'pose_cells', 'experience_map'
DECAY = 'pose_cells.vt_active_decay'
CONFIG = extended().with_values({
    'local_view.template_x_size': 16, 'local_view.template_y_size': 8,
    'local_view.vt_shift_match': 2, 'pose_cells.pc_cell_x_size': 0.5,
    'inputs.max_lateness_s': 3e-9 * PERIOD_NS,
})


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
    return LivePipeline(stages, CONFIG, process)


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
    drive(to, 24, 40)
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
    assert first.pipeline.order.counts.refused > 0


@pytest.mark.parametrize('at', range(3, 180, 29))
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


class Passing(Logging):
    """Keeps what is passed on, and what is reported."""

    def __init__(self) -> None:
        super().__init__()
        self.items: list[PassedItem] = []
        self.reports: list[str] = []
        self.cuts: list[Cut] = []
        self.starts_over = lambda stream: False

    def passed(self, item: PassedItem) -> None:
        self.items.append(decode(PassedItem, encode(item)))

    def cut(self, cut: Cut) -> None:
        self.cuts.append(cut)

    def noted(self, text: str) -> None:
        self.reports.append(text)


def head(process: Passing, run: int = 5) -> LivePipeline:
    made = LIVE_STAGES['local_view'](CONFIG, Reporter())
    return LivePipeline([made], CONFIG, process, Chain(is_followed=True), run)


def follower(process: Process) -> LivePipeline:
    streams = [one for one in STREAMS if not one.answers]
    stages = [LIVE_STAGES[part](CONFIG, Reporter()) for part in PARTS[1:]]
    return LivePipeline(stages, CONFIG, process, Chain('local_view'), streams=streams)


def passed(last: int = 40) -> tuple[LivePipeline, list[PassedItem]]:
    process = Passing()
    first = head(process)
    drive(first, 0, last)
    drive(first, 0, 30, START_NS - 10**10)  # the stamps jump back
    first.finish()
    return first, process.items


def test_follower_has_the_states_of_one_process() -> None:
    whole = live(Process())
    drive(whole, 0, 40)
    drive(whole, 0, 30, START_NS - 10**10)
    whole.finish()
    _, items = passed()
    process = Passing()
    found = follower(process)
    for item in items:
        for _ in range(2):  # repetitions change nothing
            found.follow(item)
    for part in PARTS[1:]:
        assert digest_of(found.state_of(part)['core']) == digest_of(whole.state_of(part)['core'])
    assert [item.number for item in items] == [*range(1, len(items) + 1)]
    assert [entry.stream for entry in process.entries].count('passed') == len(items)
    assert any(item.stream == 'command' for item in items)
    assert process.reports == []


@pytest.mark.parametrize('at', range(5, 60, 18))
def test_follower_goes_on_from_its_state_and_log(at: int) -> None:
    _, items = passed()
    whole = follower(Process())
    process, states = Passing(), {}
    first = follower(process)
    for number, item in enumerate(items):
        whole.follow(item)
        if number == at:
            states, process.entries = first.states(), []
        if number < at + 20:
            first.follow(item)
    again = follower(Process())
    again.begin(Beginning(PARTS, '', '', START_NS, False), states, Path())
    again.pipeline.go_on()
    for entry in process.entries:
        again.receive(entry)
    assert again.followed == (5, at + 20)
    for item in items:  # all that the sender has kept
        again.follow(item)
    assert digests(again.states()) == digests(whole.states())


def test_killed_head_passes_the_same_items_on_again() -> None:
    process = Passing()
    first = head(process)
    first.begin_run()
    drive(first, 0, 20)
    states, count = first.states(), len(process.items)
    before, process.entries = process.entries, []
    assert before[0].stream == 'run'
    drive(first, 20, 40)
    for logged_entries, known in ((before + process.entries, {}), (process.entries, states)):
        other = Passing()
        again = head(other, 6)
        if known:
            beginning = Beginning(PARTS, '', '', START_NS, False, is_resumed=True)
            again.begin(beginning, known, Path())
        for entry in logged_entries:
            again.receive(entry)
        again.begin_run()
        assert other.items == process.items[count if known else 0 :]
        assert [entry.stream for entry in other.entries].count('run') == 0


def test_follower_saves_after_the_same_item_as_the_head() -> None:
    process = Passing()
    first = head(process)
    first.pass_cut(Cut(99, START_NS))  # before the first item
    for n in range(20):
        drive(first, n, n + 1)
        first.pass_cut(Cut(n, START_NS + n))
    found, numbers = Passing(), {}
    other = follower(found)
    for item in (*process.items[:30], *process.items):  # most are repetitions
        before = len(found.cuts)
        other.follow(item)
        numbers |= {cut.number: other.followed[1] for cut in found.cuts[before:]}
    expected = {int(one.item): one.number for one in process.items if one.stream == 'cut'}
    assert numbers == expected
    assert expected[99] == 0
    assert len(numbers) > 15
    with pytest.raises(UnusableInput, match='number of a cut'):
        other.follow(structs.replace(process.items[-1], item=b'-1'))


def test_lost_items_are_reported_and_another_run_is_used() -> None:
    _, items = passed()
    process = Passing()
    found = follower(process)
    for item in (*items[:20], *items[25:30]):
        found.follow(item)
    [report] = process.reports
    assert 'is lost' in report
    number = found.pipeline.stages['pose_cells'].number
    for again, item in enumerate(items[20:30], 1):  # it was started again without a log
        found.follow(structs.replace(item, run=7, number=again))
    assert process.reports == [report]
    assert found.pipeline.stages['pose_cells'].number == number  # each is used once
    found.follow(structs.replace(items[30], run=7, number=11))
    assert found.followed == (7, 11)
    assert found.pipeline.order.newest_ns == items[30].stamp.ns


def test_map_answers_actions_that_it_does_not_repeat() -> None:
    """Otherwise pose cells that have lost their state would wait for these answers."""
    process = Passing()
    stages = [LIVE_STAGES['experience_map'](CONFIG, Reporter())]
    found = LivePipeline(stages, CONFIG, process, Chain('pose_cells'))
    action = NumberedAction(3, NONE, START_NS)
    for run in (5, 7):
        for number, stamp_ns in enumerate((START_NS, START_NS + PERIOD_NS), 1):
            found.follow(PassedItem(
                run, number, 'action', Stamp.of(stamp_ns), encode_item(action)
            ))
    assert [json.loads(answer)['sequence'] for answer in found.answers] == [3] * 4
